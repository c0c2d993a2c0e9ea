/* Every failure of motors, encoders, supply, link and store, in every way of driving.
 *
 * A case is a failure, a way to drive, a wheel where the failure has one, and the time at which it
 * happens. It passes when the duty is zero from the tick on in which the fault is reported, the
 * fault is the right one (and names the wheel) within the time that the table allows, and the
 * robot stays at zero duty although it is commanded on. A failure without a fault must raise none,
 * and so must ten minutes of driving with no failure at all, whatever the floor and the pushes.
 *
 *     firmware_fault_injection                 all cases and the table of times
 *     firmware_fault_injection ID...           these cases, tick by tick
 *
 * A case that fails prints the ID that replays it.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/firmware/reference.h"
#include "tests/firmware/reference_plant.h"

/* failure, per wheel, expected fault, ms until it is reported: driving, and driving at a crawl.
 * 0 ms: the fault may come or not. A stuck encoder or a blocked wheel shows 0.1 s after the
 * controller has raised the voltage to what no free wheel resists, the other deadlines follow from
 * wheel_monitor.h; a bridge must be on for a tick before its protection is read. A motor without
 * contact is dragged along by the floor, which is a fault where it is dragged against its voltage.
 */
#define FAILURES(F)                                           \
    F(none, 0, NONE, 0, 0)                                    \
    F(encoder_stuck, 1, ENCODER_STUCK, 400, 400)              \
    F(encoder_reversed, 1, ENCODER_REVERSED, 200, 200)        \
    F(encoder_jumps, 1, ENCODER_STEP, 1, 1)                   \
    F(decoder_sees_impossible_steps, 1, ENCODER_STEP, 21, 21) \
    F(decoder_sees_one_impossible_step, 1, NONE, 0, 0)        \
    F(shaft_blocked, 1, WHEEL_STALLED, 400, 400)              \
    F(motor_without_contact, 1, ENCODER_REVERSED, 0, 0)       \
    F(winding_shorted, 1, OVER_CURRENT, 100, 100)             \
    F(bridge_trips, 1, BRIDGE, 2, 2)                          \
    F(supply_gone, 0, UNDER_VOLTAGE, 1, 1)                    \
    F(supply_dips, 0, UNDER_VOLTAGE, 1, 1)                    \
    F(link_silent, 0, COMMAND_TIMEOUT, 201, 201)              \
    F(store_corrupt, 0, STORE, 1, 1)                          \
    F(tick_overrun, 0, OVERRUN, 1, 1)                         \
    F(watchdog_reset, 0, WATCHDOG, 1, 1)

#define AS_ENUM(name, per_wheel, fault, ms, crawl_ms) FAILURE_##name,
enum { FAILURES(AS_ENUM) FAILURE_COUNT };
#undef AS_ENUM

typedef struct {
    const char *name;
    int per_wheel;
    supervisor_fault fault;
    int deadline_ms, crawl_deadline_ms;
} failure_kind;

#define AS_ROW(name, per_wheel, fault, ms, crawl_ms) \
    {#name, per_wheel, SUPERVISOR_FAULT_##fault, ms, crawl_ms},
static const failure_kind failures[FAILURE_COUNT] = {FAILURES(AS_ROW)};
#undef AS_ROW

enum { DRIVE_VELOCITY, DRIVE_POSE, DRIVE_DUTY };

typedef struct {
    const char *name;
    int kind, crawl;
    int value[4]; /* mm/s, mm/s, mrad/s; mm, mm, mrad; duty Q15 */
} scenario;

static const scenario scenarios[] = {
    {"forward", DRIVE_VELOCITY, 0, {1000, 0, 0, 0}},
    {"sideways", DRIVE_VELOCITY, 0, {0, -800, 0, 0}},
    {"spin", DRIVE_VELOCITY, 0, {0, 0, 4000, 0}},
    {"curve", DRIVE_VELOCITY, 0, {600, 400, 1500, 0}},
    {"crawl", DRIVE_VELOCITY, 1, {150, 0, 0, 0}},
    {"pose", DRIVE_POSE, 0, {3000, 1000, 1000, 0}},
    {"duty", DRIVE_DUTY, 0, {9000, -9000, -9000, 9000}},
};
enum { SCENARIO_COUNT = sizeof scenarios / sizeof scenarios[0] };
static const int injection_ms[] = {0, 137, 700, 1499};
enum { TIME_COUNT = sizeof injection_ms / sizeof injection_ms[0] };

enum { AFTER_MS = 1500, STAYS_MS = 300 };

typedef struct {
    int failure, scenario, wheel, time_ms; /* wheel 0..3 */
} injection;

static parameters settings;
static control_loop loop;
static reference_plant plant;

static void name_of(const injection *c, char *name, size_t size) {
    snprintf(name, size, "%s/%s/%d/%d", failures[c->failure].name, scenarios[c->scenario].name,
             c->wheel + 1, c->time_ms);
}

static void command(const scenario *s) {
    const kinematics_velocity still = {0, 0, 0};
    const i16 duty_q15[4] = {(i16)s->value[0], (i16)s->value[1], (i16)s->value[2],
                             (i16)s->value[3]};
    const odometry_pose goal = {s->value[0] * 8192, s->value[1] * 8192, s->value[2] * 8192};
    if (s->kind == DRIVE_POSE)
        control_loop_command_pose(&loop, &goal, &still);
    else if (s->kind == DRIVE_DUTY)
        control_loop_command_duty(&loop, duty_q15);
    else
        control_loop_command_velocity(&loop, duty_q15[0], duty_q15[1], duty_q15[2]);
}

/* The failure since_ms after it began; lasting ones only set what is broken. */
static void fail(const injection *c, int since_ms) {
    const int w = c->wheel;
    switch (c->failure) {
        case FAILURE_encoder_stuck:
            plant.encoder_gain[w] = 0.0;
            break;
        case FAILURE_encoder_reversed:
            plant.encoder_gain[w] = -1.0;
            break;
        case FAILURE_encoder_jumps:
            plant.seen_angle_rad[w] += since_ms == 0 ? 3.0 : 0.0;
            break;
        case FAILURE_decoder_sees_impossible_steps:
            plant.encoder_errors = (uint16_t)(since_ms % 10 == 0 ? 1 << w : 0);
            break;
        case FAILURE_decoder_sees_one_impossible_step:
            plant.encoder_errors = (uint16_t)(since_ms % 200 == 0 ? 1 << w : 0);
            break;
        case FAILURE_shaft_blocked:
            plant.shaft_blocked[w] = 1;
            plant.state[PLANT_SHAFT + w] = 0.0;
            break;
        case FAILURE_motor_without_contact:
            plant.torque_gain[w] = 0.0;
            break;
        case FAILURE_winding_shorted:
            plant.extra_current_a[w] = 40.0;
            break;
        case FAILURE_bridge_trips:
            plant.bridge_faults = w < 2 ? 1 : 2;
            break;
        case FAILURE_supply_gone:
            plant.supply_v = 0.0;
            break;
        case FAILURE_supply_dips:
            plant.supply_v = since_ms < 20 ? 11.0 : 24.0;
            break;
        case FAILURE_store_corrupt:
            supervisor_report(&loop, SUPERVISOR_FAULT_STORE);
            break;
        case FAILURE_tick_overrun:
            if (since_ms == 0)
                supervisor_report(&loop, SUPERVISOR_FAULT_OVERRUN);
            break;
        case FAILURE_watchdog_reset:
            if (since_ms == 0)
                supervisor_report(&loop, SUPERVISOR_FAULT_WATCHDOG);
            break;
        default:
            break;
    }
}

static int duty_is_zero(void) {
    int i, zero = 1;
    for (i = 0; i < 4; i++)
        zero = zero && plant.duty[i] == 0.0;
    return zero;
}

static int wheel_is_named(const injection *c) {
    const int named = (int)loop.telemetry.fault_wheel - 1;
    if (!failures[c->failure].per_wheel)
        return named == -1;
    return c->failure == FAILURE_bridge_trips ? named == (c->wheel < 2 ? 0 : 2) : named == c->wheel;
}

static int stopped(void) {
    return loop.telemetry.fault != SUPERVISOR_FAULT_NONE;
}

static void begin(void) {
    parameters_set_defaults(&settings);
    reference_plant_reset(&plant);
    reference_plant_start(&plant, &loop, &settings);
}

/* Drives one case; returns NULL when it passes, else what went wrong. *reported_ms: after the
 * failure began, -1 never. */
static const char *run(const injection *c, int verbose, int *reported_ms) {
    const failure_kind *kind = &failures[c->failure];
    const scenario *s = &scenarios[c->scenario];
    const int deadline_ms = s->crawl ? kind->crawl_deadline_ms : kind->deadline_ms;
    int tick, stayed_ms = 0;
    *reported_ms = -1;
    begin();
    for (tick = 0; tick < c->time_ms + AFTER_MS && stayed_ms < STAYS_MS; tick++) {
        const int since_ms = tick - c->time_ms;
        if (since_ms >= 0)
            fail(c, since_ms);
        if (since_ms <= 0 || c->failure != FAILURE_link_silent)
            command(s);
        reference_plant_tick(&plant, &loop);
        if (verbose && (tick % 10 == 0 || stopped())) {
            printf("%5d ms  state %d fault %d wheel %d  duty %+.3f %+.3f %+.3f %+.3f  shaft", tick,
                   (int)loop.telemetry.state, (int)loop.telemetry.fault,
                   (int)loop.telemetry.fault_wheel, plant.duty[0], plant.duty[1], plant.duty[2],
                   plant.duty[3]);
            printf(" %+.0f %+.0f %+.0f %+.0f\n", plant.state[0], plant.state[1], plant.state[2],
                   plant.state[3]);
        }
        if (stopped() && *reported_ms < 0)
            *reported_ms = since_ms;
        if (*reported_ms < 0)
            continue;
        stayed_ms++;
        if (loop.telemetry.fault != kind->fault)
            return "wrong fault";
        if (!wheel_is_named(c))
            return "wrong wheel";
        if (!duty_is_zero())
            return "duty after the fault";
        if (plant.bridges_on != (c->failure == FAILURE_link_silent))
            return "power stage in the wrong state";
    }
    if (kind->fault == SUPERVISOR_FAULT_NONE)
        return *reported_ms < 0 ? NULL : "false alarm";
    if (deadline_ms == 0)
        return NULL;
    if (*reported_ms < 0)
        return "no fault reported";
    return *reported_ms < deadline_ms ? NULL : "fault reported too late";
}

/* ---- All cases ---- */

static int report(const injection *c, const char *wrong) {
    char name[96];
    name_of(c, name, sizeof name);
    if (wrong)
        printf("FAIL %s: %s (%d %d)\n", name, wrong, (int)loop.telemetry.fault,
               (int)loop.telemetry.fault_wheel);
    return wrong != NULL;
}

static int run_failure(int failure) {
    const int wheels = failures[failure].per_wheel ? 4 : 1;
    int failed = 0, cases = 0, latest_ms = -1, latest_crawl_ms = -1;
    injection c = {failure, 0, 0, 0};
    for (c.scenario = 0; c.scenario < SCENARIO_COUNT; c.scenario++) {
        int *latest = scenarios[c.scenario].crawl ? &latest_crawl_ms : &latest_ms;
        for (c.wheel = 0; c.wheel < wheels; c.wheel++) {
            for (int n = 0; n < TIME_COUNT; n++) {
                int reported_ms;
                c.time_ms = injection_ms[n];
                failed += report(&c, run(&c, 0, &reported_ms));
                cases++;
                *latest = reported_ms > *latest ? reported_ms : *latest;
            }
        }
    }
    printf("%-34s %5d cases, latest %5d ms, crawling %5d ms\n", failures[failure].name, cases,
           latest_ms + 1, latest_crawl_ms + 1);
    return failed;
}

/* ---- Ten minutes without a failure ---- */

static double random_between(uint64_t *seed, double low, double high) {
    return low + (high - low) * reference_random(seed) / 4294967295.0;
}

/* A command, a floor, a supply, a push: anything that a robot meets. */
static void surprise(uint64_t *seed, scenario *s) {
    const uint32_t kind = reference_random(seed) % 8;
    const double worlds[3] = {4000.0, 4000.0, 3000.0};
    const double speeds[3] = {2500.0, 2500.0, 10000.0};
    int i;
    s->kind = kind < 5 ? DRIVE_VELOCITY : kind < 7 ? DRIVE_POSE : DRIVE_DUTY;
    for (i = 0; i < 4; i++) {
        const double largest = s->kind == DRIVE_DUTY   ? 32767.0
                               : s->kind == DRIVE_POSE ? worlds[i % 3]
                                                       : speeds[i % 3];
        s->value[i] = (int)random_between(seed, -largest, largest);
    }
    plant.mu_drive = random_between(seed, 0.1, 0.9);
    plant.supply_v = random_between(seed, 16.0, 27.0);
    for (i = 0; i < 3; i++)
        plant.state[PLANT_VX + i] += random_between(seed, -1.0, 1.0) * (i == 2 ? 4.0 : 1.0);
}

static int ten_minutes(i16 slip_compensation) {
    scenario s = {"mixed", DRIVE_VELOCITY, 0, {0, 0, 0, 0}};
    uint64_t seed = 5;
    int tick;
    begin();
    parameters_set(&settings, PARAMETER_ID_slip_compensation, slip_compensation);
    for (tick = 0; tick < 600000; tick++) {
        if (tick % 700 == 0)
            surprise(&seed, &s);
        command(&s);
        reference_plant_tick(&plant, &loop);
        if (stopped()) {
            printf("FAIL false alarm at %d ms, slip_compensation %d: fault %d wheel %d\n", tick,
                   slip_compensation, (int)loop.telemetry.fault, (int)loop.telemetry.fault_wheel);
            return 1;
        }
    }
    printf("10 minutes of mixed driving, slip_compensation %d: no fault\n", slip_compensation);
    return 0;
}

static int replay(const char *wanted) {
    injection c;
    char name[96];
    int n, reported_ms;
    for (c.failure = 0; c.failure < FAILURE_COUNT; c.failure++) {
        for (c.scenario = 0; c.scenario < SCENARIO_COUNT; c.scenario++) {
            for (c.wheel = 0; c.wheel < 4; c.wheel++) {
                for (n = 0; n < TIME_COUNT; n++) {
                    c.time_ms = injection_ms[n];
                    name_of(&c, name, sizeof name);
                    if (strcmp(name, wanted) == 0)
                        return report(&c, run(&c, 1, &reported_ms));
                }
            }
        }
    }
    fprintf(stderr, "firmware_fault_injection: no case %s; an ID is failure/scenario/wheel/ms\n",
            wanted);
    return 2;
}

int main(int argc, char **argv) {
    int failed = 0, n;
    if (argc > 1) {
        for (n = 1; n < argc; n++)
            failed |= replay(argv[n]);
        return failed;
    }
    for (n = 0; n < FAILURE_COUNT; n++)
        failed += run_failure(n);
    failed += ten_minutes(0) + ten_minutes(1);
    printf("%d failed\n", failed);
    return failed != 0;
}
