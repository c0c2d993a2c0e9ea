/* Clocks, watchdog, tick and interrupt dispatch.
 *
 * Interrupts only set flags and move values; the firmware runs from the loop of main.c, one tick at
 * a time, so that a byte never waits for a tick:
 *
 *     T2 period, INT3   1 kHz: analog values are taken, a tick is due
 *     SCI, INT5         ring buffers of serial.c
 *     PDPINTA, PDPINTB  act in hardware; the flag is read once per tick (pwm.c)
 *
 * T2 counts CLKOUT / 8 = 5 MHz up to its period. Its compare match, 20 us before the period, starts
 * the ADC, so that every tick finds conversions that are finished and of the same age. The
 * interrupt takes them, not the tick: a tick that is late must not leave the sequencer where it
 * ended.
 */
#include "hal/cpld/registers.h"
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

#define TICK_COUNTS 5000 /* of 200 ns */
#define CONVERSION_COUNTS 100

DRIVER_DATA volatile u16 ticks_due;
DRIVER_DATA u16 tick_overruns;
DRIVER_DATA hal_reset_cause reset_cause;

static void start_watchdog(void) {
    reset_cause = (REGISTER_READ(WDCR) & WDCR_WDFLAG) ? HAL_RESET_WATCHDOG : HAL_RESET_POWER_ON;
    /* Out of reset it overflows after 3.3 ms. */
    REGISTER_WRITE(WDCR, WDCR_WDFLAG | WDCR_CHECK | WDCR_WDPS);
    hal_service_watchdog();
}

static void start_clocks(void) {
    REGISTER_WRITE(SCSR1, SCSR1_CLOCK_TIMES_4 | SCSR1_ADC | SCSR1_SCI | SCSR1_SPI | SCSR1_EVB |
                              SCSR1_EVA | SCSR1_ILLADR);
    REGISTER_WRITE(SCSR2, SCSR2_BOOT_EN | SCSR2_SARAM);
    IO_WRITE_WSGR((CPLD_WAIT_STATES << WSGR_DATA_SHIFT) | (1 << WSGR_IO_SHIFT));
}

/* Last: until here the pins are inputs, and the pull-downs hold the bridges. */
static void start_pins(void) {
    REGISTER_WRITE(MCRA, MCRA_SCI | MCRA_PWM1_TO_4);
    REGISTER_WRITE(MCRB, MCRB_MUST_STAY | MCRB_SPI);
    REGISTER_WRITE(MCRC, MCRC_PWM7_TO_10);
}

void board_start(void) {
    INTERRUPTS_OFF;
    start_watchdog();
    start_clocks();
    /* Neither is defined by reset. */
    REGISTER_WRITE(IMR, 0);
    REGISTER_WRITE(IFR, ALL_INT_BITS);
    ticks_due = 0;
    tick_overruns = 0;
    pwm_start();
    encoders_start();
    analog_start();
    serial_start();
    store_start();
    start_pins();
}

void board_run(void) {
    REGISTER_WRITE(EVA + T2CON, 0);
    REGISTER_WRITE(EVA + T2CNT, 0);
    REGISTER_WRITE(EVA + T2PR, TICK_COUNTS - 1);
    REGISTER_WRITE(EVA + T2CMPR, TICK_COUNTS - 1 - CONVERSION_COUNTS);
    REGISTER_WRITE(EVA + EVIFRB, EVB_T2PINT);
    REGISTER_WRITE(EVA + EVIMRB, EVB_T2PINT);
    REGISTER_WRITE(EVA + T2CON,
                   TCON_FREE | TCON_UP | TCON_DIVIDE_BY_8 | TCON_ENABLE | TCON_COMPARE);
    REGISTER_WRITE(IMR, INT3_BIT | INT5_BIT);
    INTERRUPTS_ON;
}

u16 board_tick_due(void) {
    u16 due;
    if (ticks_due == 0)
        return 0;
    INTERRUPTS_OFF;
    due = ticks_due;
    ticks_due = 0;
    INTERRUPTS_ON;
    tick_overruns = (u16)(tick_overruns + due - 1U);
    return 1;
}

INTERRUPT void board_int3(void) {
    if (REGISTER_READ(PIVR) == PIVR_T2PINT) {
        REGISTER_WRITE(EVA + EVIFRB, EVB_T2PINT);
        analog_collect();
        ticks_due = (u16)(ticks_due + 1U);
    }
}

INTERRUPT void board_int5(void) {
    const u16 source = REGISTER_READ(PIVR);
    if (source == PIVR_RXINT)
        serial_receive();
    else if (source == PIVR_TXINT)
        serial_transmit();
}

hal_reset_cause hal_read_reset_cause(void) {
    return reset_cause;
}

void hal_service_watchdog(void) {
    REGISTER_WRITE(WDKEY, WDKEY_FIRST);
    REGISTER_WRITE(WDKEY, WDKEY_SECOND);
}

u16 hal_read_tick_overruns(void) {
    const u16 overruns = tick_overruns;
    tick_overruns = 0;
    return overruns;
}
