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
 * T is the smallest found for which the limits of speed and acceleration hold. The acceleration is
 * linear in time, so it is largest at an end. The velocity is a quadratic Bezier curve with the
 * control points v0, 3 u - v0 - v1, v1; it stays within the hull of its polygon after one
 * subdivision, which for a move from rest to rest is exact (1.5 u). The search grows T by a quarter
 * until the limits hold, then halves the last step four times: at most 44 trials, within 2 % of the
 * smallest T. It runs in the call of the command, not in the tick.
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
    u16 ticks_left;
} trajectory;

typedef enum { TRAJECTORY_OK = 0, TRAJECTORY_TOO_FAR } trajectory_status;

/* Target at this pose with this body velocity; nothing planned. */
void trajectory_start(trajectory *t, const odometry_pose *pose, const kinematics_velocity *body);
/* Plans the way to this pose with this velocity (world frame) at arrival; theta goes the shorter
 * way round. TRAJECTORY_TOO_FAR, and the plan unchanged, when 60 s do not suffice. The arrival
 * velocity is limited to the limits of speed. */
trajectory_status trajectory_plan(trajectory *t, const parameters *p, const odometry_pose *goal,
                                  const kinematics_velocity *arrival);
/* One tick towards the planned pose; after arrival, onwards with the velocity of arrival. */
void trajectory_step_to_pose(trajectory *t);
/* One tick along a body velocity; returns 1 when the traction limit cut the acceleration, else 0.
 */
u16 trajectory_step_velocity(trajectory *t, const parameters *p, const kinematics_velocity *body);

#ifdef __cplusplus
}
#endif

#endif
