/* The 1 kHz control loop, with its scalings.
 *
 *       command     m/s Q13, rad/s Q11 | mm Q13, mrad Q13 | duty Q15
 *          |
 *     supervisor <---------------------- faults of wheels, supply, bridges, link
 *          |
 *          v                                                             world frame
 *      trajectory   m/s Q22, rad/s Q22 and mm Q13, mrad Q13
 *          |
 *          v   error mm Q8 * gain Q20 -> m/s Q22
 *         (-)<------------------------------- pose   mm Q13, mrad Q13 <-- outside pose
 *          |                                   ^
 *    traction limit  F = (J+)' M a, N Q8       |
 *          |                                odometry
 *   - - - -|- - - - - - - - - - - - - - - - - -|- - - - - - - - - - - -  body frame
 *          v   m/s Q22, rad/s Q22              |   m/s Q13, rad/s Q11
 *    kinematics J                           slip observer, or J+
 *          |                                   ^
 *          v   hub m/s Q22                     |
 *        + slip(F)                             |   rim m/s Q13, force N Q8
 *          |                                   |
 *        * n / R, rest carried               * R / n
 *          |                                   ^
 *          v   shaft rad/s Q5                  |   shaft rad/s Q5
 *       4 x PID  <-----------------------------+
 *    + feed-forward(F, W, dW/dt)               |
 *          |                                wheel speed
 *          v   V Q9                            ^
 *       / supply                               |   counts
 *          |   duty Q15                        |
 *   ======hal=================================hal======
 *
 * Equations stand in the headers of the parts.
 */
#include "firmware/control_loop.h"

#include "firmware/contact.h"
#include "firmware/fixed_point.h"
#include "firmware/motor.h"
#include "hal/hal.h"

/* What the tick measures beyond the telemetry. */
typedef struct {
    i16 supply_v_q9;
    i16 voltage_v_q9[WHEEL_COUNT]; /* applied during the last tick */
    i16 step_counts[WHEEL_COUNT];
    i16 rim_m_s_q13[WHEEL_COUNT];
    u16 encoder_errors;
} measurement;

/* The parts of the tick, in the order of their call; each works on the loop's state. */
static void measure(control_loop *loop, measurement *now);
static void locate(control_loop *loop, const measurement *now);
static void supervise(control_loop *loop, const measurement *now);
static void rest(control_loop *loop);
static void drive_duty(control_loop *loop);
static kinematics_force advance_target(control_loop *loop, odometry_heading heading);
static traction_change demand_velocity(control_loop *loop, odometry_heading heading);
static void drive_wheels(control_loop *loop, const traction_change *body,
                         const kinematics_force *inertia, i16 supply_v_q9);

void control_loop_tick(control_loop *loop) {
    measurement now;
    odometry_heading heading;
    traction_change body;
    kinematics_force inertia;

    measure(loop, &now);
    locate(loop, &now);
    supervise(loop, &now);
    loop->telemetry.limit = CONTROL_LIMIT_NONE;
    loop->telemetry.limit_wheel = 0;
    if (loop->supervision.state != SUPERVISOR_STATE_DRIVE) {
        rest(loop);
    } else if (loop->telemetry.mode == CONTROL_MODE_DUTY) {
        drive_duty(loop);
    } else {
        heading = odometry_heading_of(odometry_binary_angle(loop->telemetry.pose.theta_mrad_q13));
        inertia = advance_target(loop, heading);
        body = demand_velocity(loop, heading);
        drive_wheels(loop, &body, &inertia, now.supply_v_q9);
    }
    hal_write_duty(loop->telemetry.duty_q15);
}

/* ---- From the sensors to the pose ---- */

static i16 supply_v_q9(u16 supply_mv) {
    /* mV -> V Q9: times 512 / 1000 = 33554 / 2^16 */
    const u32 supply_q9 = (u32)supply_mv * (u32)33554 >> 16;
    return supply_q9 > I16_MAX ? I16_MAX : (i16)supply_q9;
}

static void start_counting(control_loop *loop) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        wheel_speed_reset(&loop->speed[i], loop->telemetry.encoder_counts[i]);
        wheel_monitor_reset(&loop->monitor[i], loop->telemetry.encoder_counts[i]);
    }
}

static void measure(control_loop *loop, measurement *now) {
    control_loop_telemetry *telemetry = &loop->telemetry;
    const u16 *counts = telemetry->encoder_counts;
    u16 i;
    hal_read_encoder_counts(telemetry->encoder_counts);
    hal_read_currents_ma(telemetry->current_ma);
    telemetry->supply_mv = hal_read_supply_mv();
    now->supply_v_q9 = supply_v_q9(telemetry->supply_mv);
    now->encoder_errors = hal_read_encoder_errors();
    if (!loop->counters_known)
        start_counting(loop);
    loop->counters_known = 1;
    for (i = 0; i < WHEEL_COUNT; i++) {
        i16 shaft_q5;
        now->voltage_v_q9[i] = fixed_multiply_q15(now->supply_v_q9, telemetry->duty_q15[i]);
        now->step_counts[i] = wheel_speed_counts_since(&loop->speed[i], counts[i]);
        shaft_q5 = wheel_speed_step_rad_s_q5(&loop->speed[i], loop->settings, counts[i]);
        telemetry->shaft_rad_s_q5[i] = shaft_q5;
        /* Q5 * Q20 = Q25 -> Q13 */
        now->rim_m_s_q13[i] = fixed_saturate_i16(fixed_shift_right(
            (i32)shaft_q5 * PARAMETER_GET(loop->settings, rim_per_shaft_q20), 12));
    }
}

static void locate(control_loop *loop, const measurement *now) {
    control_loop_telemetry *telemetry = &loop->telemetry;
    u16 i;
    slip_observer_step(&loop->observer, loop->settings, now->voltage_v_q9,
                       telemetry->shaft_rad_s_q5, now->rim_m_s_q13);
    for (i = 0; i < WHEEL_COUNT; i++) {
        telemetry->force_n_q8[i] = loop->observer.force_n_q8[i];
        telemetry->slip_m_s_q13[i] = loop->observer.slip_m_s_q13[i];
    }
    telemetry->null_slip_m_s_q13 = kinematics_null_slip_m_s_q13(loop->settings, now->rim_m_s_q13);
    telemetry->observed = slip_observer_velocity(&loop->observer);
    kinematics_forward(loop->settings, now->rim_m_s_q13, &telemetry->rolling);
    odometry_step(&telemetry->pose, PARAMETER_GET(loop->settings, slip_compensation)
                                        ? &telemetry->observed
                                        : &telemetry->rolling);
    outside_pose_step(&loop->outside, &telemetry->pose);
}

/* ---- Reasons to stand still ---- */

static void watch_wheels(control_loop *loop, const measurement *now) {
    const control_loop_telemetry *telemetry = &loop->telemetry;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        wheel_monitor_input input;
        supervisor_fault fault;
        input.count = telemetry->encoder_counts[i];
        input.step_counts = now->step_counts[i];
        input.shaft_rad_s_q5 = telemetry->shaft_rad_s_q5[i];
        input.voltage_v_q9 = now->voltage_v_q9[i];
        input.force_n_q8 = telemetry->force_n_q8[i];
        input.current_ma = telemetry->current_ma[i];
        input.glitch = (u16)(now->encoder_errors >> i & 1U);
        fault = wheel_monitor_step(&loop->monitor[i], loop->settings, &input);
        if (fault != SUPERVISOR_FAULT_NONE)
            supervisor_raise(&loop->supervision, fault, (u16)(i + 1U));
    }
}

static void watch_power(control_loop *loop, const measurement *now) {
    const u16 bridge_faults = loop->bridges_on ? hal_read_bridge_faults() : 0;
    if (now->supply_v_q9 < PARAMETER_GET(loop->settings, supply_minimum_q9))
        supervisor_raise(&loop->supervision, SUPERVISOR_FAULT_UNDER_VOLTAGE, 0);
    if (bridge_faults != 0)
        supervisor_raise(&loop->supervision, SUPERVISOR_FAULT_BRIDGE, bridge_faults & 1U ? 1 : 3);
}

static void watch_command(control_loop *loop) {
    if (loop->supervision.state != SUPERVISOR_STATE_DRIVE)
        return;
    if (loop->command_age_ms >= PARAMETER_GET(loop->settings, command_timeout_ms)) {
        supervisor_raise(&loop->supervision, SUPERVISOR_FAULT_COMMAND_TIMEOUT, 0);
    } else {
        loop->command_age_ms++;
    }
}

static void supervise(control_loop *loop, const measurement *now) {
    supervisor_tick(&loop->supervision);
    watch_wheels(loop, now);
    watch_power(loop, now);
    watch_command(loop);
    supervisor_ask(&loop->supervision, SUPERVISOR_READY);
    loop->telemetry.state = loop->supervision.state;
    loop->telemetry.fault = loop->supervision.fault;
    loop->telemetry.fault_wheel = loop->supervision.fault_wheel;
    if (loop->bridges_on != supervisor_bridges_on(&loop->supervision)) {
        loop->bridges_on = supervisor_bridges_on(&loop->supervision);
        hal_enable_bridges(loop->bridges_on);
    }
}

/* Target, demand and wheel controllers rest on the measured motion, so that a later command starts
 * from it. */
static void follow_motion(control_loop *loop) {
    control_loop_telemetry *telemetry = &loop->telemetry;
    u16 i;
    trajectory_start(&loop->target, &telemetry->pose,
                     PARAMETER_GET(loop->settings, slip_compensation) ? &telemetry->observed
                                                                      : &telemetry->rolling);
    loop->demand = loop->target.velocity;
    telemetry->target = telemetry->pose;
    for (i = 0; i < WHEEL_COUNT; i++) {
        wheel_pid_reset(&loop->pid[i], telemetry->shaft_rad_s_q5[i]);
        loop->wheel_target_rad_s_q5[i] = telemetry->shaft_rad_s_q5[i];
        loop->wheel_target_rest_q13[i] = 0;
    }
}

static void rest(control_loop *loop) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        loop->telemetry.duty_q15[i] = 0;
    loop->telemetry.mode = CONTROL_MODE_IDLE;
    follow_motion(loop);
}

static void drive_duty(control_loop *loop) {
    const i16 limit_q15 = PARAMETER_GET(loop->settings, duty_limit_q15);
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        loop->telemetry.duty_q15[i] = fixed_clamp_i16(loop->command_duty_q15[i], limit_q15);
    }
    follow_motion(loop);
}

/* ---- From the target to the duty ---- */

/* Every limit has a name that reaches the operator; the enumeration is in order of weight. */
static void report_limit(control_loop *loop, control_limit limit, u16 wheel) {
    if (limit <= loop->telemetry.limit)
        return;
    loop->telemetry.limit = limit;
    loop->telemetry.limit_wheel = wheel;
}

/* Keeps a change of one tick within the grip. */
static void limit_to_grip(control_loop *loop, odometry_heading heading, traction_change *change) {
    const u16 wheel = traction_limit(loop->settings, heading, change);
    if (wheel != 0)
        report_limit(loop, CONTROL_LIMIT_TRACTION, wheel);
}

/* Advances the target; returns the force that its acceleration takes, in the body frame. */
static kinematics_force advance_target(control_loop *loop, odometry_heading heading) {
    traction_change change = loop->target.velocity;
    u16 axis;
    if (loop->telemetry.mode == CONTROL_MODE_POSE) {
        trajectory_step_to_pose(&loop->target, loop->settings);
    } else {
        u16 wheel;
        const control_limit limit = trajectory_step_velocity(&loop->target, loop->settings,
                                                             &loop->command_velocity, &wheel);
        report_limit(loop, limit, wheel);
    }
    loop->telemetry.target.x_mm_q13 = loop->target.position_q13[0];
    loop->telemetry.target.y_mm_q13 = loop->target.position_q13[1];
    loop->telemetry.target.theta_mrad_q13 = odometry_wrap_mrad_q13(loop->target.position_q13[2]);
    for (axis = 0; axis < 3; axis++) {
        change.axis_q22[axis] = loop->target.velocity.axis_q22[axis] - change.axis_q22[axis];
    }
    limit_to_grip(loop, heading, &change);
    return traction_inertia_force(loop->settings, heading, &change);
}

/* mm Q13 -> mm Q8, limited to +-128 mm; * 1/ms Q20 = Q28 -> m/s Q22. The same for mrad and rad/s.
 */
static i32 correction_q22(i32 error_q13, i16 gain_q20) {
    const i16 error_q8 = fixed_clamp_i16(fixed_shift_right(error_q13, 5), I16_MAX);
    return fixed_shift_right((i32)error_q8 * gain_q20, 6);
}

static void wanted_velocity(const control_loop *loop, traction_change *wanted) {
    const control_loop_telemetry *telemetry = &loop->telemetry;
    const i16 gain_q20 = PARAMETER_GET(loop->settings, position_gain_q20);
    const i16 heading_gain_q20 = PARAMETER_GET(loop->settings, heading_gain_q20);
    const i32 turn_q13 = odometry_wrap_mrad_q13(
        fixed_subtract_i32(telemetry->target.theta_mrad_q13, telemetry->pose.theta_mrad_q13));
    *wanted = loop->target.velocity;
    wanted->axis_q22[0] += correction_q22(
        fixed_subtract_i32(telemetry->target.x_mm_q13, telemetry->pose.x_mm_q13), gain_q20);
    wanted->axis_q22[1] += correction_q22(
        fixed_subtract_i32(telemetry->target.y_mm_q13, telemetry->pose.y_mm_q13), gain_q20);
    wanted->axis_q22[2] += correction_q22(turn_q13, heading_gain_q20);
}

static traction_change world_to_body(odometry_heading heading, const traction_change *world) {
    const i32 x_q22 = world->axis_q22[0];
    const i32 y_q22 = world->axis_q22[1];
    traction_change body = *world;
    body.axis_q22[0] = fixed_add_i32(fixed_multiply_i32_q15(x_q22, heading.cosine_q15),
                                     fixed_multiply_i32_q15(y_q22, heading.sine_q15));
    body.axis_q22[1] = fixed_subtract_i32(fixed_multiply_i32_q15(y_q22, heading.cosine_q15),
                                          fixed_multiply_i32_q15(x_q22, heading.sine_q15));
    return body;
}

/* Velocity of the target corrected by the pose error, in the body frame. */
static traction_change demand_velocity(control_loop *loop, odometry_heading heading) {
    traction_change change;
    u16 axis;
    wanted_velocity(loop, &change);
    for (axis = 0; axis < 3; axis++)
        change.axis_q22[axis] =
            fixed_subtract_i32(change.axis_q22[axis], loop->demand.axis_q22[axis]);
    limit_to_grip(loop, heading, &change);
    for (axis = 0; axis < 3; axis++)
        loop->demand.axis_q22[axis] =
            fixed_add_i32(loop->demand.axis_q22[axis], change.axis_q22[axis]);
    return world_to_body(heading, &loop->demand);
}

static kinematics_force roller_force(const parameters *p, const traction_change *body) {
    /* Q22 -> Q13 */
    const i16 x_m_s_q13 = fixed_saturate_i16(fixed_shift_right(body->axis_q22[0], 9));
    const i16 y_m_s_q13 = fixed_saturate_i16(fixed_shift_right(body->axis_q22[1], 9));
    return contact_roller_force(p, x_m_s_q13, y_m_s_q13);
}

/* Row `wheel` of J, times the velocity. */
static i32 hub_speed_m_s_q22(const parameters *p, u16 wheel, const traction_change *body) {
    const i32 x_q22 =
        fixed_multiply_i32_q15(body->axis_q22[0], PARAMETER_WHEELS(p, drive_x_1_q15)[wheel]);
    const i32 y_q22 =
        fixed_multiply_i32_q15(body->axis_q22[1], PARAMETER_WHEELS(p, drive_y_1_q15)[wheel]);
    const i32 turning_q22 =
        fixed_multiply_i32_q15(body->axis_q22[2], PARAMETER_GET(p, wheel_distance_q15));
    return fixed_add_i32(fixed_add_i32(x_q22, y_q22), turning_q22);
}

/* Shaft speed at which the wheel moves its hub at this speed and exerts this force. What rounding
 * cuts off is carried to the next tick: a correction below one unit is not lost. */
static i16 shaft_target_rad_s_q5(control_loop *loop, u16 wheel, i32 hub_m_s_q22, i16 force_n_q8) {
    const parameters *p = loop->settings;
    i32 rim_m_s_q22 = hub_m_s_q22;
    i32 shaft_q13;
    if (PARAMETER_GET(p, slip_compensation)) {
        const i32 slip_m_s_q13 = contact_slip_from_force(p, force_n_q8).slip_m_s_q13;
        rim_m_s_q22 = fixed_add_i32(rim_m_s_q22, slip_m_s_q13 * 512);
    }
    /* Q22 * Q6 / 2^15 = Q13 -> Q5 */
    shaft_q13 = fixed_multiply_i32_q15(rim_m_s_q22, PARAMETER_GET(p, shaft_per_rim_q6));
    return fixed_saturate_i16(
        fixed_shift_right_carrying(shaft_q13, 8, &loop->wheel_target_rest_q13[wheel]));
}

static i16 wheel_voltage_v_q9(control_loop *loop, u16 wheel, i32 hub_m_s_q22, i16 force_n_q8,
                              i16 limit_v_q9) {
    const parameters *p = loop->settings;
    const i16 target_q5 = shaft_target_rad_s_q5(loop, wheel, hub_m_s_q22, force_n_q8);
    const i16 change_q5 = fixed_subtract_i16(target_q5, loop->wheel_target_rad_s_q5[wheel]);
    wheel_pid_input input;
    u16 limited = 0;
    i16 voltage_q9;
    input.target_rad_s_q5 = target_q5;
    input.shaft_rad_s_q5 = loop->telemetry.shaft_rad_s_q5[wheel];
    input.feed_forward_v_q9 = motor_voltage_v_q9(p, force_n_q8, target_q5, change_q5);
    input.limit_v_q9 = limit_v_q9;
    voltage_q9 = wheel_pid_step_v_q9(&loop->pid[wheel], p, &input, &limited);
    if (limited)
        report_limit(loop, CONTROL_LIMIT_VOLTAGE, (u16)(wheel + 1U));
    loop->wheel_target_rad_s_q5[wheel] = target_q5;
    return voltage_q9;
}

static void drive_wheels(control_loop *loop, const traction_change *body,
                         const kinematics_force *inertia, i16 supply_v_q9) {
    const parameters *p = loop->settings;
    const kinematics_force roller = roller_force(p, body);
    const i16 limit_v_q9 = fixed_multiply_q15(supply_v_q9, PARAMETER_GET(p, duty_limit_q15));
    /* 2^26 / Q9; below 2^15 because supply_minimum is above 4 V */
    const i16 inverse_supply_q17 = fixed_saturate_i16(fixed_divide(67108864L, (u16)supply_v_q9, 0));
    kinematics_force force = *inertia;
    i16 force_n_q8[WHEEL_COUNT];
    u16 i;
    force.x_n_q6 = fixed_subtract_i16(force.x_n_q6, roller.x_n_q6);
    force.y_n_q6 = fixed_subtract_i16(force.y_n_q6, roller.y_n_q6);
    traction_wheel_forces(p, &force, force_n_q8);
    for (i = 0; i < WHEEL_COUNT; i++) {
        const i16 voltage_q9 =
            wheel_voltage_v_q9(loop, i, hub_speed_m_s_q22(p, i, body), force_n_q8[i], limit_v_q9);
        /* Q9 * Q17 = Q26 -> Q15 */
        loop->telemetry.duty_q15[i] =
            fixed_clamp_i16(fixed_shift_right((i32)voltage_q9 * inverse_supply_q17, 11),
                            PARAMETER_GET(p, duty_limit_q15));
    }
}

/* ---- Requests and commands ---- */

u16 control_loop_arm(control_loop *loop) {
    return supervisor_ask(&loop->supervision, SUPERVISOR_ARM);
}

u16 control_loop_disarm(control_loop *loop) {
    return supervisor_ask(&loop->supervision, SUPERVISOR_DISARM);
}

u16 control_loop_clear_fault(control_loop *loop) {
    return supervisor_ask(&loop->supervision, SUPERVISOR_CLEAR);
}

void control_loop_stop(control_loop *loop) {
    supervisor_ask(&loop->supervision, SUPERVISOR_STOP);
}

void supervisor_report(control_loop *loop, supervisor_fault fault) {
    supervisor_raise(&loop->supervision, fault, 0);
}

static u16 grant(control_loop *loop, control_mode mode) {
    if (!supervisor_ask(&loop->supervision, SUPERVISOR_COMMAND))
        return 0;
    loop->telemetry.mode = mode;
    loop->command_age_ms = 0;
    return 1;
}

u16 control_loop_command_velocity(control_loop *loop, i16 x_mm_s, i16 y_mm_s, i16 omega_mrad_s) {
    kinematics_velocity *command = &loop->command_velocity;
    if (!grant(loop, CONTROL_MODE_VELOCITY))
        return 0;
    /* mm/s -> m/s Q13: times 8192 / 1000; mrad/s -> rad/s Q11: times 2048 / 1000 */
    command->x_m_s_q13 = fixed_saturate_i16((i32)x_mm_s * 1024 / 125);
    command->y_m_s_q13 = fixed_saturate_i16((i32)y_mm_s * 1024 / 125);
    command->omega_rad_s_q11 = fixed_saturate_i16((i32)omega_mrad_s * 256 / 125);
    return 1;
}

static int same_pose_command(const control_loop *loop, const odometry_pose *goal,
                             const kinematics_velocity *arrival) {
    const odometry_pose *pose = &loop->command_pose;
    const kinematics_velocity *velocity = &loop->command_arrival;
    return pose->x_mm_q13 == goal->x_mm_q13 && pose->y_mm_q13 == goal->y_mm_q13 &&
           pose->theta_mrad_q13 == goal->theta_mrad_q13 &&
           velocity->x_m_s_q13 == arrival->x_m_s_q13 && velocity->y_m_s_q13 == arrival->y_m_s_q13 &&
           velocity->omega_rad_s_q11 == arrival->omega_rad_s_q11;
}

trajectory_status control_loop_command_pose(control_loop *loop, const odometry_pose *goal,
                                            const kinematics_velocity *arrival) {
    const supervisor_state state = loop->supervision.state;
    if (state != SUPERVISOR_STATE_DRIVE && state != SUPERVISOR_STATE_ARMED)
        return TRAJECTORY_REFUSED;
    if (loop->telemetry.mode != CONTROL_MODE_POSE || !same_pose_command(loop, goal, arrival)) {
        const trajectory_status status =
            trajectory_plan(&loop->target, loop->settings, goal, arrival);
        if (status != TRAJECTORY_OK)
            return status;
        loop->command_pose = *goal;
        loop->command_arrival = *arrival;
    }
    grant(loop, CONTROL_MODE_POSE);
    return TRAJECTORY_OK;
}

u16 control_loop_command_duty(control_loop *loop, const i16 duty_q15[WHEEL_COUNT]) {
    u16 i;
    if (!grant(loop, CONTROL_MODE_DUTY))
        return 0;
    for (i = 0; i < WHEEL_COUNT; i++)
        loop->command_duty_q15[i] = duty_q15[i];
    return 1;
}

u16 control_loop_outside_pose(control_loop *loop, const odometry_pose *pose, i16 age_ms) {
    return outside_pose_take(&loop->outside, loop->settings, &loop->telemetry.pose, pose, age_ms,
                             loop->supervision.state == SUPERVISOR_STATE_DRIVE);
}

/* ---- Start ---- */

static void reset_telemetry(control_loop_telemetry *telemetry) {
    const kinematics_velocity still = {0, 0, 0};
    const odometry_pose origin = {0, 0, 0};
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        telemetry->duty_q15[i] = 0;
        telemetry->encoder_counts[i] = 0;
        telemetry->current_ma[i] = 0;
        telemetry->shaft_rad_s_q5[i] = 0;
        telemetry->force_n_q8[i] = 0;
        telemetry->slip_m_s_q13[i] = 0;
    }
    telemetry->supply_mv = 0;
    telemetry->null_slip_m_s_q13 = 0;
    telemetry->rolling = still;
    telemetry->observed = still;
    telemetry->pose = origin;
    telemetry->target = origin;
    telemetry->mode = CONTROL_MODE_IDLE;
    telemetry->limit = CONTROL_LIMIT_NONE;
    telemetry->limit_wheel = 0;
    telemetry->state = SUPERVISOR_STATE_BOOT;
    telemetry->fault = SUPERVISOR_FAULT_NONE;
    telemetry->fault_wheel = 0;
}

void control_loop_init(control_loop *loop, const parameters *p) {
    loop->settings = p;
    loop->bridges_on = 0;
    loop->counters_known = 0;
    loop->command_age_ms = 0;
    supervisor_start(&loop->supervision);
    reset_telemetry(&loop->telemetry);
    start_counting(loop);
    slip_observer_reset(&loop->observer);
    outside_pose_reset(&loop->outside, &loop->telemetry.pose);
    follow_motion(loop);
}
