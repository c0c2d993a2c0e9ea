/* Corrections by an outside pose; derivation in outside_pose.h. */
#include "firmware/outside_pose.h"

#include "firmware/fixed_point.h"

#define LARGEST_STEP_MM_Q13 2048 /* 0.25 mm */
#define LARGEST_WAY_Q13 ((i32)I32_MAX / OUTSIDE_POSE_SPACING_MS)
#define LARGEST_STEP_MRAD_Q13 4096 /* 0.5 mrad */

static odometry_pose sum(const odometry_pose *a, const odometry_pose *b) {
    odometry_pose result;
    result.x_mm_q13 = fixed_add_i32(a->x_mm_q13, b->x_mm_q13);
    result.y_mm_q13 = fixed_add_i32(a->y_mm_q13, b->y_mm_q13);
    result.theta_mrad_q13 =
        odometry_wrap_mrad_q13(fixed_add_i32(a->theta_mrad_q13, b->theta_mrad_q13));
    return result;
}

static odometry_pose difference(const odometry_pose *a, const odometry_pose *b) {
    odometry_pose result;
    result.x_mm_q13 = fixed_subtract_i32(a->x_mm_q13, b->x_mm_q13);
    result.y_mm_q13 = fixed_subtract_i32(a->y_mm_q13, b->y_mm_q13);
    result.theta_mrad_q13 =
        odometry_wrap_mrad_q13(fixed_subtract_i32(a->theta_mrad_q13, b->theta_mrad_q13));
    return result;
}

void outside_pose_reset(outside_pose *outside, const odometry_pose *pose) {
    const odometry_pose none = {0, 0, 0};
    u16 i;
    for (i = 0; i < OUTSIDE_POSE_PAST; i++)
        outside->past[i] = *pose;
    outside->newest = 0;
    outside->newest_age_ms = 0;
    outside->given = none;
    outside->left = none;
}

static i32 step_of(i32 left_q13, i16 largest_q13) {
    return fixed_clamp_i16(fixed_shift_right(left_q13, 6), largest_q13);
}

void outside_pose_step(outside_pose *outside, odometry_pose *pose) {
    odometry_pose step;
    step.x_mm_q13 = step_of(outside->left.x_mm_q13, LARGEST_STEP_MM_Q13);
    step.y_mm_q13 = step_of(outside->left.y_mm_q13, LARGEST_STEP_MM_Q13);
    step.theta_mrad_q13 = step_of(outside->left.theta_mrad_q13, LARGEST_STEP_MRAD_Q13);
    *pose = sum(pose, &step);
    outside->given = sum(&outside->given, &step);
    outside->left = difference(&outside->left, &step);
    outside->newest_age_ms++;
    if (outside->newest_age_ms >= OUTSIDE_POSE_SPACING_MS) {
        outside->newest = (u16)((outside->newest + 1U) % OUTSIDE_POSE_PAST);
        outside->newest_age_ms = 0;
        outside->past[outside->newest] = difference(pose, &outside->given);
    }
}

/* Less than 64 mm and 0.26 rad lie between two poses of the ring. */
static i32 share_of(i32 whole, u16 part_ms, u16 whole_ms) {
    return fixed_clamp_i32(whole, LARGEST_WAY_Q13) * (i32)part_ms / (i32)whole_ms;
}

/* What the robot now believes to have been its pose age_ms ago. */
static odometry_pose believed(const outside_pose *outside, const odometry_pose *pose, u16 age_ms) {
    odometry_pose newer = difference(pose, &outside->given);
    odometry_pose older = outside->past[outside->newest];
    odometry_pose way;
    u16 gap_ms = outside->newest_age_ms;
    u16 index = outside->newest;
    while (age_ms > gap_ms) {
        age_ms = (u16)(age_ms - gap_ms); /* from now on before `newer` */
        gap_ms = OUTSIDE_POSE_SPACING_MS;
        newer = older;
        index = (u16)((index + OUTSIDE_POSE_PAST - 1U) % OUTSIDE_POSE_PAST);
        older = outside->past[index];
    }
    if (gap_ms > 0) {
        way = difference(&older, &newer);
        way.x_mm_q13 = share_of(way.x_mm_q13, age_ms, gap_ms);
        way.y_mm_q13 = share_of(way.y_mm_q13, age_ms, gap_ms);
        way.theta_mrad_q13 = share_of(way.theta_mrad_q13, age_ms, gap_ms);
        newer = sum(&newer, &way);
    }
    return sum(&newer, &outside->given);
}

/* c of the header. */
static odometry_pose error_of(const odometry_pose *pose, const odometry_pose *before,
                              const odometry_pose *seen) {
    odometry_pose error = difference(seen, before);
    const odometry_pose motion = difference(pose, before);
    /* mm Q13 -> Q5: 1 m, more than is driven in 240 ms */
    const i16 x_q5 = fixed_saturate_i16(fixed_shift_right(motion.x_mm_q13, 8));
    const i16 y_q5 = fixed_saturate_i16(fixed_shift_right(motion.y_mm_q13, 8));
    i16 turned_x_q5 = x_q5;
    i16 turned_y_q5 = y_q5;
    odometry_rotate(odometry_binary_angle(error.theta_mrad_q13), &turned_x_q5, &turned_y_q5);
    error.x_mm_q13 = fixed_add_i32(error.x_mm_q13, ((i32)turned_x_q5 - x_q5) * 256);
    error.y_mm_q13 = fixed_add_i32(error.y_mm_q13, ((i32)turned_y_q5 - y_q5) * 256);
    return error;
}

static i32 blended(i32 left, i32 error, i16 gain_q15) {
    return fixed_add_i32(left, fixed_multiply_i32_q15(fixed_subtract_i32(error, left), gain_q15));
}

u16 outside_pose_take(outside_pose *outside, const parameters *p, odometry_pose *pose,
                      const odometry_pose *seen, i16 age_ms, u16 driving) {
    const i16 gain_q15 = PARAMETER_GET(p, outside_pose_gain_q15);
    odometry_pose wrapped = *seen;
    odometry_pose before, error;
    if (age_ms < 0 || age_ms > OUTSIDE_POSE_LONGEST_AGE_MS || gain_q15 == 0)
        return 0;
    wrapped.theta_mrad_q13 =
        odometry_wrap_mrad_q13(wrapped.theta_mrad_q13 % ODOMETRY_FULL_TURN_MRAD_Q13);
    before = believed(outside, pose, (u16)age_ms);
    error = error_of(pose, &before, &wrapped);
    if (!driving) {
        *pose = sum(pose, &error);
        outside->given = sum(&outside->given, &error);
        outside->left = difference(&outside->left, &outside->left);
        return 1;
    }
    outside->left.x_mm_q13 = blended(outside->left.x_mm_q13, error.x_mm_q13, gain_q15);
    outside->left.y_mm_q13 = blended(outside->left.y_mm_q13, error.y_mm_q13, gain_q15);
    outside->left.theta_mrad_q13 =
        blended(outside->left.theta_mrad_q13, error.theta_mrad_q13, gain_q15);
    return 1;
}
