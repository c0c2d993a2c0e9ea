/* State and fault of the robot, by the tables of supervisor.def.
 *
 * The supervisor decides whether the robot may drive; it knows nothing of control. Requests come
 * from the host, faults from whoever sees them, once a tick for as long as they last.
 *
 * The first fault is the one that is shown: what follows is mostly its consequence. One that needs
 * a host to clear it replaces one that does not. After the recovery the code stays, as the reason
 * why the robot stopped, until it is armed, commanded or cleared.
 */
#ifndef FIRMWARE_SUPERVISOR_H
#define FIRMWARE_SUPERVISOR_H

#include "firmware/integers.h"

#define SUPERVISOR_HEALTHY_MS 500

#ifdef __cplusplus
extern "C" {
#endif

#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description) \
    SUPERVISOR_STATE_##state,
#define SUPERVISOR_FAULT(fault, recovery, description)
typedef enum {
#include "firmware/supervisor.def"
    SUPERVISOR_STATE_COUNT
} supervisor_state;
#undef SUPERVISOR_STATE
#undef SUPERVISOR_FAULT

#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description)
#define SUPERVISOR_FAULT(fault, recovery, description) SUPERVISOR_FAULT_##fault,
typedef enum {
#include "firmware/supervisor.def"
    SUPERVISOR_FAULT_COUNT
} supervisor_fault;
#undef SUPERVISOR_STATE
#undef SUPERVISOR_FAULT

/* In the order of the columns of supervisor.def. */
typedef enum {
    SUPERVISOR_READY = 0,
    SUPERVISOR_ARM,
    SUPERVISOR_DISARM,
    SUPERVISOR_COMMAND,
    SUPERVISOR_STOP,
    SUPERVISOR_CLEAR,
    SUPERVISOR_REQUEST_COUNT
} supervisor_request;

typedef struct {
    supervisor_state state;
    supervisor_fault fault;
    u16 fault_wheel; /* 1..4, 0 when the fault is not of a wheel */
    u16 healthy_ms;  /* in FAULT: ticks since a fault was last raised */
} supervisor;

void supervisor_start(supervisor *s);
/* Returns 1 when the present state grants it, else 0 and nothing changes. */
u16 supervisor_ask(supervisor *s, supervisor_request request);
void supervisor_raise(supervisor *s, supervisor_fault fault, u16 wheel);
/* Once a tick, before the faults of the tick are raised. */
void supervisor_tick(supervisor *s);
/* 1 when the power stage is to be on. */
u16 supervisor_bridges_on(const supervisor *s);

#ifdef __cplusplus
}
#endif

#endif
