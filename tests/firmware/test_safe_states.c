/* What ends in zero duty, and what keeps the duty within its limit. */
#include <unity.h>

#include "tests/firmware/closed_loop.h"
#include "tests/firmware/reference.h"

static const kinematics_velocity still = {0, 0, 0};

void setUp(void) {
    start(1);
}

void tearDown(void) {}

static void commands_need_arming(void) {
    const odometry_pose goal = {8192000, 0, 0};
    static const i16 duty_q15[4] = {1000, 1000, 1000, 1000};
    TEST_ASSERT_TRUE(control_loop_disarm(&loop));
    TEST_ASSERT_FALSE(control_loop_command_velocity(&loop, 1000, 0, 0));
    TEST_ASSERT_FALSE(control_loop_command_duty(&loop, duty_q15));
    TEST_ASSERT_EQUAL(TRAJECTORY_REFUSED, control_loop_command_pose(&loop, &goal, &still));
    for (int n = 0; n < 100; n++)
        reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, largest_duty());
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, loop.telemetry.state);
    TEST_ASSERT_EQUAL_INT(0, plant.bridges_on);
    TEST_ASSERT_TRUE(control_loop_arm(&loop));
    TEST_ASSERT_TRUE(control_loop_command_velocity(&loop, 1000, 0, 0));
    reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, loop.telemetry.state);
    TEST_ASSERT_EQUAL_INT(1, plant.bridges_on);
}

/* A fault seen before the first tick: the counters of a board that was reset while the wheels
 * stood anywhere are still no step. */
static void fault_at_boot_waits_to_be_cleared(void) {
    plant.seen_angle_rad[0] = 31.0; /* 9867.6 counts */
    control_loop_init(&loop, &p);
    supervisor_report(&loop, SUPERVISOR_FAULT_STORE);
    control_loop_tick(&loop);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_STORE, loop.telemetry.fault);
    TEST_ASSERT_EQUAL_INT16(0, loop.telemetry.shaft_rad_s_q5[0]);
    TEST_ASSERT_EQUAL_UINT16(9867, loop.telemetry.encoder_counts[0]); /* told in any state */
    TEST_ASSERT_FALSE(control_loop_arm(&loop));
    TEST_ASSERT_TRUE(control_loop_clear_fault(&loop));
    TEST_ASSERT_TRUE(control_loop_arm(&loop));
    drive(500, 0, 0, 500);
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 0.5, plant.state[PLANT_VX]);
}

static void command_that_is_not_repeated_dies_after_200_ms(void) {
    drive(1000, 0, 0, 301); /* repeated at tick 300 last */
    for (int n = 0; n < 199; n++)
        reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL(CONTROL_MODE_VELOCITY, loop.telemetry.mode);
    TEST_ASSERT_TRUE(largest_duty() > 0.01);
    reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, loop.telemetry.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_COMMAND_TIMEOUT, loop.telemetry.fault);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, largest_duty());
    drive(1000, 0, 0, 100);
    TEST_ASSERT_TRUE(largest_duty() > 0.01);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, loop.telemetry.fault);
}

static void stop_is_zero_duty_in_the_next_tick(void) {
    drive(1000, 0, 0, 500);
    control_loop_stop(&loop);
    reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, largest_duty());
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, loop.telemetry.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, loop.telemetry.fault);
}

static void low_supply_is_zero_duty_in_the_same_tick(void) {
    static const double supplies_v[] = {11.9, 3.0, 0.0};
    for (int k = 0; k < 3; k++) {
        start(1);
        drive(1000, 0, 0, 200);
        plant.supply_v = supplies_v[k];
        reference_plant_tick(&plant, &loop);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, largest_duty());
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_UNDER_VOLTAGE, loop.telemetry.fault);
    }
}

/* Nothing a plant or a commander can do makes the arithmetic overflow (the build with sanitizers
 * sees it). */
static void garbage_from_outside_keeps_the_duty_within_its_limit(void) {
    uint64_t seed = 17;
    parameters_set(&p, PARAMETER_ID_encoder_step_limit, 32767); /* else most ticks are faults */
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        for (int i = 0; i < 4; i++)
            plant.state[PLANT_ANGLE + i] = reference_random(&seed) % 100000u;
        plant.supply_v = 13.0 + reference_random(&seed) % 50u;
        if (n % 50 == 0) {
            control_loop_clear_fault(&loop);
            control_loop_arm(&loop);
            control_loop_command_velocity(&loop, (i16)reference_random(&seed),
                                          (i16)reference_random(&seed),
                                          (i16)reference_random(&seed));
        }
        control_loop_tick(&loop);
        TEST_ASSERT_TRUE(largest_duty() <= 32767.0 / 32768.0);
    }
}

/* The same for any parameters that their own limits allow. */
static void any_allowed_parameters_keep_the_duty_within_its_limit(void) {
    static int minimum[] = {
#define PARAMETER(name, unit, q_bits, low, high, initial, description) low,
#include "firmware/parameters.def"
#undef PARAMETER
    };
    static int maximum[] = {
#define PARAMETER(name, unit, q_bits, low, high, initial, description) high,
#include "firmware/parameters.def"
#undef PARAMETER
    };
    uint64_t seed = 23;
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        const odometry_pose goal = {(i32)reference_random(&seed), (i32)reference_random(&seed),
                                    (i32)reference_random(&seed)};
        const u16 id = (u16)(reference_random(&seed) % PARAMETER_COUNT);
        const u32 span = (u32)((i32)maximum[id] - minimum[id] + 1);
        parameters_set(&p, id, (i32)minimum[id] + (i32)(reference_random(&seed) % span));
        parameters_set(&p, PARAMETER_ID_encoder_step_limit, 32767);
        for (int i = 0; i < 4; i++)
            plant.state[PLANT_ANGLE + i] = reference_random(&seed) % 999u;
        control_loop_clear_fault(&loop);
        control_loop_arm(&loop);
        if (n % 5 == 0)
            control_loop_outside_pose(&loop, &goal, (i16)(n % 250));
        if (n % 7 == 0)
            control_loop_command_pose(&loop, &goal, &still);
        if (n % 7 == 3)
            control_loop_command_velocity(&loop, I16_MIN, I16_MAX, I16_MIN);
        control_loop_tick(&loop);
        TEST_ASSERT_TRUE(largest_duty() <= 32767.0 / 32768.0);
    }
}

static void a_bridge_that_protects_itself_is_told_with_its_first_wheel(void) {
    for (u16 half = 0; half < 2; half++) {
        start(1);
        drive(300, 0, 0, 20);
        plant.bridge_faults = (uint16_t)(1U << half);
        reference_plant_tick(&plant, &loop);
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_BRIDGE, loop.telemetry.fault);
        TEST_ASSERT_EQUAL_UINT16(1 + 2 * half, loop.telemetry.fault_wheel);
    }
}

/* What the fault line of a bridge without power shows means nothing, from the first tick on. */
static void a_bridge_that_is_off_has_no_fault(void) {
    plant.bridge_faults = 3;
    control_loop_init(&loop, &p);
    control_loop_tick(&loop);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, loop.telemetry.fault);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, loop.telemetry.state);
}

static void a_fault_of_a_wheel_is_told_with_its_number(void) {
    for (u16 wheel = 0; wheel < WHEEL_COUNT; wheel++) {
        start(1);
        drive(300, 0, 0, 20);
        for (int ticks = 0; ticks < 3; ticks++) {
            plant.encoder_errors = (uint16_t)(1U << wheel);
            reference_plant_tick(&plant, &loop);
        }
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_ENCODER_STEP, loop.telemetry.fault);
        TEST_ASSERT_EQUAL_UINT16(wheel + 1, loop.telemetry.fault_wheel);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(commands_need_arming);
    RUN_TEST(fault_at_boot_waits_to_be_cleared);
    RUN_TEST(command_that_is_not_repeated_dies_after_200_ms);
    RUN_TEST(stop_is_zero_duty_in_the_next_tick);
    RUN_TEST(low_supply_is_zero_duty_in_the_same_tick);
    RUN_TEST(garbage_from_outside_keeps_the_duty_within_its_limit);
    RUN_TEST(any_allowed_parameters_keep_the_duty_within_its_limit);
    RUN_TEST(a_bridge_that_protects_itself_is_told_with_its_first_wheel);
    RUN_TEST(a_bridge_that_is_off_has_no_fault);
    RUN_TEST(a_fault_of_a_wheel_is_told_with_its_number);
    return UNITY_END();
}
