/* The contact law of a wheel, paper equation (13), and its inverse.
 *
 *     drive force    f = mu_drive N (2/pi) atan(k s)         s slip speed = R W / n - V_T
 *     inverse        s = tan(pi/2 x) / k,   x = f / (mu_drive N)
 *     roller force   f_F = -mu_roller N (2/pi) atan(k V_F)   along (cos g, sin g)
 *
 * The inverse is worth less the closer the wheel is to its grip: ds/df grows as 1 / cos^2(pi/2 x),
 * and so does the error of s that an error of f causes. A steady Kalman filter with small gain
 * takes a measurement in proportion to the inverse of its standard deviation, hence
 *
 *     trust = cos^2(pi/2 x) = 1 / (1 + (k s)^2)
 *
 * |x| is limited to the parameter slip_saturation, beyond which s would be noise.
 *
 * 1 / (mu_drive N) is Q15: grips of 1 N and more, up to the 128 N of the force format. Rounded by
 * 2^-16 / N it shifts x by the share 2^-16 G / N of a grip G; a force rounded by 2^-9 N shifts it
 * by 2^-9 N / G. Neither exceeds 0.2 % between 1 and 128 N, less than a grip is known to.
 */
#ifndef FIRMWARE_CONTACT_H
#define FIRMWARE_CONTACT_H

#include "firmware/kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    i16 slip_m_s_q13;
    i16 trust_q15;
} contact_slip;

contact_slip contact_slip_from_force(const parameters *p, i16 force_n_q8);
/* Sum of the roller forces on a body of this velocity; rollers point at the centre, so rotation
 * does not turn them, and there is no torque. */
kinematics_force contact_roller_force(const parameters *p, i16 x_m_s_q13, i16 y_m_s_q13);

#ifdef __cplusplus
}
#endif

#endif
