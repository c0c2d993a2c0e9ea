/* The whole robot; see robot.h. */
#include "firmware/robot.h"

#include "hal/hal.h"

static void report_start(robot *r) {
    if (r->store.status == PARAMETER_STORE_CORRUPT ||
        r->store.status == PARAMETER_STORE_OTHER_TABLE)
        supervisor_report(&r->loop, SUPERVISOR_FAULT_STORE);
    if (hal_read_reset_cause() == HAL_RESET_WATCHDOG)
        supervisor_report(&r->loop, SUPERVISOR_FAULT_WATCHDOG);
}

void robot_init(robot *r) {
    link_parts parts;
    parts.settings = &r->settings;
    parts.loop = &r->loop;
    parts.store = &r->store;
    parts.told = &r->told;
    parts.frame = &r->frame;
    parameter_store_start(&r->store, &r->settings);
    control_loop_init(&r->loop, &r->settings);
    telemetry_init(&r->told, &r->loop, &r->store, &r->frame);
    link_init(&r->link, &parts);
    report_start(r);
}

void robot_tick(robot *r) {
    link_tick(&r->link);
    if (hal_read_tick_overruns() != 0)
        supervisor_report(&r->loop, SUPERVISOR_FAULT_OVERRUN);
    control_loop_tick(&r->loop);
    telemetry_tick(&r->told);
    parameter_store_tick(&r->store, &r->settings);
    hal_service_watchdog();
}
