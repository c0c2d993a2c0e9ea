/* Double precision references of the firmware's arithmetic, and deterministic test inputs.
 *
 * A reference takes the same raw inputs as the firmware function and returns the exact result in
 * the unit of the firmware's result (1.0 = 1 LSB), before saturation.
 */
#ifndef TESTS_FIRMWARE_REFERENCE_H
#define TESTS_FIRMWARE_REFERENCE_H

#include <math.h>
#include <stdint.h>

#include "firmware/integers.h"

#define REFERENCE_PI 3.14159265358979323846

/* Random cases of a test: all of them on a PC, a few on a simulated processor with 16-bit int,
 * which takes ten thousand times as long. And steps through a table: its ends there. */
#if INT_MAX == 32767
#define REFERENCE_CASES(number) ((number) / 40)
#define REFERENCE_STRIDE(number) (number)
#else
#define REFERENCE_CASES(number) (number)
#define REFERENCE_STRIDE(number) 1
#endif

static inline double reference_clamp(double value, double low, double high) {
    return fmin(fmax(value, low), high);
}

/* The angle less whole turns, -pi..pi. (C's remainder() is missing in the library of the AVR.) */
static inline double reference_wrap_rad(double angle_rad) {
    return angle_rad - 2.0 * REFERENCE_PI * round(angle_rad / (2.0 * REFERENCE_PI));
}

static inline double reference_i16(double value) {
    return reference_clamp(value, I16_MIN, I16_MAX);
}

/* Uniform over all 2^32 values; a 64-bit linear congruential generator (Knuth's MMIX constants). */
static inline uint32_t reference_random(uint64_t *state) {
    *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (uint32_t)(*state >> 32);
}

/* Uniform over -magnitude..magnitude. */
static inline i16 reference_random_i16(uint64_t *state, i16 magnitude) {
    return (i16)((int32_t)(reference_random(state) % (2u * (uint32_t)magnitude + 1u)) - magnitude);
}

#endif
