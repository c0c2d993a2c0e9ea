/* What golden_drive.c and sixteen_bit_int.c share: a HAL of integers, and a checksum over all that
 * leaves the robot, which must come out the same with an int of 16 bits and one of 32.
 *
 * Line, store, watchdog and reset are here. Encoders, supply, currents and faults belong to each
 * program; it calls integer_hal_tick once per tick.
 */
#ifndef TESTS_FIRMWARE_INTEGER_HAL_H
#define TESTS_FIRMWARE_INTEGER_HAL_H

#include "firmware/frame.h"
#include "hal/hal.h"

extern u32 checksum;
extern i16 applied_duty_q15[4];
extern u16 bridges_on;
/* The request that the robot receives; begun and finished by the program. */
extern frame_writer request;

/* The upper half of a linear congruential generator (Numerical Recipes). */
u16 next_random(void);
/* Takes a value into the checksum. */
void mix(u32 value);
/* A blank store, and a line with nothing on it. */
void integer_hal_start(void);
/* The line takes 11 bytes out of the send buffer. */
void integer_hal_tick(void);
/* Starts a request with the next sequence number. */
void begin_request(u16 code);
/* 1 when the robot has received all of the last request. */
u16 request_is_received(void);

#endif
