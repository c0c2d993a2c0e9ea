/* The supervisor's tables, and the monitor of one wheel at the edge of each of its limits. */
#include <unity.h>

#include "firmware/supervisor.h"
#include "firmware/wheel_monitor.h"

static supervisor s;
static parameters p;
static wheel_monitor monitor;

void setUp(void) {
    parameters_set_defaults(&p);
    supervisor_start(&s);
    wheel_monitor_reset(&monitor, 0);
}

void tearDown(void) {}

static void drive(void) {
    supervisor_ask(&s, SUPERVISOR_READY);
    supervisor_ask(&s, SUPERVISOR_ARM);
    supervisor_ask(&s, SUPERVISOR_COMMAND);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, s.state);
}

/* ---- requests ---- */

static void a_start_forgets_all(void) {
    drive();
    supervisor_raise(&s, SUPERVISOR_FAULT_ENCODER_STUCK, 2);
    supervisor_start(&s);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_BOOT, s.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, s.fault);
    TEST_ASSERT_EQUAL_UINT16(0, s.fault_wheel);
}

static void a_robot_drives_only_after_boot_arming_and_a_command(void) {
    TEST_ASSERT_EQUAL_UINT16(0, supervisor_ask(&s, SUPERVISOR_ARM));
    TEST_ASSERT_EQUAL_UINT16(0, supervisor_ask(&s, SUPERVISOR_COMMAND));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_BOOT, s.state);
    TEST_ASSERT_EQUAL_UINT16(1, supervisor_ask(&s, SUPERVISOR_READY));
    TEST_ASSERT_FALSE(supervisor_ask(&s, SUPERVISOR_COMMAND));
    TEST_ASSERT_FALSE(supervisor_bridges_on(&s));
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_ARM));
    TEST_ASSERT_TRUE(supervisor_bridges_on(&s));
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_COMMAND));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, s.state);
}

static void stop_and_disarm_end_the_drive(void) {
    drive();
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_STOP));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, s.state);
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_DISARM));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, s.state);
    drive();
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_DISARM));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, s.state);
}

/* Whatever is asked in whatever state: stopping and disarming are safe, a request that is refused
 * changes nothing, and no request leads from a fault to a power stage that is on. */
static void no_request_is_unsafe_in_any_state(void) {
    for (int state = 0; state < SUPERVISOR_STATE_COUNT; state++) {
        for (int request = 0; request < SUPERVISOR_REQUEST_COUNT; request++) {
            u16 granted;
            s.state = (supervisor_state)state;
            granted = supervisor_ask(&s, (supervisor_request)request);
            TEST_ASSERT_TRUE(granted || (int)s.state == state);
            TEST_ASSERT_TRUE(s.state < SUPERVISOR_STATE_COUNT);
            TEST_ASSERT_TRUE(request != SUPERVISOR_STOP ||
                             (granted && s.state != SUPERVISOR_STATE_DRIVE));
            TEST_ASSERT_FALSE(request == SUPERVISOR_DISARM && supervisor_bridges_on(&s));
            TEST_ASSERT_FALSE(state == SUPERVISOR_STATE_FAULT && supervisor_bridges_on(&s));
        }
    }
}

/* ---- faults ---- */

static void every_fault_ends_the_drive_at_once(void) {
    for (int fault = SUPERVISOR_FAULT_NONE + 1; fault < SUPERVISOR_FAULT_COUNT; fault++) {
        supervisor_start(&s);
        drive();
        supervisor_raise(&s, (supervisor_fault)fault, 3);
        TEST_ASSERT_NOT_EQUAL(SUPERVISOR_STATE_DRIVE, s.state);
        TEST_ASSERT_EQUAL(fault, s.fault);
        TEST_ASSERT_EQUAL_UINT16(3, s.fault_wheel);
    }
}

static void after_a_timeout_the_next_command_drives(void) {
    drive();
    supervisor_raise(&s, SUPERVISOR_FAULT_COMMAND_TIMEOUT, 0);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, s.state);
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_COMMAND));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, s.fault);
}

/* The reason why the robot stands is shown until somebody wants it to move again. */
static void stopping_and_disarming_do_not_hide_the_fault(void) {
    drive();
    supervisor_raise(&s, SUPERVISOR_FAULT_COMMAND_TIMEOUT, 0);
    supervisor_ask(&s, SUPERVISOR_STOP);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_COMMAND_TIMEOUT, s.fault);
    supervisor_ask(&s, SUPERVISOR_DISARM);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_COMMAND_TIMEOUT, s.fault);
    supervisor_ask(&s, SUPERVISOR_READY); /* asked in every tick */
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_COMMAND_TIMEOUT, s.fault);
    supervisor_ask(&s, SUPERVISOR_ARM);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, s.fault);
}

static void under_voltage_leaves_by_itself_half_a_second_after_it_is_gone(void) {
    drive();
    for (int n = 0; n < 100; n++) {
        supervisor_tick(&s);
        supervisor_raise(&s, SUPERVISOR_FAULT_UNDER_VOLTAGE, 0);
    }
    for (int n = 0; n < SUPERVISOR_HEALTHY_MS; n++)
        supervisor_tick(&s);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, s.state);
    supervisor_tick(&s);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, s.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_UNDER_VOLTAGE, s.fault);
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_ARM));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, s.fault);
}

static void other_faults_wait_for_a_host(void) {
    drive();
    supervisor_raise(&s, SUPERVISOR_FAULT_ENCODER_STUCK, 2);
    for (int n = 0; n < 10000; n++)
        supervisor_tick(&s);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, s.state);
    TEST_ASSERT_FALSE(supervisor_ask(&s, SUPERVISOR_ARM));
    TEST_ASSERT_TRUE(supervisor_ask(&s, SUPERVISOR_CLEAR));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, s.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, s.fault);
    TEST_ASSERT_EQUAL_UINT16(0, s.fault_wheel);
}

static void the_first_fault_is_shown_unless_a_stricter_one_follows(void) {
    supervisor_raise(&s, SUPERVISOR_FAULT_UNDER_VOLTAGE, 0);
    supervisor_raise(&s, SUPERVISOR_FAULT_COMMAND_TIMEOUT, 0);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_UNDER_VOLTAGE, s.fault);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, s.state);
    supervisor_raise(&s, SUPERVISOR_FAULT_BRIDGE, 1);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_BRIDGE, s.fault);
    supervisor_raise(&s, SUPERVISOR_FAULT_ENCODER_STEP, 4);
    supervisor_raise(&s, SUPERVISOR_FAULT_UNDER_VOLTAGE, 0);
    supervisor_raise(&s, SUPERVISOR_FAULT_COMMAND_TIMEOUT, 0);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_BRIDGE, s.fault);
    TEST_ASSERT_EQUAL_UINT16(1, s.fault_wheel);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, s.state);
}

/* ---- one wheel ---- */

/* 6 V at rest: 61 N, above twice the grip of 29.4 N; stalled, the motor takes 10 A. */
static wheel_monitor_input strained(i16 current_ma, u16 count, i16 shaft_rad_s_q5) {
    const wheel_monitor_input input = {count, 0, shaft_rad_s_q5, 6 * 512, 61 * 256, current_ma, 0};
    return input;
}

/* The fault after this many ticks of the same input. */
static supervisor_fault after(int ticks, wheel_monitor_input input) {
    supervisor_fault fault = SUPERVISOR_FAULT_NONE;
    while (ticks-- > 0)
        fault = wheel_monitor_step(&monitor, &p, &input);
    return fault;
}

static void a_standing_counter_is_called_after_50_ms_by_its_current(void) {
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(49, strained(7600, 2, 0)));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_WHEEL_STALLED, after(1, strained(7505, 65534, 0)));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_WHEEL_STALLED, after(1, strained(-7505, 0, 0)));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_STUCK, after(1, strained(7495, 0, 0)));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_STUCK, after(1, strained(0, 0, 0)));
}

static void a_counter_that_moves_starts_the_time_anew(void) {
    after(49, strained(0, 0, 0));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(50, strained(0, 3, 0)));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_STUCK, after(1, strained(0, 3, 0)));
}

static void a_force_within_twice_the_grip_is_no_fault(void) {
    wheel_monitor_input input = strained(7600, 0, 0);
    input.force_n_q8 = 58 * 256;
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1000, input));
    input.force_n_q8 = -58 * 256;
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1000, input));
}

static void a_wheel_that_turns_against_its_voltage_is_called_after_50_ms(void) {
    wheel_monitor_input input = strained(0, 0, -30 * 32);
    for (int n = 0; n < 49; n++, input.count = (u16)(input.count - 10))
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1, input));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_REVERSED, after(1, input));
    input.voltage_v_q9 = (i16)-input.voltage_v_q9; /* now it turns with it */
    input.force_n_q8 = (i16)-input.force_n_q8;
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1, input));
    input.voltage_v_q9 = 0;
    for (int n = 0; n < 60; n++, input.count = (u16)(input.count - 10))
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1, input));
}

static void a_step_beyond_its_limit_is_called_at_once(void) {
    wheel_monitor_input input = {0, 449, 0, 0, 0, 0, 0};
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1, input));
    input.step_counts = -450;
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_STEP, after(1, input));
}

static void three_impossible_transitions_within_64_ms_are_called(void) {
    const wheel_monitor_input good = {0, 0, 0, 0, 0, 0, 0}, bad = {0, 0, 0, 0, 0, 0, 1};
    for (int n = 0; n < 100; n++) {
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1, bad));
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(64, good));
    }
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(2, bad)); /* two are no fault, however close */
    after(128, good);
    after(1, bad);
    after(20, good);
    after(1, bad);
    after(20, good);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_STEP, after(1, bad));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(1, bad));
}

/* 30 A reach a mean of 19.2 A after 64 ms ln(30 / 10.8) = 65 ms. */
static void current_is_called_by_its_mean(void) {
    const wheel_monitor_input peak = {0, 0, 0, 0, 0, -30000, 0}, high = {0, 0, 0, 0, 0, 19000, 0};
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(63, peak));
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_OVER_CURRENT, after(4, peak));
    wheel_monitor_reset(&monitor, 0);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, after(10000, high));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_start_forgets_all);
    RUN_TEST(a_robot_drives_only_after_boot_arming_and_a_command);
    RUN_TEST(stop_and_disarm_end_the_drive);
    RUN_TEST(no_request_is_unsafe_in_any_state);
    RUN_TEST(every_fault_ends_the_drive_at_once);
    RUN_TEST(after_a_timeout_the_next_command_drives);
    RUN_TEST(stopping_and_disarming_do_not_hide_the_fault);
    RUN_TEST(under_voltage_leaves_by_itself_half_a_second_after_it_is_gone);
    RUN_TEST(other_faults_wait_for_a_host);
    RUN_TEST(the_first_fault_is_shown_unless_a_stricter_one_follows);
    RUN_TEST(a_standing_counter_is_called_after_50_ms_by_its_current);
    RUN_TEST(a_counter_that_moves_starts_the_time_anew);
    RUN_TEST(a_force_within_twice_the_grip_is_no_fault);
    RUN_TEST(a_wheel_that_turns_against_its_voltage_is_called_after_50_ms);
    RUN_TEST(a_step_beyond_its_limit_is_called_at_once);
    RUN_TEST(three_impossible_transitions_within_64_ms_are_called);
    RUN_TEST(current_is_called_by_its_mean);
    return UNITY_END();
}
