/* Traction limit: the demanded acceleration is kept within the grip of the wheels.
 *
 *     F = (J+)' M a,   a scaled by min(1, F_limit / max |F_i|)
 *
 * Scaling the whole vector keeps its direction: the robot accelerates less, but towards where it
 * was told. M = diag(m, m, Iz); F_limit is the parameter traction_limit, a share of mu_drive N.
 */
#ifndef FIRMWARE_TRACTION_H
#define FIRMWARE_TRACTION_H

#include "firmware/kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Velocity or its change, world frame: m/s Q22, m/s Q22, rad/s Q22. */
typedef struct {
    i32 axis_q22[3];
} traction_change;

/* M a of the velocity change of one tick, in the body frame of a robot with this heading (full turn
 * 65536). Changes beyond 31 m/s2 and 127 rad/s2 are taken as that. */
kinematics_force traction_inertia_force(const parameters *p, u16 heading,
                                        const traction_change *change);
/* Scales the change of one tick; returns 1 when it had to, else 0. */
u16 traction_limit(const parameters *p, u16 heading, traction_change *change);

#ifdef __cplusplus
}
#endif

#endif
