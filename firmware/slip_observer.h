/* Body velocity from wheels that slip.
 *
 * Given rim speeds V_i and motor voltages u_i, wanted the body velocity v. But V_i = J_i v + s_i
 * with unknown slips s_i, and the robot carries no gyro.
 *
 * 1. Force of each wheel from its own motor balance (motor.h), low-passed with gain a per tick:
 *
 *        F += a (A u - B W - Fc sg(W) - F) - a C (W - W_before) / dt
 *
 *    The speed enters as a difference times a: encoder steps are filtered, not differentiated.
 *    Near rest dry friction may carry some of this (motor.h): as much as it may is taken off, so
 *    that a voltage which only holds against friction is not taken for slip.
 *
 * 2. Slip s_i(F_i) of each wheel and its trust c_i in (0, 1], by the inverse of the friction law
 *    (contact.h).
 *
 * 3. Newton for the body. H F is known from step 1, the rollers from the contact law, so
 *
 *        v' = M^-1 (H F + F_roller(v)) - omega x v
 *
 *    predicts v over a tick. It cannot know an impulse from outside, nor the drift of its errors.
 *
 * 4. Correction towards what the wheels say, wheel by wheel, as far as each is trusted:
 *
 *        v += J+ g c_i (V_i - s_i - J_i v)
 *
 *    An error e of v then becomes (I - g J+ c J) e. For c = 1 that is (1 - g) e, a time constant
 *    of dt / g. For any c_i in (0, 1], J+ c J is similar to a symmetric matrix with eigenvalues in
 *    (0, 1], so e decays for 0 < g < 2.
 *
 * A wheel that slides says little about how fast it slides, so its c_i falls, but not below the
 * parameter trust_floor: only the correction can see an impact, and the floor bounds for how long
 * it stays unseen. When the robot is hit, the wheels hold their speed, the forces jump to the grip,
 * the s_i to the slip that this force means, and v follows them with the gain that is left, while
 * Newton integrates the braking.
 *
 * Units in the names. Results saturate at the range of their format.
 */
#ifndef FIRMWARE_SLIP_OBSERVER_H
#define FIRMWARE_SLIP_OBSERVER_H

#include "firmware/contact.h"
#include "firmware/kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    i32 balance_n_q19[WHEEL_COUNT]; /* F, with what dry friction may carry near rest */
    i16 force_n_q8[WHEEL_COUNT];    /* of the wheel on the body, drive direction */
    i16 shaft_before_rad_s_q5[WHEEL_COUNT];
    i16 slip_m_s_q13[WHEEL_COUNT];
    i32 x_m_s_q22;
    i32 y_m_s_q22;
    i32 omega_rad_s_q22;
} slip_observer;

void slip_observer_reset(slip_observer *observer);
void slip_observer_step(slip_observer *observer, const parameters *p,
                        const i16 voltage_v_q9[WHEEL_COUNT], const i16 shaft_rad_s_q5[WHEEL_COUNT],
                        const i16 rim_m_s_q13[WHEEL_COUNT]);

kinematics_velocity slip_observer_velocity(const slip_observer *observer);

#ifdef __cplusplus
}
#endif

#endif
