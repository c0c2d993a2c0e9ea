/* Passes the HAL calls on to the plant attached to this thread; see hal_host.h. */
#include "hal/host/hal_host.h"

#include <stdio.h>
#include <stdlib.h>

#include "hal/hal.h"

#define BLANK_WORD 0xFFFFU

static _Thread_local hal_host_plant attached;

static void require(int condition, const char *message) {
    if (condition)
        return;
    fprintf(stderr, "hal_host: %s\n", message);
    abort();
}

void hal_host_attach(const hal_host_plant *plant) {
    const hal_host_plant none = {0};
    require(
        plant == NULL || (plant->read_encoder_counts && plant->write_duty && plant->read_supply_mv),
        "a plant needs read_encoder_counts, write_duty and read_supply_mv");
    attached = plant ? *plant : none;
}

/* The plant of this thread; it has the three functions that every plant has. */
static const hal_host_plant *plant(void) {
    require(attached.read_encoder_counts != NULL, "no plant is attached to this thread");
    return &attached;
}

/* What a function of this plant reads, or what a plant without this function has. */
static u16 read_word(uint16_t (*read)(void *context), u16 otherwise) {
    return read ? read(attached.context) : otherwise;
}

/* ---- Motion ---- */

void hal_read_encoder_counts(u16 counts[4]) {
    plant()->read_encoder_counts(attached.context, counts);
}

u16 hal_read_encoder_errors(void) {
    return read_word(plant()->read_encoder_errors, 0);
}

u16 hal_read_supply_mv(void) {
    return plant()->read_supply_mv(attached.context);
}

void hal_read_currents_ma(i16 current_ma[4]) {
    int i;
    if (plant()->read_currents_ma) {
        attached.read_currents_ma(attached.context, current_ma);
        return;
    }
    for (i = 0; i < 4; i++)
        current_ma[i] = 0;
}

void hal_write_duty(const i16 duty_q15[4]) {
    plant()->write_duty(attached.context, duty_q15);
}

/* ---- Power stage ---- */

void hal_enable_bridges(u16 on) {
    if (plant()->enable_bridges)
        attached.enable_bridges(attached.context, on);
}

u16 hal_read_bridge_faults(void) {
    return read_word(plant()->read_bridge_faults, 0);
}

/* ---- Serial line ---- */

u16 hal_serial_read(u16 *byte) {
    return plant()->serial_read ? attached.serial_read(attached.context, byte) : 0;
}

u16 hal_serial_space(void) {
    return read_word(plant()->serial_space, 0);
}

void hal_serial_write(u16 byte) {
    if (plant()->serial_write)
        attached.serial_write(attached.context, byte);
}

u16 hal_serial_lost(void) {
    return read_word(plant()->serial_lost, 0);
}

/* ---- Store ---- */

u16 hal_store_busy(void) {
    return read_word(plant()->store_busy, 0);
}

u16 hal_store_read(u16 address) {
    return plant()->store_read ? attached.store_read(attached.context, address) : BLANK_WORD;
}

void hal_store_write(u16 address, u16 word) {
    if (plant()->store_write)
        attached.store_write(attached.context, address, word);
}

/* ---- Reset, watchdog, time ---- */

hal_reset_cause hal_read_reset_cause(void) {
    return (hal_reset_cause)read_word(plant()->read_reset_cause, HAL_RESET_POWER_ON);
}

void hal_service_watchdog(void) {
    if (plant()->service_watchdog)
        attached.service_watchdog(attached.context);
}

u16 hal_read_tick_overruns(void) {
    return read_word(plant()->read_tick_overruns, 0);
}
