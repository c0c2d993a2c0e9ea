/* State and fault of the robot; rules in supervisor.def.
 *
 * The tables are not const for the reason given in parameters.c.
 */
#include "firmware/supervisor.h"

#define SUPERVISOR_STATE_REFUSED SUPERVISOR_STATE_COUNT

/* In the order of strictness. */
enum { RECOVERY_COMMAND, RECOVERY_ITSELF, RECOVERY_CLEAR };

#define SUPERVISOR_FAULT(fault, recovery, description)
#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description) \
    {SUPERVISOR_STATE_##ready,   SUPERVISOR_STATE_##arm,  SUPERVISOR_STATE_##disarm,            \
     SUPERVISOR_STATE_##command, SUPERVISOR_STATE_##stop, SUPERVISOR_STATE_##clear},
static supervisor_state next_state[SUPERVISOR_STATE_COUNT][SUPERVISOR_REQUEST_COUNT] = {
#include "firmware/supervisor.def"
};
#undef SUPERVISOR_STATE

#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description) \
    bridges,
static u16 bridges_on[SUPERVISOR_STATE_COUNT] = {
#include "firmware/supervisor.def"
};
#undef SUPERVISOR_STATE
#undef SUPERVISOR_FAULT

#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description)
#define SUPERVISOR_FAULT(fault, recovery, description) RECOVERY_##recovery,
static u16 recovery_of[SUPERVISOR_FAULT_COUNT] = {
#include "firmware/supervisor.def"
};
#undef SUPERVISOR_STATE
#undef SUPERVISOR_FAULT

void supervisor_start(supervisor *s) {
    s->state = SUPERVISOR_STATE_BOOT;
    s->fault = SUPERVISOR_FAULT_NONE;
    s->fault_wheel = 0;
    s->healthy_ms = 0;
}

static void forget_fault(supervisor *s) {
    s->fault = SUPERVISOR_FAULT_NONE;
    s->fault_wheel = 0;
}

u16 supervisor_ask(supervisor *s, supervisor_request request) {
    const supervisor_state next = next_state[s->state][request];
    if (next == SUPERVISOR_STATE_REFUSED)
        return 0;
    s->state = next;
    if (request == SUPERVISOR_ARM || request == SUPERVISOR_COMMAND || request == SUPERVISOR_CLEAR) {
        forget_fault(s);
    }
    return 1;
}

void supervisor_raise(supervisor *s, supervisor_fault fault, u16 wheel) {
    const u16 recovery = recovery_of[fault];
    s->healthy_ms = 0;
    if (s->state == SUPERVISOR_STATE_FAULT && recovery <= recovery_of[s->fault])
        return;
    s->fault = fault;
    s->fault_wheel = wheel;
    s->state = recovery == RECOVERY_COMMAND ? SUPERVISOR_STATE_ARMED : SUPERVISOR_STATE_FAULT;
}

void supervisor_tick(supervisor *s) {
    if (s->state != SUPERVISOR_STATE_FAULT || recovery_of[s->fault] != RECOVERY_ITSELF)
        return;
    if (s->healthy_ms == SUPERVISOR_HEALTHY_MS)
        s->state = SUPERVISOR_STATE_IDLE;
    s->healthy_ms++;
}

u16 supervisor_bridges_on(const supervisor *s) {
    return bridges_on[s->state];
}
