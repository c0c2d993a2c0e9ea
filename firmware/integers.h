/* Integer types of exact width for C89.
 *
 * On the TMS320LF2407A `int` has 16 bits and `long` 32; on a PC `short` has 16 and `int` 32. The
 * firmware uses only these four names for stored data, so that one source runs on both.
 *
 * Errors: a compiler with other widths, or with a logical instead of an arithmetic right shift of
 * negative numbers, fails to compile here.
 */
#ifndef FIRMWARE_INTEGERS_H
#define FIRMWARE_INTEGERS_H

#include <limits.h>

#if INT_MAX == 32767
typedef int i16;
typedef unsigned int u16;
typedef long i32;
typedef unsigned long u32;
#else
typedef short i16;
typedef unsigned short u16;
typedef int i32;
typedef unsigned int u32;
#endif

#define I16_MAX 32767
#define I16_MIN (-32767 - 1)
#define U16_MAX 65535U
#define I32_MAX 2147483647L
#define I32_MIN (-2147483647L - 1L)

/* Each array below has a negative size, which no compiler accepts, when its condition is false. */
typedef int
    integers_u16_is_16_bit[((u16)U16_MAX + (u32)1 == 65536UL && (u16)-1 == U16_MAX) * 2 - 1];
typedef int integers_u32_is_32_bit[((u32)-1 == 4294967295UL) * 2 - 1];
typedef int integers_shift_is_arithmetic[((-2L >> 1) == -1L) * 2 - 1];

#endif
