/* What Frama-C's Eva analyses: the whole robot, for ever, in a world of which nothing is known.
 *
 * Every read of the HAL gives any value its type can hold, each time another. The memory of the
 * robot holds anything at first, as after a reset.
 */
#include "firmware/robot.h"

/* Eva takes a volatile to be any value at each read. */
static volatile u16 any_u16;
static volatile i16 any_i16;

void hal_read_encoder_counts(u16 counts[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        counts[i] = any_u16;
}

u16 hal_read_encoder_errors(void) {
    return any_u16;
}

u16 hal_read_supply_mv(void) {
    return any_u16;
}

void hal_read_currents_ma(i16 current_ma[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        current_ma[i] = any_i16;
}

/* What is written is looked at: all of it must be initialised. */
static volatile i16 seen;

void hal_write_duty(const i16 duty_q15[4]) {
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        seen = duty_q15[i];
}

void hal_enable_bridges(u16 on) {
    seen = (i16)on;
}

u16 hal_read_bridge_faults(void) {
    return any_u16;
}

u16 hal_serial_read(u16 *byte) {
    if (any_u16 == 0)
        return 0;
    *byte = any_u16;
    return 1;
}

u16 hal_serial_space(void) {
    return any_u16;
}

void hal_serial_write(u16 byte) {
    seen = (i16)byte;
}

u16 hal_serial_lost(void) {
    return any_u16;
}

u16 hal_store_busy(void) {
    return any_u16;
}

u16 hal_store_read(u16 address) {
    /*@ assert inside_the_store: address < HAL_STORE_WORDS; */
    return any_u16;
}

void hal_store_write(u16 address, u16 word) {
    /*@ assert inside_the_store: address < HAL_STORE_WORDS; */
    seen = (i16)word;
}

hal_reset_cause hal_read_reset_cause(void) {
    return any_u16 != 0 ? HAL_RESET_WATCHDOG : HAL_RESET_POWER_ON;
}

void hal_service_watchdog(void) {}

u16 hal_read_tick_overruns(void) {
    return any_u16;
}

static robot r;

void eva_any_robot(void) {
    u16 *word = (u16 *)&r;
    u16 i;
    for (i = 0; i < sizeof r / sizeof *word; i++)
        word[i] = any_u16;
    robot_init(&r);
    /* Where ranges that grow may stop growing: half a turn; FASTEST_Q22; the mean of currents of
     * 32768 mA; the longest content and wire, at and beyond the end; the words of a bank. */
    /*@ loop widen_hints global:"all", -25735927, 25735927, -67108864, 67108864, 2097152,
          1, 2, 3, 4, 5, 6, 7, 8, 15, 16, 17, 20, 31, 32, 33, 34, 63, 64, 65, 66, 67, 68, 72, 73,
       251, 255, 511, 10000, 60000; */
    for (;;)
        robot_tick(&r);
}
