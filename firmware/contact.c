/* Contact law of a wheel; equations in contact.h. */
#include "firmware/contact.h"

#include "firmware/fixed_point.h"

contact_slip contact_slip_from_force(const parameters *p, i16 force_n_q8) {
    contact_slip result;
    /* Q8 * Q15 = Q23 -> Q15 */
    const i32 share_q15 =
        fixed_shift_right((i32)force_n_q8 * PARAMETER_GET(p, grip_inverse_q15), 8);
    const i16 limited_q15 = fixed_clamp_i16(share_q15, PARAMETER_GET(p, slip_saturation_q15));
    i16 cosine_q15;
    const i16 tangent_q10 = fixed_tangent_quarter_q10(limited_q15, &cosine_q15);
    /* Q10 * Q18 = Q28 -> Q13 */
    result.slip_m_s_q13 = fixed_saturate_i16(
        fixed_shift_right((i32)tangent_q10 * PARAMETER_GET(p, slip_per_tangent_q18), 15));
    result.trust_q15 = fixed_multiply_q15(cosine_q15, cosine_q15);
    return result;
}

kinematics_force contact_roller_force(const parameters *p, i16 x_m_s_q13, i16 y_m_s_q13) {
    const i16 *drive_x_q15 = PARAMETER_WHEELS(p, drive_x_1_q15);
    const i16 *drive_y_q15 = PARAMETER_WHEELS(p, drive_y_1_q15);
    i32 x_q20 = 0;
    i32 y_q20 = 0;
    kinematics_force force;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        /* The roller direction is the drive direction turned by -90 degrees. */
        const i32 hub_q28 = (i32)drive_y_q15[i] * x_m_s_q13 - (i32)drive_x_q15[i] * y_m_s_q13;
        /* k V_F as the ratio of V_F and 1/k, both Q18; a quarter turn of 2^14 makes (2/pi) atan
         * Q14. */
        const i16 share_q14 =
            fixed_atan2(fixed_shift_right(hub_q28, 10), PARAMETER_GET(p, slip_per_tangent_q18));
        /* Q14 * Q8 = Q22 -> Q8 */
        const i16 pull_n_q8 =
            (i16)-fixed_shift_right((i32)share_q14 * PARAMETER_GET(p, roller_grip_q8), 14);
        x_q20 += fixed_shift_right((i32)drive_y_q15[i] * pull_n_q8, 3);  /* Q23 -> Q20 */
        y_q20 += fixed_shift_right(-(i32)drive_x_q15[i] * pull_n_q8, 3); /* Q23 -> Q20 */
    }
    force.x_n_q6 = fixed_saturate_i16(fixed_shift_right(x_q20, 14));
    force.y_n_q6 = fixed_saturate_i16(fixed_shift_right(y_q20, 14));
    force.torque_n_m_q8 = 0;
    return force;
}
