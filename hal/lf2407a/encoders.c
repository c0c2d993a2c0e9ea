/* Encoder counters in the CPLD, extended from 11 to 16 bits by adding up their differences. */
#include "hal/cpld/registers.h"
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

#define WHEELS 4U
#define ALL_WHEELS 0x000FU
/* Lifts a counter to the top of 16 bits, so that differences wrap where the counter does. */
#define TOP_SHIFT (16 - CPLD_COUNT1_BITS)

DRIVER_DATA u16 last_top[WHEELS];
DRIVER_DATA u16 position[WHEELS];
DRIVER_DATA u16 errors;
DRIVER_DATA u16 missing;

static u16 read_top(u16 wheel) {
    return (u16)(REGISTER_READ(CPLD_BASE + CPLD_COUNT1 + wheel) << TOP_SHIFT);
}

static u16 read_low(u16 offset, u16 bits) {
    return (u16)(REGISTER_READ(CPLD_BASE + offset) & ((1U << bits) - 1U));
}

void encoders_start(void) {
    u16 i;
    missing = (u16)(read_low(CPLD_IDENTITY, CPLD_IDENTITY_BITS) != CPLD_VERSION);
    errors = 0;
    REGISTER_WRITE(CPLD_BASE + CPLD_LATCH, 0);
    for (i = 0; i < WHEELS; ++i) {
        last_top[i] = read_top(i);
        position[i] = 0;
    }
}

void hal_read_encoder_counts(u16 counts[4]) {
    u16 i;
    REGISTER_WRITE(CPLD_BASE + CPLD_LATCH, 0);
    for (i = 0; i < WHEELS; ++i) {
        const u16 top = read_top(i);
        const i16 step_top = (i16)(u16)(top - last_top[i]);
        last_top[i] = top;
        position[i] = (u16)(position[i] + (u16)(step_top >> TOP_SHIFT));
        counts[i] = position[i];
    }
    errors = (u16)(errors | read_low(CPLD_ERROR, CPLD_ERROR_BITS));
}

/* Without the CPLD every wheel is in error, always. */
u16 hal_read_encoder_errors(void) {
    const u16 seen = missing ? ALL_WHEELS : errors;
    errors = 0;
    return seen;
}
