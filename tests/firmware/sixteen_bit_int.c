/* A checksum over 600 ticks of the control loop and 600 of the robot behind its serial line, to be
 * equal on machines with 32-bit and 16-bit int.
 *
 * Integer promotion differs between the two, and a product that lacks its widening cast differs
 * with it. The inputs are pseudo-random counter steps, supplies, currents and
 * faults, a velocity and a pose command, and outside poses; for the robot requests of every kind
 * with pseudo-random fields, among noise.
 */
#include "firmware/robot.h"
#include "tests/firmware/integer_hal.h"

static u16 counter[WHEEL_COUNT];

void hal_read_encoder_counts(u16 counts[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        counter[i] = (u16)(counter[i] + next_random() % 80U - 20U);
        counts[i] = counter[i];
    }
}

u16 hal_read_supply_mv(void) {
    return (u16)(20000U + next_random() % 8000U);
}

u16 hal_read_encoder_errors(void) {
    return next_random() % 64U == 0 ? 1 : 0;
}

void hal_read_currents_ma(i16 current_ma[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        current_ma[i] = (i16)(next_random() >> 4);
}

u16 hal_read_bridge_faults(void) {
    return next_random() % 128U == 0 ? 2 : 0;
}

u16 hal_serial_lost(void) {
    return next_random() % 32U == 0 ? 1 : 0;
}

/* ---- the robot behind its line ---- */

#define REQUEST(name, code, bytes, more, fields, answer, description) code, bytes,
static u16 requests[] = {
#include "firmware/messages.def"
};
#define REQUESTS (sizeof requests / sizeof requests[0] / 2)

/* Any request with any content, one byte in 256 changed on the way. */
static void make_request(void) {
    const u16 row = (u16)(next_random() % REQUESTS);
    u16 i;
    begin_request(requests[2 * row]);
    for (i = 0; i < requests[2 * row + 1]; i++)
        frame_add_u8(&request, next_random() % 4U == 0 ? 0 : next_random() >> 10);
    frame_finish(&request);
    for (i = 0; i < request.length; i++)
        request.byte[i] ^= next_random() % 256U == 0 ? 4 : 0;
}

static void run_robot(robot *r) {
    i16 tick;
    integer_hal_start();
    robot_init(r);
    for (tick = 0; tick < 600; tick++) {
        if (tick % 20 == 0 && !control_loop_arm(&r->loop))
            control_loop_clear_fault(&r->loop);
        if (request_is_received())
            make_request();
        robot_tick(r);
        integer_hal_tick();
        mix((u16)r->settings.value[next_random() % PARAMETER_COUNT]);
    }
    mix(r->told.counters.bad_frames);
    mix((u32)r->store.status);
}

/* ---- the control loop ---- */

static u32 run(void) {
    static robot r;
    control_loop *loop = &r.loop;
    const odometry_pose goal = {8192000L, -3000000L, 9000000L};
    const kinematics_velocity arrival = {1000, -500, 300};
    i16 tick;
    parameters_set_defaults(&r.settings);
    control_loop_init(loop, &r.settings);
    for (tick = 0; tick < 600; tick++) {
        if (!control_loop_arm(loop))
            control_loop_clear_fault(loop);
        if (tick % 30 == 0)
            control_loop_outside_pose(loop, &goal, (i16)(tick % 250));
        if (tick >= 300) {
            control_loop_command_pose(loop, &goal, &arrival);
        } else if (tick % 50 == 0) {
            control_loop_command_velocity(loop, (i16)(1500 - 5 * tick), (i16)(3 * tick), -2000);
        }
        control_loop_tick(loop);
        mix((u32)loop->telemetry.pose.x_mm_q13);
        mix((u32)loop->telemetry.pose.theta_mrad_q13);
        mix((u32)loop->target.position_q13[1]);
        mix((u16)loop->telemetry.slip_m_s_q13[2]);
        mix((u16)(loop->telemetry.state * 256 + loop->telemetry.fault * 16) +
            loop->telemetry.limit_wheel);
    }
    run_robot(&r);
    return checksum;
}

#include <stdio.h>

int main(void) {
    printf("checksum %08lx\n", (unsigned long)run());
    return 0;
}
