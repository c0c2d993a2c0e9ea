/* The drivers' start-up, and what one asks of another. Everything else of a driver is hal.h.
 *
 * No function relies on zeroed memory: a reset of the virtual board keeps static data, and so does
 * a warm start on the chip. */
#ifndef HAL_LF2407A_DRIVERS_H
#define HAL_LF2407A_DRIVERS_H

#include "firmware/integers.h"
#include "hal/lf2407a/target.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Reset state to running clocks, watchdog at 210 ms, bridges off; interrupts stay masked. */
void board_start(void);
/* Starts the 1 kHz tick and lets interrupts in. */
void board_run(void);
/* 1 once per tick; ticks missed since are counted as overruns. */
u16 board_tick_due(void);

void pwm_start(void);
void encoders_start(void);
void analog_start(void);
void serial_start(void);
void store_start(void);

/* Parts of the interrupt routines. analog_collect takes the finished conversions and arms the
 * converter for the next tick. */
void analog_collect(void);
void serial_receive(void);
void serial_transmit(void);

/* Interrupt service routines, entered from vectors.asm. */
INTERRUPT void board_int3(void);
INTERRUPT void board_int5(void);

#ifdef __cplusplus
}
#endif

#endif
