/* Passes the HAL calls on to the plant attached to this thread; see hal_host.h. */
#include "hal/host/hal_host.h"

#include <stdio.h>
#include <stdlib.h>

#include "hal/hal.h"

static _Thread_local hal_host_plant attached;

static void require(int condition, const char *message) {
    if (condition)
        return;
    fprintf(stderr, "hal_host: %s\n", message);
    abort();
}

void hal_host_attach(const hal_host_plant *plant) {
    const hal_host_plant none = {NULL, NULL, NULL, NULL};
    require(
        plant == NULL || (plant->read_encoder_counts && plant->write_duty && plant->read_supply_mv),
        "a plant needs read_encoder_counts, write_duty and read_supply_mv");
    attached = plant ? *plant : none;
}

void hal_read_encoder_counts(u16 counts[4]) {
    require(attached.read_encoder_counts != NULL, "no plant is attached to this thread");
    attached.read_encoder_counts(attached.context, counts);
}

void hal_write_duty(const i16 duty_q15[4]) {
    require(attached.write_duty != NULL, "no plant is attached to this thread");
    attached.write_duty(attached.context, duty_q15);
}

u16 hal_read_supply_mv(void) {
    require(attached.read_supply_mv != NULL, "no plant is attached to this thread");
    return attached.read_supply_mv(attached.context);
}
