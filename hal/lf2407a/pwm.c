/* Four motors by sign and magnitude at 20 kHz.
 *
 *     wheel 1: PWM1, PWM2   wheel 2: PWM3, PWM4     EVA, CMPR1 and CMPR2, period of T1
 *     wheel 3: PWM7, PWM8   wheel 4: PWM9, PWM10    EVB, CMPR4 and CMPR5, period of T3
 *
 * A motor hangs between two half bridges; an input that is low, driven or by its pull-down, closes
 * the low side. Forward pulses the first pin of a pair and keeps the second low, reverse the other
 * way round; zero and "off" keep both low, which shorts the motor.
 *
 *     T1 counts 0..1999 at 40 MHz: 20 kHz. An active-high pin is low until CMPR, then high:
 *     high counts = 2000 - CMPR, so CMPR = 2000 - round(2000 |duty|); 0: always, 2000: never high.
 *
 * CMPR and ACTR are shadowed and reach the pins together when the period starts. Several writes can
 * straddle that moment. So a wheel that changes its sign is first set to zero in ACTR, then gets
 * its magnitude, then its sign: whichever subset is taken over, the pins show the old duty, zero or
 * the new duty, never one's sign with the other's magnitude.
 *
 * PDPINTx low: hardware makes the six pins of that event manager high-impedance and clears FCOMPOE;
 * the flag stays set, as record of it, until the bridges are switched on again.
 */
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

#define PERIOD_COUNTS 2000U
#define PERIOD_BITS 15
#define BRIDGE_PINS 4 /* bits of a pair in ACTR */
#define FORWARD ((u16)ACTR_ACTIVE_HIGH)
#define REVERSE ((u16)(ACTR_ACTIVE_HIGH << 2))

DRIVER_DATA u16 bridges_on;
DRIVER_DATA u16 actions_a;
DRIVER_DATA u16 actions_b;

static void start_event_manager(u16 base, u16 first_count) {
    REGISTER_WRITE(base + T1CON, 0);
    REGISTER_WRITE(base + GPTCON, 0);
    REGISTER_WRITE(base + T1CNT, first_count);
    REGISTER_WRITE(base + T1PR, PERIOD_COUNTS - 1U);
    REGISTER_WRITE(base + CMPR1, PERIOD_COUNTS);
    REGISTER_WRITE(base + CMPR2, PERIOD_COUNTS);
    REGISTER_WRITE(base + ACTR, 0);
    REGISTER_WRITE(base + DBTCON, 0);
    REGISTER_WRITE(base + COMCON, COMCON_CENABLE);
    REGISTER_WRITE(base + EVIMRA, EVA_PDPINT);
    REGISTER_WRITE(base + T1CON, TCON_FREE | TCON_UP | TCON_ENABLE);
}

void pwm_start(void) {
    bridges_on = 0;
    actions_a = 0;
    actions_b = 0;
    start_event_manager(EVA, 0);
    /* Half a period apart, so that the two halves do not draw their pulses together. */
    start_event_manager(EVB, PERIOD_COUNTS / 2U);
}

/* Counts of the period that a pin is high. */
static u16 high_counts(i16 duty_q15) {
    const u16 magnitude_q15 = duty_q15 < 0 ? (u16)(0U - (u16)duty_q15) : (u16)duty_q15;
    /* Q15 * counts, rounded */
    return (u16)(((u32)magnitude_q15 * PERIOD_COUNTS + (1UL << (PERIOD_BITS - 1))) >> PERIOD_BITS);
}

static u16 action(i16 duty_q15, u16 high) {
    if (high == 0)
        return 0;
    return duty_q15 < 0 ? REVERSE : FORWARD;
}

/* Two wheels of one event manager; returns the actions now in force. */
static u16 write_pair(u16 base, u16 old_actions, const i16 duty_q15[2]) {
    const u16 high_1 = bridges_on ? high_counts(duty_q15[0]) : 0U;
    const u16 high_2 = bridges_on ? high_counts(duty_q15[1]) : 0U;
    const u16 actions =
        (u16)(action(duty_q15[0], high_1) | (action(duty_q15[1], high_2) << BRIDGE_PINS));
    const u16 kept = old_actions & actions;
    if (kept != old_actions)
        REGISTER_WRITE(base + ACTR, kept);
    REGISTER_WRITE(base + CMPR1, PERIOD_COUNTS - high_1);
    REGISTER_WRITE(base + CMPR2, PERIOD_COUNTS - high_2);
    if (actions != kept)
        REGISTER_WRITE(base + ACTR, actions);
    return actions;
}

void hal_write_duty(const i16 duty_q15[4]) {
    actions_a = write_pair(EVA, actions_a, duty_q15);
    actions_b = write_pair(EVB, actions_b, duty_q15 + 2);
}

/* Stays off while the protection pin is still low; the flag keeps saying so. */
static void switch_on(u16 base) {
    if (REGISTER_READ(base + COMCON) & COMCON_PDPINT) {
        REGISTER_WRITE(base + EVIFRA, EVA_PDPINT);
        REGISTER_WRITE(base + COMCON, COMCON_CENABLE | COMCON_FCOMPOE);
    }
}

static void switch_off(void) {
    i16 zero_q15[4];
    u16 i;
    REGISTER_WRITE(EVA + COMCON, COMCON_CENABLE);
    REGISTER_WRITE(EVB + COMCON, COMCON_CENABLE);
    bridges_on = 0;
    for (i = 0; i < 4U; ++i)
        zero_q15[i] = 0;
    hal_write_duty(zero_q15);
}

void hal_enable_bridges(u16 on) {
    if (on && !bridges_on) {
        switch_on(EVA);
        switch_on(EVB);
        bridges_on = 1;
    } else if (!on && bridges_on) {
        switch_off();
    }
}

u16 hal_read_bridge_faults(void) {
    const u16 a = REGISTER_READ(EVA + EVIFRA) & EVA_PDPINT;
    const u16 b = REGISTER_READ(EVB + EVIFRA) & EVA_PDPINT;
    return (u16)(a | (b << 1));
}
