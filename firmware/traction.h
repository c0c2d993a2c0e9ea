/* Traction limit: the demanded acceleration is kept within the grip of the wheels.
 *
 *     F = (J+)' M a + z n,   a scaled by min(1, F_limit / max |F_i|)
 *
 * Scaling the whole vector keeps its direction: the robot accelerates less, but towards where it
 * was told. M = diag(m, m, Iz); F_limit is the parameter traction_limit, a share of mu_drive N.
 *
 * Four wheels drive three degrees of freedom: z n, with n the null vector of J', moves nothing and
 * is free to choose. It spreads the load: z makes the largest |F_i| as small as it can be. With
 * G_i = F_i sign n_i and w_i = |n_i| > 0, two wheels alone would be equally loaded, |V_ij|, at
 *
 *     z_ij = -(G_i + G_j) / (w_i + w_j),   V_ij = (w_j G_i - w_i G_j) / (w_i + w_j)
 *
 * max |G_i + z w_i| is convex in z, so its smallest value is the largest |V_ij| of all six pairs,
 * and z is that pair's. A wheel is spared up to a third (x, y and rotation at once).
 */
#ifndef FIRMWARE_TRACTION_H
#define FIRMWARE_TRACTION_H

#include "firmware/kinematics.h"
#include "firmware/odometry.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Velocity or its change, in the world frame unless said otherwise: m/s, m/s, rad/s, Q22. */
typedef struct {
    i32 axis_q22[3];
} traction_change;

/* M a of the velocity change of one tick, in the body frame of a robot with this heading.
 * Changes beyond 31 m/s2 and 127 rad/s2 are taken as that. */
kinematics_force traction_inertia_force(const parameters *p, odometry_heading heading,
                                        const traction_change *change);
/* Forces of the wheels that push the body with this force, spread as evenly as possible. */
void traction_wheel_forces(const parameters *p, const kinematics_force *force,
                           i16 force_n_q8[WHEEL_COUNT]);
/* Scales the change of one tick; returns the number (1..4) of the wheel that the
 * demand loads most before it is spread, or 0 when it fits. */
u16 traction_limit(const parameters *p, odometry_heading heading, traction_change *change);

#ifdef __cplusplus
}
#endif

#endif
