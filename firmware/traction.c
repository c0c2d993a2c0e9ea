/* Traction limit; equations in traction.h. */
#include "firmware/traction.h"

#include "firmware/fixed_point.h"

#define LINEAR_CHANGE_LIMIT_Q22 130000L  /* 31 m/s2 for 1 ms */
#define ANGULAR_CHANGE_LIMIT_Q22 530000L /* 126 rad/s2 for 1 ms */

/* m/s Q22 per 1 ms -> m/s2 Q10: times 1000 / 2^12 = 125 / 2^9 */
static i16 acceleration_q10(i32 change_q22) {
    return fixed_saturate_i16(
        fixed_shift_right(fixed_clamp_i32(change_q22, LINEAR_CHANGE_LIMIT_Q22) * 125, 9));
}

/* rad/s Q22 per 1 ms -> rad/s2 Q8: times 1000 / 2^14 = 125 / 2^11 */
static i16 angular_acceleration_q8(i32 change_q22) {
    return fixed_saturate_i16(
        fixed_shift_right(fixed_clamp_i32(change_q22, ANGULAR_CHANGE_LIMIT_Q22) * 125, 11));
}

kinematics_force traction_inertia_force(const parameters *p, odometry_heading heading,
                                        const traction_change *change) {
    i16 x_q10 = acceleration_q10(change->axis_q22[0]);
    i16 y_q10 = acceleration_q10(change->axis_q22[1]);
    const i16 turning_q8 = angular_acceleration_q8(change->axis_q22[2]);
    const i16 mass_q8 = PARAMETER_GET(p, mass_q8);
    kinematics_force force;
    odometry_world_to_body(heading, &x_q10, &y_q10);
    force.x_n_q6 = fixed_saturate_i16(fixed_shift_right((i32)x_q10 * mass_q8, 12)); /* Q18 -> Q6 */
    force.y_n_q6 = fixed_saturate_i16(fixed_shift_right((i32)y_q10 * mass_q8, 12)); /* Q18 -> Q6 */
    force.torque_n_m_q8 = fixed_saturate_i16(
        fixed_shift_right((i32)turning_q8 * PARAMETER_GET(p, inertia_q13), 13)); /* Q21 -> Q8 */
    return force;
}

/* ---- Spreading the load ---- */

typedef struct {
    i16 force_q8[WHEEL_COUNT];   /* G_i of the header */
    i16 weight_q13[WHEEL_COUNT]; /* w_i */
} null_space;

static u16 pair_weight_q13(const null_space *space, u16 i, u16 j) {
    return (u16)((u16)space->weight_q13[i] + (u16)space->weight_q13[j]);
}

/* |V_ij| (w_i + w_j), Q6; 0 for a pair that the null space does not reach. */
static u16 pair_load_q6(const null_space *space, u16 i, u16 j) {
    i32 load_q21;
    if (space->weight_q13[i] == 0 || space->weight_q13[j] == 0)
        return 0;
    load_q21 = (i32)space->weight_q13[j] * space->force_q8[i] -
               (i32)space->weight_q13[i] * space->force_q8[j]; /* Q13 * Q8 */
    return (u16)((load_q21 < 0 ? -load_q21 : load_q21) >> 15);
}

/* z of the header. */
static i16 best_null_force_n_q8(const null_space *space) {
    u16 load_q6 = 0;
    u16 weight_q13 = 1;
    i32 opposite_q8 = 0;
    u16 i, j;
    for (i = 0; i < WHEEL_COUNT; i++) {
        for (j = (u16)(i + 1U); j < WHEEL_COUNT; j++) {
            const u16 pair_q6 = pair_load_q6(space, i, j);
            const u16 pair_q13 = pair_weight_q13(space, i, j);
            if ((u32)pair_q6 * weight_q13 > (u32)load_q6 * pair_q13) {
                load_q6 = pair_q6;
                weight_q13 = pair_q13;
                opposite_q8 = -((i32)space->force_q8[i] + space->force_q8[j]);
            }
        }
    }
    return fixed_saturate_i16(fixed_divide(opposite_q8, weight_q13, 13));
}

static void spread(const parameters *p, i16 force_n_q8[WHEEL_COUNT]) {
    const i16 *null_q13 = PARAMETER_WHEELS(p, null_1_q13);
    null_space space;
    i16 null_force_q8;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        space.force_q8[i] = null_q13[i] < 0 ? fixed_subtract_i16(0, force_n_q8[i]) : force_n_q8[i];
        space.weight_q13[i] = (i16)(null_q13[i] < 0 ? -null_q13[i] : null_q13[i]);
    }
    null_force_q8 = best_null_force_n_q8(&space);
    for (i = 0; i < WHEEL_COUNT; i++) {
        force_n_q8[i] =
            fixed_add_i16(force_n_q8[i], fixed_saturate_i16(fixed_shift_right(
                                             (i32)null_force_q8 * null_q13[i], 13))); /* Q8 * Q13 */
    }
}

void traction_wheel_forces(const parameters *p, const kinematics_force *force,
                           i16 force_n_q8[WHEEL_COUNT]) {
    kinematics_wheel_forces(p, force, force_n_q8);
    spread(p, force_n_q8);
}

/* ---- The limit ---- */

/* The first of the wheels with the largest force, 0..3. */
static u16 most_loaded(const i16 force_n_q8[WHEEL_COUNT], u16 *largest_q8) {
    u16 wheel = 0;
    u16 i;
    *largest_q8 = 0;
    for (i = 0; i < WHEEL_COUNT; i++) {
        const u16 size_q8 = (u16)(force_n_q8[i] < 0 ? -(i32)force_n_q8[i] : (i32)force_n_q8[i]);
        if (size_q8 > *largest_q8) {
            *largest_q8 = size_q8;
            wheel = i;
        }
    }
    return wheel;
}

/* Forces of the wheels for 1 / 2^bits of a change, before they are spread; returns the most loaded
 * one, 0..3. */
static u16 wheel_loads(const parameters *p, odometry_heading heading, const traction_change *change,
                       u16 bits, i16 force_n_q8[WHEEL_COUNT], u16 *largest_q8) {
    traction_change part;
    kinematics_force force;
    u16 axis;
    for (axis = 0; axis < 3; axis++)
        part.axis_q22[axis] = change->axis_q22[axis] / ((i32)1 << bits);
    force = traction_inertia_force(p, heading, &part);
    kinematics_wheel_forces(p, &force, force_n_q8);
    return most_loaded(force_n_q8, largest_q8);
}

u16 traction_limit(const parameters *p, odometry_heading heading, traction_change *change) {
    const u16 limit_q8 = (u16)PARAMETER_GET(p, traction_limit_q8);
    traction_change clamped;
    i16 force_n_q8[WHEEL_COUNT];
    u16 largest_q8;
    u16 bits = 0;
    i16 scale_q15;
    u16 wheel, axis;
    clamped.axis_q22[0] = fixed_clamp_i32(change->axis_q22[0], LINEAR_CHANGE_LIMIT_Q22);
    clamped.axis_q22[1] = fixed_clamp_i32(change->axis_q22[1], LINEAR_CHANGE_LIMIT_Q22);
    clamped.axis_q22[2] = fixed_clamp_i32(change->axis_q22[2], ANGULAR_CHANGE_LIMIT_Q22);
    wheel = wheel_loads(p, heading, &clamped, 0, force_n_q8, &largest_q8);
    if (largest_q8 <= limit_q8)
        return 0;                /* spreading could only make it less */
    if (largest_q8 >= I16_MAX) { /* saturated: a sixteenth of the demand tells how large it is */
        bits = 4;
        wheel = wheel_loads(p, heading, &clamped, bits, force_n_q8, &largest_q8);
    }
    spread(p, force_n_q8);
    most_loaded(force_n_q8, &largest_q8);
    if ((u32)largest_q8 << bits <= limit_q8)
        return 0;
    /* Q8 / Q8 * 2^15, below 1 */
    scale_q15 = (i16)fixed_divide((i32)limit_q8, largest_q8, (u16)(15U - bits));
    for (axis = 0; axis < 3; axis++) {
        change->axis_q22[axis] = fixed_multiply_i32_q15(clamped.axis_q22[axis], scale_q15);
    }
    return (u16)(wheel + 1U);
}
