/* The moving target of the robot: position and velocity of x, y and theta in the world frame.
 *
 * Towards a pose, all three axes arrive together, T ticks from now, each on a cubic (Hermite) curve
 *
 *     p(0) = p0,  p'(0) = v0,  p(T) = p1,  p'(T) = v1,   u = (p1 - p0) / T
 *     p''(0) = (6 u - 4 v0 - 2 v1) / T,   p''(T) = (-6 u + 2 v0 + 4 v1) / T
 *
 * Each tick takes the exact first step of the curve that is left: rounding is corrected on the way
 * and the arrival is exact to one unit of the position. A new target in flight starts from the
 * present p and v, without a jump.
 *
 * T must keep the limits of speed, of acceleration and of traction. The acceleration is linear in
 * time, so it is largest at an end; with a heading that turns on the way, the traction limit is
 * that of the worst direction, translation and rotation added:
 *
 *     |p''| / a_limit <= 1,  |theta''| / alpha_limit <= 1,  |p''| / a_grip + |theta''| / alpha_grip
 *     <= 1,   a_grip = F_limit / (m max_i |(J+)'_i,xy|),   alpha_grip = F_limit / (Iz max_i |..|)
 *
 * The velocity is a quadratic Bezier curve with the control points v0, 3 u - v0 - v1, v1; it stays
 * within the hull of its polygon after one subdivision, which for a move from rest to rest is exact
 * (1.5 u).
 *
 * A T that surely fits follows from the triangle inequality, D = p1 - p0, s = (v0 + v1) / 2:
 *
 *     a T^2 >= (|v1 - v0| + 6 |s|) T + 6 |D|   if   T = (|v1 - v0| + 6 |s|) / a + sqrt(6 |D| / a)
 *     |u| <= (2 v_limit - max |v|) / 3         if   T = 3 |D| / (2 v_limit - max |v|)
 *
 * The command tries this and the time at the mean speed, D s / s^2. From the first tick on, the
 * plan is shortened by bisection, one trial a tick, until less than 1/64 of it is in question;
 * every trial starts from the present p and v, so that the limits hold at any time. Worst: two
 * trials in the call of the command, one in a tick, each of 3 divisions and 5 square roots.
 *
 * Along a velocity, the velocity moves to the commanded one with limited acceleration, along the
 * commanded change; the position integrates it. The traction limit (traction.h) applies to this
 * change as well, so that the target never runs away from a robot that cannot follow.
 *
 * Units: position mm Q13 and mrad Q13, velocity m/s Q22 and rad/s Q22, one tick = 1 ms.
 */
#ifndef FIRMWARE_TRAJECTORY_H
#define FIRMWARE_TRAJECTORY_H

#include "firmware/kinematics.h"
#include "firmware/odometry.h"
#include "firmware/traction.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    i32 position_q13[3];
    i16 fraction_q22[3]; /* 0..511 beyond the position: rounding errors must not add up */
    traction_change velocity;
    i32 goal_position_q13[3];
    traction_change goal_velocity;
    i16 grip_acceleration_q10;        /* a_grip, m/s2 */
    i16 grip_angular_acceleration_q8; /* alpha_grip, rad/s2 */
    u16 ticks_left;
    u16 trial_ticks; /* by which the plan is to be shortened next; 0: done */
} trajectory;

/* What can limit the robot, in order of weight. A plan to a pose keeps the limits of speed and
 * acceleration by taking its time; it is not limited by them. */
typedef enum {
    CONTROL_LIMIT_NONE = 0,
    CONTROL_LIMIT_SPEED,        /* velocity command cut to speed_limit or omega_limit */
    CONTROL_LIMIT_ACCELERATION, /* change cut to (angular_)acceleration_limit */
    CONTROL_LIMIT_TRACTION,     /* change cut to the grip */
    CONTROL_LIMIT_VOLTAGE       /* a wheel wants more than supply times duty_limit */
} control_limit;

typedef enum { TRAJECTORY_OK = 0, TRAJECTORY_TOO_FAR, TRAJECTORY_REFUSED } trajectory_status;

/* Target at this pose with this body velocity; nothing planned. */
void trajectory_start(trajectory *t, const odometry_pose *pose, const kinematics_velocity *body);
/* Plans the way to this pose with this velocity (world frame) at arrival; theta goes the shorter
 * way round. TRAJECTORY_TOO_FAR, and the plan unchanged, when 60 s do not surely suffice. The
 * arrival velocity is limited to the limits of speed. */
trajectory_status trajectory_plan(trajectory *t, const parameters *p, const odometry_pose *goal,
                                  const kinematics_velocity *arrival);
/* One tick towards the planned pose; after arrival, onwards with the velocity of arrival. */
void trajectory_step_to_pose(trajectory *t, const parameters *p);
/* One tick along a body velocity; returns the largest limit that applied, *wheel (1..4) for which
 * the traction limit did, else 0. */
control_limit trajectory_step_velocity(trajectory *t, const parameters *p,
                                       const kinematics_velocity *body, u16 *wheel);

#ifdef __cplusplus
}
#endif

#endif
