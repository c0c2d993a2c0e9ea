/* The seam between the firmware and whatever carries it: the robot's board or a simulated plant.
 *
 * Wheels are numbered 1..4 as in the paper, index 0..3. Everything is called from the tick of 1 ms,
 * or before the first one; nothing here waits.
 */
#ifndef HAL_HAL_H
#define HAL_HAL_H

#include "firmware/integers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Motion ---- */

/* The four encoder counters, taken at one instant; 16 bits, wrapping, counting up when the shaft
 * turns so that the rim drives the robot counter-clockwise about its centre. */
void hal_read_encoder_counts(u16 counts[4]);

/* Bit i: the decoder of wheel i + 1 saw an impossible transition since the last call. */
u16 hal_read_encoder_errors(void);

/* Supply voltage of the motor bridges in mV. */
u16 hal_read_supply_mv(void);

/* Motor currents in mA, positive where they drive the shaft so that its counter counts up; all 0
 * where none are measured. */
void hal_read_currents_ma(i16 current_ma[4]);

/* Mean motor voltage over supply voltage, Q15; positive turns the shaft so that its counter counts
 * up. Holds until the next call. 0 shorts the motor. */
void hal_write_duty(const i16 duty_q15[4]);

/* ---- Power stage ---- */

/* 0: every bridge at its safe level whatever the duty; 1: duties are applied. Off after reset.
 * Switching on clears a latched protection whose cause has gone. */
void hal_enable_bridges(u16 on);

/* Latched protection input (over-current): bit 0 wheels 1 and 2, bit 1 wheels 3 and 4. The hardware
 * has already switched these off. */
u16 hal_read_bridge_faults(void);

/* ---- Serial line: bytes 0..255 ---- */

/* 1 and the next byte received; 0, and the byte untouched, when there is none. */
u16 hal_serial_read(u16 *byte);

/* Bytes that hal_serial_write takes now. */
u16 hal_serial_space(void);

/* Sends the low 8 bits; lost when there is no space. */
void hal_serial_write(u16 byte);

/* Received bytes lost (overrun, framing, full buffer) since the last call, saturating. */
u16 hal_serial_lost(void);

/* ---- Store: words of non-volatile memory ---- */

#define HAL_STORE_WORDS 512

/* 1 while a write is in progress. */
u16 hal_store_busy(void);

/* Any time but while busy. */
u16 hal_store_read(u16 address);

/* Starts a write; when power fails before it ends, this word is undefined. */
void hal_store_write(u16 address, u16 word);

/* ---- Reset, watchdog, time ---- */

typedef enum { HAL_RESET_POWER_ON = 0, HAL_RESET_WATCHDOG } hal_reset_cause;

hal_reset_cause hal_read_reset_cause(void);

/* The board resets unless this is called every 200 ms. */
void hal_service_watchdog(void);

/* Ticks that were due while the one before still ran, since the last call, saturating. */
u16 hal_read_tick_overruns(void);

#ifdef __cplusplus
}
#endif

#endif
