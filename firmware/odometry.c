/* Pose from body velocity; equations and units in odometry.h. */
#include "firmware/odometry.h"

#include "firmware/fixed_point.h"

i32 odometry_wrap_mrad_q13(i32 angle_mrad_q13) {
    if (angle_mrad_q13 > ODOMETRY_FULL_TURN_MRAD_Q13 / 2) {
        return angle_mrad_q13 - ODOMETRY_FULL_TURN_MRAD_Q13;
    }
    if (angle_mrad_q13 <= -ODOMETRY_FULL_TURN_MRAD_Q13 / 2) {
        return angle_mrad_q13 + ODOMETRY_FULL_TURN_MRAD_Q13;
    }
    return angle_mrad_q13;
}

u16 odometry_binary_angle(i32 angle_mrad_q13) {
    /* 65536 / 51471854 = 21361 / 2^24, relative error 2e-5 */
    const i32 angle_q9 = fixed_multiply_i32_q15(odometry_wrap_mrad_q13(angle_mrad_q13), 21361);
    return (u16)(fixed_shift_right(angle_q9, 9) & 0xFFFFL);
}

odometry_heading odometry_heading_of(u16 angle) {
    odometry_heading heading;
    heading.cosine_q15 = fixed_cosine_q15(angle);
    heading.sine_q15 = fixed_sine_q15(angle);
    return heading;
}

void odometry_body_to_world(odometry_heading heading, i16 *x, i16 *y) {
    /* Qn * Q15 -> Qn; sine and cosine are never -1, so two products fit into an i32 */
    const i32 turned_x = (i32)heading.cosine_q15 * *x - (i32)heading.sine_q15 * *y;
    const i32 turned_y = (i32)heading.sine_q15 * *x + (i32)heading.cosine_q15 * *y;
    *x = fixed_saturate_i16(fixed_shift_right(turned_x, 15));
    *y = fixed_saturate_i16(fixed_shift_right(turned_y, 15));
}

void odometry_world_to_body(odometry_heading heading, i16 *x, i16 *y) {
    heading.sine_q15 = (i16)-heading.sine_q15; /* never -1: fixed_sine_q15 is odd */
    odometry_body_to_world(heading, x, y);
}

void odometry_rotate(u16 angle, i16 *x, i16 *y) {
    odometry_body_to_world(odometry_heading_of(angle), x, y);
}

void odometry_step(odometry_pose *pose, const kinematics_velocity *body) {
    const i32 turn_mrad_q13 = (i32)body->omega_rad_s_q11 * 4; /* Q11 -> Q13 */
    i16 x_m_s_q13 = body->x_m_s_q13;
    i16 y_m_s_q13 = body->y_m_s_q13;
    odometry_rotate(odometry_binary_angle(pose->theta_mrad_q13 + turn_mrad_q13 / 2), &x_m_s_q13,
                    &y_m_s_q13);
    pose->x_mm_q13 = fixed_add_i32(pose->x_mm_q13, x_m_s_q13);
    pose->y_mm_q13 = fixed_add_i32(pose->y_mm_q13, y_m_s_q13);
    pose->theta_mrad_q13 = odometry_wrap_mrad_q13(pose->theta_mrad_q13 + turn_mrad_q13);
}
