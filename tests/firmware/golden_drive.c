/* Twelve seconds of driving on a plant of integers: a checksum each second, to be equal on machines
 * with 32-bit and 16-bit int.
 *
 * The whole robot drives in closed loop: velocities, poses, duties and outside poses arrive over
 * the serial line, two telemetry streams leave, a blow hits it, supply and floor change. Since the
 * loop is closed, one bit that differs anywhere changes everything after it. All that leaves the
 * robot goes into the checksum: duties, bridges, bytes of the line, words of the store.
 *
 * The plant is that of the nominal robot in um/s, urad/s, mN and ms, with
 *     f = F s / (|s| + s0),   F = 29.43 N mu / 0.6,   s0 = 39 mm/s
 * instead of the arc tangent of paper (13). Divisions truncate towards zero on both machines.
 */
#include <stdio.h>

#include "firmware/robot.h"
#include "tests/firmware/integer_hal.h"

#define SECONDS 12

/* ---- The plant ---- */

#define NM_PER_COUNT 13090L /* at the rim */

static i32 rim_um_s[WHEEL_COUNT];
static i32 rim_nm[WHEEL_COUNT]; /* beyond the counter */
static u16 counter[WHEEL_COUNT];
static i16 current_ma[WHEEL_COUNT];
static i32 x_um_s, y_um_s, turn_urad_s;
static i32 grip_mn = 29430;
static u16 supply_mv = 24000;

static i32 size_of(i32 value) {
    return value < 0 ? -value : value;
}

static i32 friction_mn(i32 slip_um_s) {
    const i32 slip = slip_um_s / 64;
    return grip_mn * slip / (size_of(slip) + 609);
}

static void turn_wheel(u16 wheel, i32 force_mn) {
    /* 10.2 N/V of the stalled motor, 62.4 N s/m of back-EMF and drag, 1.44 kg seen at the rim */
    const i32 voltage_mv =
        bridges_on ? (i32)applied_duty_q15[wheel] / 8 * (i32)supply_mv / 4096 : 0;
    const i32 drive_mn = voltage_mv * 51 / 5 - rim_um_s[wheel] / 1000 * 312 / 5;
    i32 nm;
    rim_um_s[wheel] += (drive_mn - force_mn) / 36 * 25;
    current_ma[wheel] = (i16)((voltage_mv - rim_um_s[wheel] / 1000 * 153 / 25) * 5 / 3);
    nm = rim_nm[wheel] + rim_um_s[wheel];
    counter[wheel] = (u16)(counter[wheel] + nm / NM_PER_COUNT);
    rim_nm[wheel] = nm % NM_PER_COUNT;
}

static void plant_tick(void) {
    static const i16 sine_q10[WHEEL_COUNT] = {512, 512, -512, -512};
    static const i16 cosine_q10[WHEEL_COUNT] = {887, -887, -887, 887};
    i32 x_mn = 0, y_mn = 0, sum_mn = 0;
    i32 x_change;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        const i32 hub_um_s = (x_um_s / 16 * -sine_q10[i] + y_um_s / 16 * cosine_q10[i]) / 64 +
                             turn_urad_s / 5; /* L = 0.2 m */
        const i32 force_mn = friction_mn(rim_um_s[i] - hub_um_s);
        turn_wheel(i, force_mn);
        x_mn += -sine_q10[i] * force_mn / 1024;
        y_mn += cosine_q10[i] * force_mn / 1024;
        sum_mn += force_mn;
    }
    x_change = x_mn / 20 + turn_urad_s / 1000 * (y_um_s / 1000) / 1000;
    y_um_s += y_mn / 20 - turn_urad_s / 1000 * (x_um_s / 1000) / 1000;
    x_um_s += x_change;
    turn_urad_s += sum_mn * 4 / 11; /* L / Iz */
}

void hal_read_encoder_counts(u16 counts[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        counts[i] = counter[i];
}

u16 hal_read_encoder_errors(void) {
    return 0;
}

u16 hal_read_supply_mv(void) {
    return (u16)(supply_mv + next_random() % 64U);
}

void hal_read_currents_ma(i16 ma[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        ma[i] = current_ma[i];
}

u16 hal_read_bridge_faults(void) {
    return 0;
}

u16 hal_serial_lost(void) {
    return 0;
}

/* ---- The host: one request every 10 ms ---- */

#define REQUEST(name, code, bytes, more, fields, answer, description) REQUEST_##name = (code),
enum {
#include "firmware/messages.def"
    REQUEST_NONE = 0
};

static void ask_for_stream(u16 stream, u16 period_ms, u16 first, u16 signals) {
    u16 i;
    begin_request(REQUEST_stream);
    frame_add_u8(&request, stream);
    frame_add_u16(&request, period_ms);
    for (i = 0; i < signals; i++)
        frame_add_u8(&request, (u16)(first + i));
}

static void command_velocity(i16 x_mm_s, i16 y_mm_s, i16 turn_mrad_s) {
    begin_request(REQUEST_velocity);
    frame_add_u16(&request, (u16)x_mm_s);
    frame_add_u16(&request, (u16)y_mm_s);
    frame_add_u16(&request, (u16)turn_mrad_s);
}

static void command_pose(i16 x_mm, i16 y_mm, i16 theta_mrad, i16 x_m_s_q13) {
    begin_request(REQUEST_pose);
    frame_add_u32(&request, (u32)((i32)x_mm * 8192));
    frame_add_u32(&request, (u32)((i32)y_mm * 8192));
    frame_add_u32(&request, (u32)((i32)theta_mrad * 8192));
    frame_add_u16(&request, (u16)x_m_s_q13);
    frame_add_u16(&request, 0);
    frame_add_u16(&request, 0);
}

static void see_from_outside(const robot *r) {
    const odometry_pose *pose = &r->loop.telemetry.pose;
    begin_request(REQUEST_outside_pose);
    frame_add_u32(&request, (u32)(pose->x_mm_q13 + next_random()));
    frame_add_u32(&request, (u32)(pose->y_mm_q13 - next_random()));
    frame_add_u32(&request, (u32)(pose->theta_mrad_q13 / 2));
    frame_add_u16(&request, next_random() % 120U);
}

static void command_duty(i16 duty) {
    u16 i;
    begin_request(REQUEST_duty);
    for (i = 0; i < WHEEL_COUNT; i++)
        frame_add_u16(&request, (u16)(i < 2 ? -duty : duty));
}

static void make_request(const robot *r, u16 slot) {
    const u16 second = (u16)(slot / 100U);
    if (slot < 4) {
        if (slot < 2) {
            ask_for_stream(slot, (u16)(5 + 15 * slot), (u16)(14 * slot), (u16)(14 - 7 * slot));
        } else {
            begin_request(slot == 2 ? REQUEST_arm : REQUEST_identify);
        }
    } else if (slot % 7 == 0 && second < 11) {
        see_from_outside(r);
    } else if (slot % 2 != 0) {
        return;
    } else if (second < 4) {
        command_velocity((i16)(1500 - 300 * (i16)(slot / 40U)), (i16)(400 * (i16)(second % 3U)),
                         (i16)(second * 900U));
    } else if (second < 9) {
        command_pose((i16)(second < 7 ? 900 : -400), (i16)(200 * (i16)second - 1000),
                     (i16)(second < 6 ? 3000 : -2500), (i16)(second < 7 ? 4000 : 0));
    } else if (second < 10) {
        command_duty((i16)(slot % 50U * 200U));
    } else if (second < 11) {
        command_velocity(0, (i16)(1000 - 4 * (i16)(slot % 100U)), 0);
    } else {
        begin_request(slot % 20 == 0 ? REQUEST_parameters_save : REQUEST_parameter_describe);
        if (request.byte[2] == REQUEST_parameter_describe)
            frame_add_u8(&request, slot % 64U);
    }
    frame_finish(&request);
}

static void change_world(u16 tick) {
    if (tick == 2500) { /* 4 N s from the side */
        y_um_s += 200000;
        turn_urad_s += 500000;
    }
    grip_mn = tick < 5000 || tick > 6000 ? 29430 : 15000;
    supply_mv = (u16)(24000U - tick / 4U);
}

/* ---- Time, on the AVR: its timer 1 counts every eighth cycle ---- */

#ifdef __AVR__
#include <avr/io.h>

static u32 cycles_in_all, longest_cycles; /* the sum is of cycles / 8 */

static void timed_tick(robot *r) {
    u32 cycles;
    TCCR1B = 1 << CS11;
    TCNT1 = 0;
    robot_tick(r);
    cycles = (u32)TCNT1;
    cycles_in_all += cycles;
    if (cycles * 8 > longest_cycles)
        longest_cycles = cycles * 8;
}
#else
#define timed_tick robot_tick
#endif

int main(void) {
    static robot r;
    u16 driven_ms = 0;
    u16 tick;
    integer_hal_start();
    robot_init(&r);
    for (tick = 0; tick < SECONDS * 1000U; tick++) {
        if (tick % 10U == 0)
            make_request(&r, (u16)(tick / 10U));
        change_world(tick);
        timed_tick(&r);
        plant_tick();
        integer_hal_tick();
        mix((u32)r.loop.telemetry.pose.x_mm_q13);
        mix((u32)r.loop.target.velocity.axis_q22[1]);
        if (r.loop.telemetry.state == SUPERVISOR_STATE_DRIVE)
            driven_ms++;
        if (tick % 1000U == 999)
            printf("%2u s %08lx x %ld mm, y %ld mm, fault %u, rim %ld um/s, lost %u\n",
                   tick / 1000U + 1U, (unsigned long)checksum,
                   (long)(r.loop.telemetry.pose.x_mm_q13 / 8192),
                   (long)(r.loop.telemetry.pose.y_mm_q13 / 8192), (unsigned)r.loop.telemetry.fault,
                   (long)rim_um_s[0], (unsigned)r.told.counters.samples_lost);
    }
    printf("driven %u ms\n", driven_ms);
#ifdef __AVR__
    printf("cycles of a tick: mean %lu, longest %lu\n",
           (unsigned long)(cycles_in_all / (SECONDS * 125U)), (unsigned long)longest_cycles);
#endif
    return 0;
}
