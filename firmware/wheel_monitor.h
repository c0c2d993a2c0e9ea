/* Watches one wheel for faults of its encoder, motor and bridge, by what physics allows.
 *
 * The floor cannot hold more than the grip mu_drive N. The observer's force of a wheel,
 *
 *     F = A u - B W - C dW/dt - Fc sg(W)      (motor.h, slip_observer.h)
 *
 * is what floor and load take; |F| > 2 mu_drive N for long is impossible for a wheel that turns
 * freely and an encoder that says so: twice, since the believed grip may be wrong and wheel loads
 * shift. What is wrong then shows in how the counter moves:
 *
 *     it moves against the voltage      wired backwards: F = 2 A u - f in truth; or a motor without
 *                                       contact that the floor drags along
 *     it stands, current u / Ra         the wheel is blocked
 *     it stands, less than 3/4 of that  the wheel turns: A u > 2 mu N, and sliding takes less than
 *                                       half of u / Ra. Where no current is measured, a blocked
 *                                       wheel shows as this, a stuck encoder.
 *     it moves along                    a weak motor, a wrong parameter: no reason to stop
 *
 * Independent of the force: a step in one tick that no supply can turn; transitions that the
 * decoder calls impossible, three within 64 ms; the mean current of 64 ms above its limit, unless
 * the wheel stands (short peaks are the business of the bridge's own protection).
 */
#ifndef FIRMWARE_WHEEL_MONITOR_H
#define FIRMWARE_WHEEL_MONITOR_H

#include "firmware/parameters.h"
#include "firmware/supervisor.h"

/* Time that the impossible must last, ms: the force follows a hard reversal of the duty within 20
 * ms, and a runaway wheel passes 1 m/s in 100. */
#define WHEEL_MONITOR_STANDING_MS 50
#define WHEEL_MONITOR_REVERSED_MS 50

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    u16 place_count; /* where the counter stands, if it stands */
    u16 standing_ms;
    u16 reversed_ms;
    u16 glitch_score;
    i32 current_ma_q6; /* mean of |current| */
} wheel_monitor;

typedef struct {
    u16 count;
    i16 step_counts; /* since the last tick */
    i16 shaft_rad_s_q5;
    i16 voltage_v_q9; /* applied during the last tick */
    i16 force_n_q8;
    i16 current_ma;
    u16 glitch; /* not 0: an impossible transition since the last tick */
} wheel_monitor_input;

void wheel_monitor_reset(wheel_monitor *monitor, u16 count);
/* One tick; SUPERVISOR_FAULT_NONE when all is well. */
supervisor_fault wheel_monitor_step(wheel_monitor *monitor, const parameters *p,
                                    const wheel_monitor_input *input);

#ifdef __cplusplus
}
#endif

#endif
