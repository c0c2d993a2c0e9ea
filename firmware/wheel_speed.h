/* Shaft speed from a free-running 16-bit encoder counter.
 *
 *     W = (c(t) - c(t - 4 dt)) / (4 dt) * 2 pi / counts_per_rev,   dt = 1 ms
 *
 * The counter difference is taken modulo 2^16, so a wrap is invisible as long as the shaft turns
 * less than 32768 counts in 4 ms. One count per tick of a 2000 count encoder is 3.1 rad/s; the
 * window of four ticks makes that 0.8 rad/s and costs 2 ms of delay. Unlike a recursive filter it
 * loses no count: the sum of the speeds is the angle, which odometry relies on.
 */
#ifndef FIRMWARE_WHEEL_SPEED_H
#define FIRMWARE_WHEEL_SPEED_H

#include "firmware/integers.h"
#include "firmware/parameters.h"

#define WHEEL_SPEED_WINDOW 4

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    u16 history[WHEEL_SPEED_WINDOW];
    u16 oldest;
} wheel_speed;

/* Starts at rest at this counter value. */
void wheel_speed_reset(wheel_speed *state, u16 count);
/* Takes the counter of this tick, returns the shaft speed in rad/s Q5. */
i16 wheel_speed_step_rad_s_q5(wheel_speed *state, const parameters *p, u16 count);
/* Counts from the newest value taken to this one. */
i16 wheel_speed_counts_since(const wheel_speed *state, u16 count);

#ifdef __cplusplus
}
#endif

#endif
