/* PID control of one shaft speed, with feed-forward.
 *
 *     u = u_ff + Kp e + integral(Ki e) - Kd dW/dt,   e = W_target - W,   |u| <= u_limit
 *
 * The derivative acts on the measurement: a step of the target does not kick. Anti-windup: the
 * integral takes no error that would push u further beyond its limit. u_ff comes from the motor
 * balance (motor.h), so that the integral only has to hold what the model does not know.
 */
#ifndef FIRMWARE_WHEEL_PID_H
#define FIRMWARE_WHEEL_PID_H

#include "firmware/parameters.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    i32 integral_v_q21;
    i16 shaft_before_rad_s_q5;
} wheel_pid;

typedef struct {
    i16 target_rad_s_q5;
    i16 shaft_rad_s_q5;
    i16 feed_forward_v_q9;
    i16 limit_v_q9;
} wheel_pid_input;

/* Integral 0, at this speed. */
void wheel_pid_reset(wheel_pid *pid, i16 shaft_rad_s_q5);
/* Returns the voltage in V Q9; *limited becomes 1 when it was cut to the limit and is not touched
 * else. */
i16 wheel_pid_step_v_q9(wheel_pid *pid, const parameters *p, const wheel_pid_input *input,
                        u16 *limited);

#ifdef __cplusplus
}
#endif

#endif
