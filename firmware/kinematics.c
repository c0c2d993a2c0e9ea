/* Kinematics of four omnidirectional wheels; equations in kinematics.h.
 *
 * No parameter is -2^15 (parameters.def): two products of a parameter and an i16 fit into an i32.
 */
#include "firmware/kinematics.h"

#include "firmware/fixed_point.h"

void kinematics_inverse(const parameters *p, const kinematics_velocity *velocity,
                        i16 rim_m_s_q13[WHEEL_COUNT]) {
    const i16 *drive_x_q15 = PARAMETER_WHEELS(p, drive_x_1_q15);
    const i16 *drive_y_q15 = PARAMETER_WHEELS(p, drive_y_1_q15);
    /* Q15 * Q11 = Q26 */
    const i32 turning_q26 = (i32)PARAMETER_GET(p, wheel_distance_q15) * velocity->omega_rad_s_q11;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        /* Q15 * Q13 = Q28 */
        const i32 moving_q28 =
            (i32)drive_x_q15[i] * velocity->x_m_s_q13 + (i32)drive_y_q15[i] * velocity->y_m_s_q13;
        const i32 rim_q26 = moving_q28 / 4 + turning_q26; /* odd, as the rounding below */
        rim_m_s_q13[i] = fixed_saturate_i16(fixed_shift_right_odd(rim_q26, 13));
    }
}

static i32 dot_q26(const i16 row_q13[WHEEL_COUNT], const i16 rim_m_s_q13[WHEEL_COUNT]) {
    /* Q13 * Q13 = Q26 */
    return fixed_add_i32((i32)row_q13[0] * rim_m_s_q13[0] + (i32)row_q13[1] * rim_m_s_q13[1],
                         (i32)row_q13[2] * rim_m_s_q13[2] + (i32)row_q13[3] * rim_m_s_q13[3]);
}

void kinematics_forward(const parameters *p, const i16 rim_m_s_q13[WHEEL_COUNT],
                        kinematics_velocity *velocity) {
    const i32 x_q26 = dot_q26(PARAMETER_WHEELS(p, forward_x_1_q13), rim_m_s_q13);
    const i32 y_q26 = dot_q26(PARAMETER_WHEELS(p, forward_y_1_q13), rim_m_s_q13);
    const i32 omega_q26 = dot_q26(PARAMETER_WHEELS(p, forward_omega_1_q13), rim_m_s_q13);
    velocity->x_m_s_q13 = fixed_saturate_i16(fixed_shift_right(x_q26, 13));
    velocity->y_m_s_q13 = fixed_saturate_i16(fixed_shift_right(y_q26, 13));
    velocity->omega_rad_s_q11 = fixed_saturate_i16(fixed_shift_right(omega_q26, 15));
}

i16 kinematics_null_slip_m_s_q13(const parameters *p, const i16 rim_m_s_q13[WHEEL_COUNT]) {
    const i32 slip_q26 = dot_q26(PARAMETER_WHEELS(p, null_1_q13), rim_m_s_q13);
    return fixed_saturate_i16(fixed_shift_right(slip_q26, 13));
}

void kinematics_body_force(const parameters *p, const i16 force_n_q8[WHEEL_COUNT],
                           kinematics_force *force) {
    const i16 *drive_x_q15 = PARAMETER_WHEELS(p, drive_x_1_q15);
    const i16 *drive_y_q15 = PARAMETER_WHEELS(p, drive_y_1_q15);
    i32 x_q20 = 0;
    i32 y_q20 = 0;
    i32 sum_q8 = 0;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        /* Q15 * Q8 = Q23 -> Q20, so that four of them cannot overflow */
        x_q20 += fixed_shift_right((i32)drive_x_q15[i] * force_n_q8[i], 3);
        y_q20 += fixed_shift_right((i32)drive_y_q15[i] * force_n_q8[i], 3);
        sum_q8 += force_n_q8[i];
    }
    force->x_n_q6 = fixed_saturate_i16(fixed_shift_right(x_q20, 14));
    force->y_n_q6 = fixed_saturate_i16(fixed_shift_right(y_q20, 14));
    /* m Q15 * N Q8 -> N m Q8 */
    force->torque_n_m_q8 =
        fixed_saturate_i16(fixed_multiply_i32_q15(sum_q8, PARAMETER_GET(p, wheel_distance_q15)));
}

void kinematics_wheel_forces(const parameters *p, const kinematics_force *force,
                             i16 force_n_q8[WHEEL_COUNT]) {
    const i16 *forward_x_q13 = PARAMETER_WHEELS(p, forward_x_1_q13);
    const i16 *forward_y_q13 = PARAMETER_WHEELS(p, forward_y_1_q13);
    const i16 *forward_omega_q13 = PARAMETER_WHEELS(p, forward_omega_1_q13);
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        /* Q13 * Q6 = Q19 */
        const i32 pushing_q19 =
            (i32)forward_x_q13[i] * force->x_n_q6 + (i32)forward_y_q13[i] * force->y_n_q6;
        /* Q13 * Q8 = Q21 -> Q19 */
        const i32 turning_q19 =
            fixed_shift_right((i32)forward_omega_q13[i] * force->torque_n_m_q8, 2);
        force_n_q8[i] =
            fixed_saturate_i16(fixed_shift_right(fixed_add_i32(pushing_q19, turning_q19), 11));
    }
}
