/* Pose of the robot in the world frame, integrated from the body velocity.
 *
 *     (x, y)' = T(theta) (vx, vy),   theta' = omega,   one step per 1 ms tick
 *
 * T is taken at the middle of the step, theta + omega dt / 2, which makes the path of a constant
 * body velocity an exact polygon inscribed in its circle (error of order (omega dt)^2 per radian,
 * 1e-6 at 3 rad/s).
 *
 * Units: 1 m/s for 1 ms is 1 mm, so mm Q13 is the integral of m/s Q13 without any factor, and mrad
 * Q13 that of rad/s Q13. Range of x and y +-262 m (saturating), theta in (-pi, pi].
 */
#ifndef FIRMWARE_ODOMETRY_H
#define FIRMWARE_ODOMETRY_H

#include "firmware/integers.h"
#include "firmware/kinematics.h"

#define ODOMETRY_FULL_TURN_MRAD_Q13 51471854L

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    i32 x_mm_q13;
    i32 y_mm_q13;
    i32 theta_mrad_q13;
} odometry_pose;

void odometry_step(odometry_pose *pose, const kinematics_velocity *body);

/* The angle brought into (-pi, pi]; |angle| < 3 pi. */
i32 odometry_wrap_mrad_q13(i32 angle_mrad_q13);
/* The angle with a full turn of 65536. */
u16 odometry_binary_angle(i32 angle_mrad_q13);
/* (x, y) turned by +angle: from the body to the world for angle = theta. */
void odometry_rotate(u16 angle, i16 *x, i16 *y);

/* A heading by which several vectors are turned. */
typedef struct {
    i16 cosine_q15;
    i16 sine_q15;
} odometry_heading;

odometry_heading odometry_heading_of(u16 angle);
void odometry_body_to_world(odometry_heading heading, i16 *x, i16 *y);
void odometry_world_to_body(odometry_heading heading, i16 *x, i16 *y);

#ifdef __cplusplus
}
#endif

#endif
