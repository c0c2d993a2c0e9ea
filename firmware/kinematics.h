/* Kinematics of four omnidirectional wheels, paper equation (3) with its errata corrected.
 *
 *     rim speeds       V_w = J V_R       row i of J: [-sin g_i, cos g_i, L]
 *     body velocity    V_R = J+ V_w      J+ = (J'J)^-1 J'
 *     body force       F_R = J' F_w      virtual work
 *     wheel forces     F_w = (J+)' F_R   least squares: none is spent in the null space
 *     slip signal      n . V_w           n spans the null space of J', here (1, -1, 1, -1)
 *
 * n . V_w is zero when all wheels roll, whatever the body does; it needs no friction model.
 * Body frame: x forward, y left, omega counter-clockwise. Results saturate at the range of their
 * format.
 */
#ifndef FIRMWARE_KINEMATICS_H
#define FIRMWARE_KINEMATICS_H

#include "firmware/integers.h"
#include "firmware/parameters.h"

#define WHEEL_COUNT 4

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    i16 x_m_s_q13;
    i16 y_m_s_q13;
    i16 omega_rad_s_q11;
} kinematics_velocity;

typedef struct {
    i16 x_n_q6;
    i16 y_n_q6;
    i16 torque_n_m_q8;
} kinematics_force;

void kinematics_inverse(const parameters *p, const kinematics_velocity *velocity,
                        i16 rim_m_s_q13[WHEEL_COUNT]);
void kinematics_forward(const parameters *p, const i16 rim_m_s_q13[WHEEL_COUNT],
                        kinematics_velocity *velocity);
i16 kinematics_null_slip_m_s_q13(const parameters *p, const i16 rim_m_s_q13[WHEEL_COUNT]);
void kinematics_body_force(const parameters *p, const i16 force_n_q8[WHEEL_COUNT],
                           kinematics_force *force);
void kinematics_wheel_forces(const parameters *p, const kinematics_force *force,
                             i16 force_n_q8[WHEEL_COUNT]);

#ifdef __cplusplus
}
#endif

#endif
