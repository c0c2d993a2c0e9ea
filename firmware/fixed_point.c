/* Fixed-point arithmetic; formats, errors and sources in fixed_point.h. */
#include "firmware/fixed_point.h"

#define QUARTER_TURN 16384
#define HALF_TURN 32768L
#define ONE_Q15 32768L
#define HALF_RANGE ((i32)1 << 30)
/* Twice this leaves room for 2^16. Of all products of two i16 only 2^15 * 2^15 is larger. */
#define LARGEST_DOUBLED (HALF_RANGE - ONE_Q15)

/* Nearly all values are within the range, which a compiler can see in one test. */
i16 fixed_saturate_i16(i32 value) {
    if (value > I16_MAX || value < I16_MIN)
        return (i16)(value < 0 ? I16_MIN : I16_MAX);
    return (i16)value;
}

i16 fixed_clamp_i16(i32 value, i16 magnitude) {
    if (value > magnitude)
        return magnitude;
    if (value < -(i32)magnitude)
        return (i16)-magnitude;
    return (i16)value;
}

i32 fixed_clamp_i32(i32 value, i32 magnitude) {
    if (value > magnitude)
        return magnitude;
    return value < -magnitude ? -magnitude : value;
}

i16 fixed_add_i16(i16 a, i16 b) {
    return fixed_saturate_i16((i32)a + b);
}

i16 fixed_subtract_i16(i16 a, i16 b) {
    return fixed_saturate_i16((i32)a - b);
}

/* Nearly all sums are of numbers that cannot overflow; the first test lets them pass without
 * waiting for the others. */
i32 fixed_add_i32(i32 a, i32 b) {
    if (a >= -HALF_RANGE && a < HALF_RANGE && b >= -HALF_RANGE && b < HALF_RANGE)
        return a + b;
    if (b >= 0)
        return a > (i32)I32_MAX - b ? (i32)I32_MAX : a + b;
    return a < (i32)I32_MIN - b ? (i32)I32_MIN : a + b;
}

i32 fixed_subtract_i32(i32 a, i32 b) {
    if (a >= -HALF_RANGE && a < HALF_RANGE && b >= -HALF_RANGE && b < HALF_RANGE)
        return a - b;
    if (b >= 0)
        return a < (i32)I32_MIN + b ? (i32)I32_MIN : a - b;
    return a > (i32)I32_MAX + b ? (i32)I32_MAX : a - b;
}

i32 fixed_shift_right(i32 value, u16 shift) {
    const i32 half = (i32)1 << (shift - 1);
    if (value > (i32)I32_MAX - half) /* the sum would overflow; all such values round alike */
        return (i32)1 << (31 - shift);
    return (value + half) >> shift;
}

i32 fixed_shift_right_odd(i32 value, u16 shift) {
    if (value < 0)
        return (value + (((i32)1 << (shift - 1)) - 1)) >> shift;
    return fixed_shift_right(value, shift);
}

i32 fixed_shift_right_carrying(i32 value, u16 shift, u16 *rest) {
    const i32 sum = fixed_add_i32(value, *rest);
    *rest = (u16)((u32)sum & (((u32)1 << shift) - 1U));
    return sum >> shift;
}

i32 fixed_shift_left(i32 value, u16 shift) {
    const i32 limit = (i32)I32_MAX >> shift;
    if (value > limit)
        return (i32)I32_MAX;
    if (value < -limit - 1)
        return (i32)I32_MIN;
    return (i32)((u32)value << shift);
}

i16 fixed_multiply_q15(i16 a, i16 b_q15) {
    return fixed_saturate_i16(fixed_shift_right_odd((i32)a * b_q15, 15)); /* Qn * Q15 -> Qn */
}

i32 fixed_multiply_i32_q15(i32 a, i16 b_q15) {
    const i16 high = (i16)(a >> 16);
    const i16 low_half = (i16)((u32)(a & 0xFFFFL) >> 1); /* halved to fit a signed factor */
    const i32 high_product = (i32)high * b_q15;
    const i32 low_result = fixed_shift_right((i32)low_half * b_q15, 14); /* below 2^16 */
    if (high_product > LARGEST_DOUBLED)
        return fixed_add_i32((i32)I32_MAX, low_result);
    return 2 * high_product + low_result; /* 2^16 / 2^15 = 2 */
}

i32 fixed_divide(i32 numerator, u16 denominator, u16 shift) {
    i32 quotient = 0;
    i32 remainder = numerator;
    if (denominator == 0)
        return numerator < 0 ? (i32)I32_MIN : (i32)I32_MAX;
    if (numerator >= (i32)denominator || numerator <= -(i32)denominator) {
        quotient = numerator / (i32)denominator;
        remainder = numerator % (i32)denominator;
    }
    /* remainder < 2^16, so remainder * 2^15 fits; its sign is that of the numerator. */
    return fixed_add_i32(fixed_shift_left(quotient, shift),
                         remainder * ((i32)1 << shift) / (i32)denominator);
}

/* sin(pi/2 x) for 0 <= x <= 1, x in Q14:
 * x (1.5707903 - 0.6458929 x^2 + 0.0794344 x^4 - 0.0043331 x^6) */
static i16 quarter_sine_q15(i32 x_q14) {
    const i32 square_q15 = fixed_shift_right(x_q14 * x_q14, 13); /* Q28 -> Q15 */
    i32 sum_q15 = -142;
    sum_q15 = 2603 + fixed_shift_right(sum_q15 * square_q15, 15);      /* Q30 -> Q15 */
    sum_q15 = -21165 + fixed_shift_right(sum_q15 * square_q15, 15);    /* Q30 -> Q15 */
    sum_q15 = 51472 + fixed_shift_right(sum_q15 * square_q15, 15);     /* Q30 -> Q15 */
    return fixed_saturate_i16(fixed_shift_right(sum_q15 * x_q14, 14)); /* Q29 -> Q15 */
}

i16 fixed_sine_q15(u16 angle) {
    const i32 in_half = (i32)(angle & 0x7FFFU);
    const i32 x_q14 = in_half > QUARTER_TURN ? HALF_TURN - in_half : in_half;
    const i16 magnitude_q15 = quarter_sine_q15(x_q14);
    return (i16)(angle & 0x8000U ? -magnitude_q15 : magnitude_q15);
}

i16 fixed_cosine_q15(u16 angle) {
    return fixed_sine_q15((u16)(angle + QUARTER_TURN));
}

i16 fixed_tangent_quarter_q10(i16 x_q15, i16 *cosine_q15) {
    const i32 angle_q14 = (x_q15 < 0 ? -(i32)x_q15 : (i32)x_q15) / 2; /* a quarter turn is 2^14 */
    i16 tangent_q10 = I16_MAX;
    *cosine_q15 = quarter_sine_q15(QUARTER_TURN - angle_q14);
    if (*cosine_q15 > 0) {
        /* Q15 * 2^10 / Q15 -> Q10 */
        tangent_q10 =
            fixed_saturate_i16((i32)quarter_sine_q15(angle_q14) * 1024 / (i32)*cosine_q15);
    }
    return (i16)(x_q15 < 0 ? -tangent_q10 : tangent_q10);
}

/* atan(r) for 0 <= r <= 1, r in Q15, as an angle of full turn 65536: Abramowitz and Stegun 4.4.47
 * times 65536 / (2 pi); the coefficients carry 2 more fractional bits than the result. */
static i16 eighth_turn_atan(i32 ratio_q15) {
    const i32 square_q15 = fixed_shift_right(ratio_q15 * ratio_q15, 15);
    i32 sum_q2 = 869;
    sum_q2 = -3552 + fixed_shift_right(sum_q2 * square_q15, 15);
    sum_q2 = 7516 + fixed_shift_right(sum_q2 * square_q15, 15);
    sum_q2 = -13780 + fixed_shift_right(sum_q2 * square_q15, 15);
    sum_q2 = 41716 + fixed_shift_right(sum_q2 * square_q15, 15);
    return (i16)fixed_shift_right(sum_q2 * ratio_q15, 17); /* Q2 * Q15 -> Q0 */
}

static i32 magnitude_i32(i32 value) {
    if (value == (i32)I32_MIN)
        return (i32)I32_MAX;
    return value < 0 ? -value : value;
}

i16 fixed_atan2(i32 y, i32 x) {
    i32 large = magnitude_i32(x);
    i32 small = magnitude_i32(y);
    const i16 swapped = (i16)(small > large);
    i32 angle;
    if (swapped) {
        small = large;
        large = magnitude_i32(y);
    }
    if (large == 0)
        return 0;
    while (large > I16_MAX) {
        large >>= 1;
        small >>= 1;
    }
    angle = eighth_turn_atan(fixed_clamp_i32(fixed_divide(small, (u16)large, 15), ONE_Q15));
    if (swapped)
        angle = QUARTER_TURN - angle;
    if (x < 0)
        angle = HALF_TURN - angle;
    if (y < 0)
        angle = -angle;
    return angle == HALF_TURN ? (i16)I16_MIN : (i16)angle; /* half a turn is its own negative */
}

u16 fixed_sqrt(u32 value) {
    u32 root = 0;
    u32 bit = (u32)1 << 30;
    while (bit != 0) {
        const u32 trial = root + bit;
        root >>= 1;
        if (value >= trial) {
            value -= trial;
            root += bit;
        }
        bit >>= 2;
    }
    return (u16)root;
}

static u32 sum_of_squares(i16 a, i16 b) {
    return (u32)((i32)a * a) + (u32)((i32)b * b);
}

u16 fixed_hypot(i16 a, i16 b) {
    return fixed_sqrt(sum_of_squares(a, b));
}

u16 fixed_is_longer(i16 a, i16 b, i16 limit) {
    const u32 longer = (u32)limit + 1U;
    return sum_of_squares(a, b) >= longer * longer;
}
