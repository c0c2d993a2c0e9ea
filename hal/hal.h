/* The seam between the firmware and whatever carries it: the robot's board or a simulated plant.
 *
 * The firmware calls these three functions once per tick of 1 ms, in this order: counters, supply,
 * duty. Wheels are numbered 1..4 as in the paper, index 0..3.
 */
#ifndef HAL_HAL_H
#define HAL_HAL_H

#include "firmware/integers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The four encoder counters, taken at one instant; 16 bits, wrapping, counting up when the shaft
 * turns so that the rim drives the robot counter-clockwise about its centre. */
void hal_read_encoder_counts(u16 counts[4]);

/* Supply voltage of the motor bridges in mV. */
u16 hal_read_supply_mv(void);

/* Mean motor voltage over supply voltage, Q15; positive turns the shaft so that its counter counts
 * up. Holds until the next call. 0 shorts the motor. */
void hal_write_duty(const i16 duty_q15[4]);

#ifdef __cplusplus
}
#endif

#endif
