/* The whole robot: parameters, store, control loop, link and telemetry in one tick.
 *
 *     static robot r;
 *     robot_init(&r);          once, before the tick is on
 *     robot_tick(&r);          every 1 ms, nothing else beside it
 *
 * It runs on the board and in the simulation alike; all it touches lies behind hal.h.
 */
#ifndef FIRMWARE_ROBOT_H
#define FIRMWARE_ROBOT_H

#include "firmware/control_loop.h"
#include "firmware/link.h"
#include "firmware/parameter_store.h"
#include "firmware/telemetry.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    parameters settings;
    parameter_store store;
    control_loop loop;
    telemetry told;
    link_state link;
    frame_writer frame;
} robot;

/* Loads the parameters and brings all to rest; duties zero, power stage off. The parts point at
 * each other: a robot stays where it is. */
void robot_init(robot *r);
void robot_tick(robot *r);

#ifdef __cplusplus
}
#endif

#endif
