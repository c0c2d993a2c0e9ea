/* Body velocity from wheels that slip; derivation in slip_observer.h. */
#include "firmware/slip_observer.h"

#include "firmware/fixed_point.h"
#include "firmware/motor.h"

void slip_observer_reset(slip_observer *observer) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        observer->balance_n_q19[i] = 0;
        observer->force_n_q8[i] = 0;
        observer->shaft_before_rad_s_q5[i] = 0;
        observer->slip_m_s_q13[i] = 0;
    }
    observer->x_m_s_q22 = 0;
    observer->y_m_s_q22 = 0;
    observer->omega_rad_s_q22 = 0;
}

kinematics_velocity slip_observer_velocity(const slip_observer *observer) {
    kinematics_velocity velocity;
    velocity.x_m_s_q13 = fixed_saturate_i16(fixed_shift_right(observer->x_m_s_q22, 9));
    velocity.y_m_s_q13 = fixed_saturate_i16(fixed_shift_right(observer->y_m_s_q22, 9));
    velocity.omega_rad_s_q11 = fixed_saturate_i16(fixed_shift_right(observer->omega_rad_s_q22, 11));
    return velocity;
}

/* The value, closer to zero by the slack. */
static i16 without_slack(i16 value, i16 slack) {
    if (value > slack)
        return (i16)(value - slack);
    return value < -slack ? (i16)(value + slack) : 0;
}

/* Step 1 of the header. */
static void update_force(slip_observer *observer, const parameters *p, u16 wheel, i16 voltage_v_q9,
                         i16 shaft_rad_s_q5) {
    const i16 change_q5 =
        fixed_subtract_i16(shaft_rad_s_q5, observer->shaft_before_rad_s_q5[wheel]);
    const i32 inertia_q19 = fixed_shift_left(motor_inertia_force_n_q15(p, change_q5), 4);
    i32 error_q19 = motor_steady_force_n_q19(p, voltage_v_q9, shaft_rad_s_q5);
    error_q19 = fixed_subtract_i32(error_q19, inertia_q19);
    error_q19 = fixed_subtract_i32(error_q19, observer->balance_n_q19[wheel]);
    observer->balance_n_q19[wheel] =
        fixed_add_i32(observer->balance_n_q19[wheel],
                      fixed_multiply_i32_q15(error_q19, PARAMETER_GET(p, force_filter_q15)));
    observer->force_n_q8[wheel] = without_slack(
        fixed_saturate_i16(fixed_shift_right(observer->balance_n_q19[wheel], 11)), /* Q19 -> Q8 */
        motor_dry_slack_n_q8(p, shaft_rad_s_q5));
    observer->shaft_before_rad_s_q5[wheel] = shaft_rad_s_q5;
}

/* omega * v over one tick: rad/s Q11 * m/s Q13 = Q24, times 1 ms -> m/s Q22 */
static i32 turning_change_m_s_q22(i16 omega_rad_s_q11, i16 speed_m_s_q13) {
    return fixed_shift_right((i32)omega_rad_s_q11 * speed_m_s_q13, 2) / 1000;
}

static void integrate(i32 *state, i32 change) {
    *state = fixed_add_i32(*state, change);
}

/* Step 3 of the header. */
static void predict(slip_observer *observer, const parameters *p, const kinematics_velocity *v) {
    const kinematics_force roller = contact_roller_force(p, v->x_m_s_q13, v->y_m_s_q13);
    const i16 per_force_q25 = PARAMETER_GET(p, velocity_per_force_q25);
    kinematics_force drive;
    kinematics_body_force(p, observer->force_n_q8, &drive);
    /* Q6 * Q25 = Q31 -> Q22 */
    integrate(
        &observer->x_m_s_q22,
        fixed_shift_right((i32)fixed_add_i16(drive.x_n_q6, roller.x_n_q6) * per_force_q25, 9));
    integrate(
        &observer->y_m_s_q22,
        fixed_shift_right((i32)fixed_add_i16(drive.y_n_q6, roller.y_n_q6) * per_force_q25, 9));
    /* Q8 * Q16 = Q24 -> Q22 */
    integrate(
        &observer->omega_rad_s_q22,
        fixed_shift_right((i32)drive.torque_n_m_q8 * PARAMETER_GET(p, omega_per_torque_q16), 2));
    integrate(&observer->x_m_s_q22, turning_change_m_s_q22(v->omega_rad_s_q11, v->y_m_s_q13));
    integrate(&observer->y_m_s_q22, -turning_change_m_s_q22(v->omega_rad_s_q11, v->x_m_s_q13));
}

/* g c_i of step 4. */
static i16 wheel_gain_q15(const parameters *p, i16 trust_q15) {
    const i16 floor_q15 = PARAMETER_GET(p, trust_floor_q15);
    const i16 used_q15 = trust_q15 > floor_q15 ? trust_q15 : floor_q15;
    return fixed_multiply_q15(PARAMETER_GET(p, observer_gain_q15), used_q15);
}

/* Steps 2 and 4 of the header. */
static void correct(slip_observer *observer, const parameters *p, const kinematics_velocity *v,
                    const i16 rim_m_s_q13[WHEEL_COUNT]) {
    const i16 *forward_x_q13 = PARAMETER_WHEELS(p, forward_x_1_q13);
    const i16 *forward_y_q13 = PARAMETER_WHEELS(p, forward_y_1_q13);
    const i16 *forward_omega_q13 = PARAMETER_WHEELS(p, forward_omega_1_q13);
    i16 expected_m_s_q13[WHEEL_COUNT];
    u16 i;
    kinematics_inverse(p, v, expected_m_s_q13);
    for (i = 0; i < WHEEL_COUNT; i++) {
        const contact_slip contact = contact_slip_from_force(p, observer->force_n_q8[i]);
        const i16 hub_q13 = fixed_subtract_i16(rim_m_s_q13[i], contact.slip_m_s_q13);
        const i16 error_q13 = fixed_subtract_i16(hub_q13, expected_m_s_q13[i]);
        /* Q13 * Q15 = Q28 -> Q17 */
        const i16 step_q17 = fixed_saturate_i16(
            fixed_shift_right((i32)error_q13 * wheel_gain_q15(p, contact.trust_q15), 11));
        observer->slip_m_s_q13[i] = contact.slip_m_s_q13;
        /* Q13 * Q17 = Q30 -> Q22 */
        integrate(&observer->x_m_s_q22, fixed_shift_right((i32)forward_x_q13[i] * step_q17, 8));
        integrate(&observer->y_m_s_q22, fixed_shift_right((i32)forward_y_q13[i] * step_q17, 8));
        integrate(&observer->omega_rad_s_q22,
                  fixed_shift_right((i32)forward_omega_q13[i] * step_q17, 8));
    }
}

void slip_observer_step(slip_observer *observer, const parameters *p,
                        const i16 voltage_v_q9[WHEEL_COUNT], const i16 shaft_rad_s_q5[WHEEL_COUNT],
                        const i16 rim_m_s_q13[WHEEL_COUNT]) {
    const kinematics_velocity before = slip_observer_velocity(observer);
    kinematics_velocity predicted;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        update_force(observer, p, i, voltage_v_q9[i], shaft_rad_s_q5[i]);
    }
    predict(observer, p, &before);
    predicted = slip_observer_velocity(observer);
    correct(observer, p, &predicted, rim_m_s_q13);
}
