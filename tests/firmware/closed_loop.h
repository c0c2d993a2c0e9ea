/* The firmware in closed loop with the plant of reference_plant.h, as several tests drive it.
 *
 * Most ask three things: what the firmware believes, what the plant does, and whether they agree.
 * They are cut into programs that run side by side, since a simulated processor takes some 4 ms for
 * each tick of firmware and plant. Manoeuvres are as long as the motion needs: a ramp at 1.47 m/s2,
 * and four time constants of the slowest loop, 0.25 s for the position.
 */
#ifndef TESTS_FIRMWARE_CLOSED_LOOP_H
#define TESTS_FIRMWARE_CLOSED_LOOP_H

#include "tests/firmware/reference_plant.h"

extern parameters p;
extern control_loop loop;
extern reference_plant plant;

/* Armed at rest at the origin, nominal parameters but for this one. */
void start(i16 slip_compensation);
/* Velocity command, repeated every 100 ticks. */
void drive(i16 x_mm_s, i16 y_mm_s, i16 omega_mrad_s, int ticks);

double believed_x_mm(void);
double believed_y_mm(void);
double true_x_mm(void);
double true_y_mm(void);
/* Magnitude, of any wheel. */
double largest_duty(void);

#endif
