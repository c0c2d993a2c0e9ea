/* Traction limit; equations in traction.h. */
#include "firmware/traction.h"

#include "firmware/fixed_point.h"
#include "firmware/odometry.h"

#define LINEAR_CHANGE_LIMIT_Q22 130000L  /* 31 m/s2 for 1 ms */
#define ANGULAR_CHANGE_LIMIT_Q22 530000L /* 126 rad/s2 for 1 ms */

static i32 clamp_i32(i32 value, i32 magnitude) {
    if (value > magnitude)
        return magnitude;
    return value < -magnitude ? -magnitude : value;
}

/* m/s Q22 per 1 ms -> m/s2 Q10: times 1000 / 2^12 = 125 / 2^9 */
static i16 acceleration_q10(i32 change_q22) {
    return fixed_saturate_i16(
        fixed_shift_right(clamp_i32(change_q22, LINEAR_CHANGE_LIMIT_Q22) * 125, 9));
}

/* rad/s Q22 per 1 ms -> rad/s2 Q8: times 1000 / 2^14 = 125 / 2^11 */
static i16 angular_acceleration_q8(i32 change_q22) {
    return fixed_saturate_i16(
        fixed_shift_right(clamp_i32(change_q22, ANGULAR_CHANGE_LIMIT_Q22) * 125, 11));
}

kinematics_force traction_inertia_force(const parameters *p, u16 heading,
                                        const traction_change *change) {
    i16 x_q10 = acceleration_q10(change->axis_q22[0]);
    i16 y_q10 = acceleration_q10(change->axis_q22[1]);
    const i16 turning_q8 = angular_acceleration_q8(change->axis_q22[2]);
    const i16 mass_q8 = PARAMETER_GET(p, mass_q8);
    kinematics_force force;
    odometry_rotate((u16)(0U - heading), &x_q10, &y_q10);
    force.x_n_q6 = fixed_saturate_i16(fixed_shift_right((i32)x_q10 * mass_q8, 12)); /* Q18 -> Q6 */
    force.y_n_q6 = fixed_saturate_i16(fixed_shift_right((i32)y_q10 * mass_q8, 12)); /* Q18 -> Q6 */
    force.torque_n_m_q8 = fixed_saturate_i16(
        fixed_shift_right((i32)turning_q8 * PARAMETER_GET(p, inertia_q12), 12)); /* Q20 -> Q8 */
    return force;
}

static u16 largest_force_q8(const parameters *p, u16 heading, const traction_change *change) {
    const kinematics_force force = traction_inertia_force(p, heading, change);
    i16 wheel_force_q8[WHEEL_COUNT];
    i32 largest = 0;
    u16 i;
    kinematics_wheel_forces(p, &force, wheel_force_q8);
    for (i = 0; i < WHEEL_COUNT; i++) {
        const i32 size = wheel_force_q8[i] < 0 ? -(i32)wheel_force_q8[i] : (i32)wheel_force_q8[i];
        if (size > largest)
            largest = size;
    }
    return (u16)largest;
}

u16 traction_limit(const parameters *p, u16 heading, traction_change *change) {
    const u16 limit_q8 = (u16)PARAMETER_GET(p, traction_limit_q8);
    const u16 largest_q8 = largest_force_q8(p, heading, change);
    i16 scale_q15;
    u16 axis;
    if (largest_q8 <= limit_q8)
        return 0;
    scale_q15 = (i16)fixed_divide((i32)limit_q8, largest_q8, 15); /* Q8 / Q8 * 2^15, below 1 */
    change->axis_q22[0] = clamp_i32(change->axis_q22[0], LINEAR_CHANGE_LIMIT_Q22);
    change->axis_q22[1] = clamp_i32(change->axis_q22[1], LINEAR_CHANGE_LIMIT_Q22);
    change->axis_q22[2] = clamp_i32(change->axis_q22[2], ANGULAR_CHANGE_LIMIT_Q22);
    for (axis = 0; axis < 3; axis++) {
        change->axis_q22[axis] = fixed_multiply_i32_q15(change->axis_q22[axis], scale_q15);
    }
    return 1;
}
