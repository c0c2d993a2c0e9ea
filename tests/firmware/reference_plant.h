/* Double precision plant of the nominal robot for the closed-loop tests of the firmware.
 *
 *     J0 W_i' = k2 i_i - b0 W_i - (R/n) f_i,   i_i = (V d_i - k3 W_i) / Ra
 *     m (vx', vy') = sum f_i d_i + f_Fi r_i - m w (-vy, vx),   Iz w' = L sum f_i
 *     f_i = mu_drive N (2/pi) atan(k s_i),   s_i = R W_i / n - J_i v,   f_Fi = -mu_roller N (2/pi)
 * atan(k r_i v)
 *
 * Midpoint rule, four steps per 1 ms tick (on an AVR, whose double is a float, one). SI units,
 * state order: W1..4, vx, vy, w, x, y, theta, shaft angles. Source: paper equations (7), (8),
 * (11)-(13).
 */
#ifndef TESTS_FIRMWARE_REFERENCE_PLANT_H
#define TESTS_FIRMWARE_REFERENCE_PLANT_H

#include <stdint.h>

#include "firmware/control_loop.h"

enum {
    PLANT_SHAFT = 0,
    PLANT_VX = 4,
    PLANT_VY,
    PLANT_W,
    PLANT_X,
    PLANT_Y,
    PLANT_THETA,
    PLANT_ANGLE
};
#define PLANT_STATES (PLANT_ANGLE + 4)

typedef struct {
    double state[PLANT_STATES];
    double duty[4];
    double supply_v;
    double mu_drive;
    double coulomb_nm; /* dry friction of each shaft, -T tanh(W / 0.5 rad/s) */
    int bridges_on;    /* off: motors shorted */
    /* What can be broken; by default all is well. */
    double encoder_gain[4];     /* 1; 0 stuck, -1 reversed, from now on */
    double seen_angle_rad[4];   /* by the encoder */
    double angle_before_rad[4]; /* of the shaft, when the encoder was read last */
    double torque_gain[4];      /* 1; 0 no contact */
    int shaft_blocked[4];
    double extra_current_a[4]; /* measured beside that of the motor */
    uint16_t encoder_errors;   /* until read */
    uint16_t bridge_faults;
} reference_plant;

void reference_plant_reset(reference_plant *plant);
/* Attaches the plant, resets the loop to these parameters, passes BOOT and arms. */
void reference_plant_start(reference_plant *plant, control_loop *loop, const parameters *p);
/* One tick of the firmware, then 1 ms of the plant. */
void reference_plant_tick(reference_plant *plant, control_loop *loop);
/* Makes this plant the one behind the HAL. */
void reference_plant_attach(reference_plant *plant);

#endif
