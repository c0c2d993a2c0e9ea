/* Fixed-point arithmetic: saturation, rounding products and shifts, and the few elementary
 * functions that the control loop needs.
 *
 * Format: a name ending in _qN holds the value times 2^N. An angle is a u16 or i16 whose full turn
 * is 65536, so that it wraps like the angle it stands for. Right shifts of negative numbers are
 * arithmetic (checked in integers.h). No function overflows for any input: results saturate.
 *
 * Errors against a double reference, over the whole input range, are printed by
 * tests/firmware/fixed_point_error.c and tabled in firmware/README.md.
 * Polynomials: least maximum error fits on [0, 1]; the coefficients are those of Abramowitz and
 * Stegun 4.4.47 (arc tangent) and of the degree 7 odd fit of sin(pi/2 x).
 */
#ifndef FIRMWARE_FIXED_POINT_H
#define FIRMWARE_FIXED_POINT_H

#include "firmware/integers.h"

#ifdef __cplusplus
extern "C" {
#endif

i16 fixed_saturate_i16(i32 value);
i16 fixed_clamp_i16(i32 value, i16 magnitude);
i32 fixed_clamp_i32(i32 value, i32 magnitude);
i16 fixed_add_i16(i16 a, i16 b);
i16 fixed_subtract_i16(i16 a, i16 b);
i32 fixed_add_i32(i32 a, i32 b);
i32 fixed_subtract_i32(i32 a, i32 b);

/* value / 2^shift, rounded to nearest, halves upward; 1 <= shift <= 31. */
i32 fixed_shift_right(i32 value, u16 shift);
/* The same, halves away from zero: wheels that turn alike, but in opposite senses, round alike.
 * Halves upward are a bias of one sense of rotation wherever halves are frequent. */
i32 fixed_shift_right_odd(i32 value, u16 shift);
/* The same of a sequence of values, without losing anything in the mean: what rounding down cuts
 * off, *rest below 2^shift, is added to the next value. 1 <= shift <= 15. */
i32 fixed_shift_right_carrying(i32 value, u16 shift, u16 *rest);
/* value * 2^shift, saturated; 0 <= shift <= 30. */
i32 fixed_shift_left(i32 value, u16 shift);

/* a * b / 2^15, rounded (halves away from zero) and saturated: Q15 * Qn -> Qn. */
i16 fixed_multiply_q15(i16 a, i16 b_q15);
/* The same for a 32-bit a, from two 16 by 16 products; truncates at most 1 unit of the result. */
i32 fixed_multiply_i32_q15(i32 a, i16 b_q15);

/* numerator * 2^shift / denominator, rounded towards zero and saturated, without a 64-bit product;
 * shift <= 15; denominator 0 saturates. */
i32 fixed_divide(i32 numerator, u16 denominator, u16 shift);

i16 fixed_sine_q15(u16 angle);
i16 fixed_cosine_q15(u16 angle);
/* tan(pi/2 * x), saturated to +-32, and cos(pi/2 * x). */
i16 fixed_tangent_quarter_q10(i16 x_q15, i16 *cosine_q15);
/* Angle of the vector (x, y), full turn 65536; 0 for the zero vector. */
i16 fixed_atan2(i32 y, i32 x);

u16 fixed_sqrt(u32 value);
/* Length of (a, b), in the format of a and b. */
u16 fixed_hypot(i16 a, i16 b);
/* fixed_hypot(a, b) > limit, without the root; limit >= 0. */
u16 fixed_is_longer(i16 a, i16 b, i16 limit);

#ifdef __cplusplus
}
#endif

#endif
