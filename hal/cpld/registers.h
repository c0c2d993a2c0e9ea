/* Constants made of registers.def: CPLD_COUNT1 and so on are offsets from CPLD_BASE,
 * CPLD_COUNT1_BITS their widths. (Addresses from 8000h up do not fit an enum of 16 bits.)
 *
 * CPLD_BASE: the XC95144XL answers to the data strobe DS# in the upper half of data space. */
#ifndef HAL_CPLD_REGISTERS_H
#define HAL_CPLD_REGISTERS_H

#define CPLD_BASE 0x8000U
#define CPLD_VERSION 0xA1
/* Wait states that its outputs need: 3 cycles of 25 ns for 10 ns parts behind a bus that takes
 * about half a cycle at each end. To be checked against the timing tables of the data sheet. */
#define CPLD_WAIT_STATES 2

#define CPLD_REGISTER(name, offset, access, bits, description) CPLD_##name = (offset),
enum {
#include "hal/cpld/registers.def"
    CPLD_REGISTERS_END
};
#undef CPLD_REGISTER

#define CPLD_REGISTER(name, offset, access, bits, description) CPLD_##name##_BITS = (bits),
enum {
#include "hal/cpld/registers.def"
    CPLD_BITS_END
};
#undef CPLD_REGISTER

#endif
