/* Motor currents and supply through the ADC.
 *
 *     ADCIN00..03   current of wheels 1..4: 3.3 V / 1024 per 64 mA, 0 A at half scale (+-32.7 A)
 *     ADCIN04       supply: 3.3 V / 1024 per 33 V / 1024 (divider 1 : 10)
 *
 * The converter cuts off, so a code stands for the middle of its step; offset and gain of a real
 * chip, several codes, are not calibrated here.
 *
 * Both signals are filtered before the pin; one conversion a tick of the mean is enough. T2 starts
 * the sequence 20 us before the tick (board.c), five conversions take 3 us.
 *
 * The sequencer stops at its last channel: without RST SEQ1 the next start would go on from there.
 */
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

#define CHANNELS 5U
#define SUPPLY_CHANNEL 4
#define RESULT_SHIFT 6
#define HALF_SCALE 512
#define MA_PER_CODE 64
#define MV_PER_HALF_CODE_Q11 33000UL /* 33 V / 2048 in mV, times 2^11 */
#define ARM (ADCTRL2_RST_SEQ1 | ADCTRL2_EVA_SOC_SEQ1 | ADCTRL2_INT_FLAG_SEQ1)

DRIVER_DATA volatile u16 code[CHANNELS];

void analog_start(void) {
    u16 i;
    for (i = 0; i < CHANNELS; ++i)
        code[i] = i == SUPPLY_CHANNEL ? 0U : (u16)HALF_SCALE;
    REGISTER_WRITE(ADCTRL1, ADCTRL1_RESET);
    REGISTER_WRITE(ADCTRL1, ADCTRL1_ACQUIRE_4);
    REGISTER_WRITE(MAXCONV, CHANNELS - 1U);
    REGISTER_WRITE(CHSELSEQ1, 0x3210); /* first conversion in the lowest four bits */
    REGISTER_WRITE(CHSELSEQ2, 0x0004);
    REGISTER_WRITE(ADCTRL2, ARM);
    REGISTER_WRITE(EVA + GPTCON, GPTCON_T2_ADC_COMPARE);
}

void analog_collect(void) {
    u16 i;
    /* Still busy: this interrupt came a whole tick late. The values before stay. */
    if (!(REGISTER_READ(ADCTRL2) & ADCTRL2_SEQ1_BSY)) {
        for (i = 0; i < CHANNELS; ++i)
            code[i] = (u16)(REGISTER_READ(RESULT0 + i) >> RESULT_SHIFT);
    }
    REGISTER_WRITE(ADCTRL2, ARM);
}

u16 hal_read_supply_mv(void) {
    return (u16)(((2UL * code[SUPPLY_CHANNEL] + 1UL) * MV_PER_HALF_CODE_Q11 + 1024UL) >> 11);
}

void hal_read_currents_ma(i16 current_ma[4]) {
    u16 i;
    for (i = 0; i < 4U; ++i)
        current_ma[i] = (i16)(((i16)code[i] - HALF_SCALE) * MA_PER_CODE + MA_PER_CODE / 2);
}
