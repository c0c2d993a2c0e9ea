/* Motor balance seen at the rim, paper equations (7) and (8), in both directions.
 *
 *     f = (n/R) (k2 i - J0 dW/dt - b0 W - Tc sg(W)),   i = (u - k3 W) / Ra
 *       = A u - B W - C dW/dt - Fc sg(W)
 *     A = (n/R) k2 / Ra,  B = (n/R) (k2 k3 / Ra + b0),  C = (n/R) J0,  Fc = (n/R) Tc
 *
 * f force at the rim (N), u voltage (V), W shaft speed (rad/s). sg is a ramp through zero of +-4
 * rad/s, so that the Coulomb term does not chatter at rest. On the ramp dry friction may take any
 * value that it takes between rest and motion: Fc sg(W) +- Fc (1 - |sg(W)|). Results saturate.
 */
#ifndef FIRMWARE_MOTOR_H
#define FIRMWARE_MOTOR_H

#include "firmware/parameters.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A u - B W - Fc sg(W): the force without the share that accelerates the shaft. */
i32 motor_steady_force_n_q19(const parameters *p, i16 voltage_v_q9, i16 shaft_rad_s_q5);
/* Fc (1 - |sg(W)|): by so much the dry friction may differ from Fc sg(W). */
i16 motor_dry_slack_n_q8(const parameters *p, i16 shaft_rad_s_q5);
/* C dW/dt for a speed change of one tick. */
i32 motor_inertia_force_n_q15(const parameters *p, i16 shaft_change_rad_s_q5);
/* The voltage u at which the rim exerts the force f. */
i16 motor_voltage_v_q9(const parameters *p, i16 force_n_q8, i16 shaft_rad_s_q5,
                       i16 shaft_change_rad_s_q5);

#ifdef __cplusplus
}
#endif

#endif
