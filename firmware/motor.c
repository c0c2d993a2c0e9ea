/* Motor balance seen at the rim; equations in motor.h. */
#include "firmware/motor.h"

#include "firmware/fixed_point.h"

#define COULOMB_RAMP_RAD_S_Q5 128

static i32 losses_n_q19(const parameters *p, i16 shaft_rad_s_q5) {
    const i16 sign_q7 = fixed_clamp_i16(shaft_rad_s_q5, COULOMB_RAMP_RAD_S_Q5);
    const i32 drag_q19 = (i32)PARAMETER_GET(p, drag_q14) * shaft_rad_s_q5;     /* Q14 * Q5 = Q19 */
    const i32 coulomb_q15 = (i32)PARAMETER_GET(p, coulomb_force_q8) * sign_q7; /* Q8 * Q7 = Q15 */
    return drag_q19 + coulomb_q15 * 16; /* below 2^30 + 2^26 */
}

i32 motor_steady_force_n_q19(const parameters *p, i16 voltage_v_q9, i16 shaft_rad_s_q5) {
    const i32 drive_q19 = (i32)PARAMETER_GET(p, force_per_volt_q10) * voltage_v_q9; /* Q10 * Q9 */
    return fixed_subtract_i32(drive_q19, losses_n_q19(p, shaft_rad_s_q5));
}

i16 motor_dry_slack_n_q8(const parameters *p, i16 shaft_rad_s_q5) {
    const i16 sign_q7 = fixed_clamp_i16(shaft_rad_s_q5, COULOMB_RAMP_RAD_S_Q5);
    const i16 slack_q7 = (i16)(COULOMB_RAMP_RAD_S_Q5 - (sign_q7 < 0 ? -sign_q7 : sign_q7));
    /* Q8 * Q7 = Q15 -> Q8 */
    return fixed_saturate_i16(
        fixed_shift_right((i32)PARAMETER_GET(p, coulomb_force_q8) * slack_q7, 7));
}

i32 motor_inertia_force_n_q15(const parameters *p, i16 shaft_change_rad_s_q5) {
    return (i32)PARAMETER_GET(p, momentum_per_tick_q10) * shaft_change_rad_s_q5; /* Q10 * Q5 */
}

i16 motor_voltage_v_q9(const parameters *p, i16 force_n_q8, i16 shaft_rad_s_q5,
                       i16 shaft_change_rad_s_q5) {
    const i32 inertia_q15 = motor_inertia_force_n_q15(p, shaft_change_rad_s_q5);
    i32 sum_q6 = fixed_shift_right(force_n_q8, 2);
    sum_q6 += fixed_shift_right(losses_n_q19(p, shaft_rad_s_q5), 13);
    sum_q6 += fixed_shift_right(inertia_q15, 9);
    /* Q6 * Q13 = Q19 -> Q9 */
    return fixed_saturate_i16(fixed_shift_right(
        (i32)fixed_saturate_i16(sum_q6) * PARAMETER_GET(p, volt_per_force_q13), 10));
}
