/* PID control of one shaft speed; equation in wheel_pid.h. */
#include "firmware/wheel_pid.h"

#include "firmware/fixed_point.h"

void wheel_pid_reset(wheel_pid *pid, i16 shaft_rad_s_q5) {
    pid->integral_v_q21 = 0;
    pid->shaft_before_rad_s_q5 = shaft_rad_s_q5;
}

i16 wheel_pid_step_v_q9(wheel_pid *pid, const parameters *p, const wheel_pid_input *input,
                        u16 *limited) {
    const i16 error_q5 = fixed_subtract_i16(input->target_rad_s_q5, input->shaft_rad_s_q5);
    const i16 change_q5 = fixed_subtract_i16(input->shaft_rad_s_q5, pid->shaft_before_rad_s_q5);
    /* Q5 * Q22 = Q27 -> Q21 */
    const i32 step_q21 = fixed_shift_right((i32)error_q5 * PARAMETER_GET(p, speed_integral_q22), 6);
    const i32 integral_q21 = fixed_add_i32(pid->integral_v_q21, step_q21);
    i32 sum_q9 = input->feed_forward_v_q9;
    i16 output_q9;
    sum_q9 +=
        fixed_shift_right((i32)error_q5 * PARAMETER_GET(p, speed_gain_q15), 11); /* Q20 -> Q9 */
    sum_q9 -=
        fixed_shift_right((i32)change_q5 * PARAMETER_GET(p, speed_derivative_q12), 8); /* Q17 */
    sum_q9 += fixed_shift_right(integral_q21, 12); /* Q21 -> Q9 */
    output_q9 = fixed_clamp_i16(sum_q9, input->limit_v_q9);
    if (output_q9 != sum_q9)
        *limited = 1;
    if ((sum_q9 <= output_q9 || step_q21 < 0) && (sum_q9 >= output_q9 || step_q21 > 0)) {
        pid->integral_v_q21 = integral_q21;
    }
    pid->shaft_before_rad_s_q5 = input->shaft_rad_s_q5;
    return output_q9;
}
