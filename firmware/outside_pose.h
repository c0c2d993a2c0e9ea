/* Corrections of the odometry by an outside pose (a camera), which arrives late.
 *
 * The pose seen, q, is compared with what the robot believed when the picture was taken, b, and the
 * motion since is kept, turned by the heading error e = q_theta - b_theta:
 *
 *     error of the present pose p     c = q + R(e) (p - b) - p,   c_theta = e
 *
 * b comes from a ring of poses, one every 16 ms, between which it is interpolated: with 5 m/s2 or
 * 20 rad/s2 that is right within 0.2 mm and 0.7 mrad. The ring holds poses without the corrections
 * given so far, so that a correction given after the picture was taken is not given again.
 *
 * Driving, c is not given at once: the part outside_pose_gain of what is new about it joins what
 * is left to give, r += g (c - r), and each tick gives r / 64, at most 0.25 mm and 0.5 mrad. The
 * position controller sees the error grow no faster than that, so the demanded speed does not jump.
 * A robot that does not drive takes the pose as it is.
 */
#ifndef FIRMWARE_OUTSIDE_POSE_H
#define FIRMWARE_OUTSIDE_POSE_H

#include "firmware/odometry.h"
#include "firmware/parameters.h"

#define OUTSIDE_POSE_PAST 16
#define OUTSIDE_POSE_SPACING_MS 16
/* The oldest picture that can be used, 240 ms. */
#define OUTSIDE_POSE_LONGEST_AGE_MS ((OUTSIDE_POSE_PAST - 1) * OUTSIDE_POSE_SPACING_MS)

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    odometry_pose past[OUTSIDE_POSE_PAST];
    u16 newest;
    u16 newest_age_ms;
    odometry_pose given; /* sum of the corrections of the present pose */
    odometry_pose left;  /* to give */
} outside_pose;

/* The robot has always been at this pose. */
void outside_pose_reset(outside_pose *outside, const odometry_pose *pose);
/* Every tick, after the odometry: corrects the pose and remembers it. */
void outside_pose_step(outside_pose *outside, odometry_pose *pose);
/* Takes what was seen age_ms ago; theta may be any angle. Driving: for the ticks to come, else the
 * pose is corrected now. Returns 0, and nothing changes, when the age is negative or too great or
 * the gain is 0. */
u16 outside_pose_take(outside_pose *outside, const parameters *p, odometry_pose *pose,
                      const odometry_pose *seen, i16 age_ms, u16 driving);

#ifdef __cplusplus
}
#endif

#endif
