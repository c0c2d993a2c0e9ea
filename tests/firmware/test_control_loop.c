/* Velocities in closed loop: ramps, turning, standing still, the supply, the bridges' limits. */
#include <unity.h>

#include "tests/firmware/closed_loop.h"
#include "tests/firmware/reference.h"

void setUp(void) {
    start(1);
}

void tearDown(void) {}

/* A ramp of a second, then steady. 15 N and rollers cost about 50 mm/s of slip for 1 s and 6 mm/s
 * afterwards: rolling odometry misses that way, the observer does not. */
static void step_to_1500_mm_s(i16 slip_compensation) {
    double fastest = 0.0;
    start(slip_compensation);
    for (int n = 0; n < 20; n++) {
        drive(1500, 0, 0, 100);
        fastest = fmax(fastest, plant.state[PLANT_VX]);
    }
    TEST_ASSERT_TRUE(fastest < 1.05 * 1.5);
    TEST_ASSERT_DOUBLE_WITHIN(0.015, 1.5, plant.state[PLANT_VX]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 0.0, true_y_mm());
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_NONE, loop.telemetry.limit);
}

static void step_of_speed_without_slip_compensation(void) {
    double missed_mm;
    step_to_1500_mm_s(0);
    missed_mm = believed_x_mm() - true_x_mm();
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.5, loop.telemetry.rolling.x_m_s_q13 / 8192.0);
    TEST_ASSERT_TRUE(missed_mm > 50.0 && missed_mm < 120.0);
}

static void step_of_speed_with_slip_compensation(void) {
    step_to_1500_mm_s(1);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.5, loop.telemetry.observed.x_m_s_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(8.0, true_x_mm(), believed_x_mm());
}

/* The feed-forward alone, without any control, knows the nominal robot: no term of it is missing.
 */
static void feed_forward_alone_follows_the_ramp(void) {
    parameters_set(&p, PARAMETER_ID_speed_gain_q15, 0);
    parameters_set(&p, PARAMETER_ID_speed_integral_q22, 0);
    parameters_set(&p, PARAMETER_ID_position_gain_q20, 0);
    drive(1500, 0, 0, 1000);
    TEST_ASSERT_DOUBLE_WITHIN(0.015, loop.target.velocity.axis_q22[0] / 4194304.0,
                              plant.state[PLANT_VX]);
    drive(1500, 0, 0, 1000);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.5, plant.state[PLANT_VX]);
}

static void turning_robot_moves_along_its_own_axes(void) {
    drive(500, 300, 1000, 2000);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.5, plant.state[PLANT_VX]);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.3, plant.state[PLANT_VY]);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 1.0, plant.state[PLANT_W]);
    TEST_ASSERT_DOUBLE_WITHIN(8.0, true_x_mm(), believed_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(8.0, true_y_mm(), believed_y_mm());
}

/* 0.045 mrad times the heading gain of 5 1/s is less than half a unit of omega Q11 and of the shaft
 * speed: were it rounded away, the believed heading would stay there. */
static void corrections_below_a_unit_are_not_lost(void) {
    double sum_mrad = 0.0;
    start(0);
    drive(1500, 0, 0, 1500);
    for (int n = 0; n < 500; n++) {
        drive(1500, 0, 0, 1);
        sum_mrad += loop.telemetry.pose.theta_mrad_q13 / 8192.0;
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, sum_mrad / 500.0);
}

static void no_limit_cycle_at_standstill(void) {
    reference_plant before;
    drive(800, -400, 2000, 1000);
    drive(0, 0, 0, 2000);
    before = plant;
    for (int n = 0; n < 20; n++) {
        drive(0, 0, 0, 100);
        TEST_ASSERT_TRUE(hypot(plant.state[PLANT_VX], plant.state[PLANT_VY]) < 0.001);
        TEST_ASSERT_TRUE(largest_duty() < 0.01);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.5, before.state[PLANT_X] * 1000.0, true_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(0.5, before.state[PLANT_Y] * 1000.0, true_y_mm());
}

/* 3.75 N of Coulomb friction at each rim. Known, it holds the robot still. Unknown, the observer
 * takes the voltage that holds against it for slip, and the robot creeps, but not faster than the
 * slip of that force, tan(pi/2 3.75 / 29.4) / k = 5.1 mm/s. Still is what moves less than the
 * resolution of its speed, 2^-13 m/s, would take it in the 3 s. */
static void no_limit_cycle_with_dry_friction(void) {
    static const i16 known_q8[] = {0, 960};
    static const double range_mm[] = {3.0 * 5.1, 3000.0 / 8192.0};
    for (int k = 0; k < 2; k++) {
        double lowest_mm, highest_mm;
        start(1);
        plant.coulomb_nm = 3.75 / 240.0;
        parameters_set(&p, PARAMETER_ID_coulomb_force_q8, known_q8[k]);
        drive(800, -400, 2000, 1000);
        drive(0, 0, 0, 2500);
        lowest_mm = highest_mm = true_x_mm();
        for (int n = 0; n < 3000; n++) {
            drive(0, 0, 0, 1);
            lowest_mm = fmin(lowest_mm, true_x_mm());
            highest_mm = fmax(highest_mm, true_x_mm());
        }
        TEST_ASSERT_TRUE(highest_mm - lowest_mm < range_mm[k]);
    }
}

static void robot_that_never_moved_has_no_duty(void) {
    drive(0, 0, 0, 1000);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, largest_duty());
}

static void duty_command_reaches_the_bridges_up_to_its_limit(void) {
    static const i16 duty_q15[4] = {1000, -2000, I16_MIN, I16_MAX};
    parameters_set(&p, PARAMETER_ID_duty_limit_q15, 16384);
    control_loop_command_duty(&loop, duty_q15);
    reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL_DOUBLE(1000.0 / 32768.0, plant.duty[0]);
    TEST_ASSERT_EQUAL_DOUBLE(-2000.0 / 32768.0, plant.duty[1]);
    TEST_ASSERT_EQUAL_DOUBLE(-0.5, plant.duty[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, plant.duty[3]);
    TEST_ASSERT_EQUAL_UINT16(0, loop.telemetry.encoder_counts[0]); /* its neighbour in memory */
}

static void weak_supply_is_reported_as_the_limit(void) {
    plant.supply_v = 12.5; /* no-load rim speed 2 m/s, 4.1 m/s forward at most */
    parameters_set(&p, PARAMETER_ID_duty_limit_q15, 6000);
    drive(1500, 0, 0, 1500);
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_VOLTAGE, loop.telemetry.limit);
    TEST_ASSERT_TRUE(loop.telemetry.limit_wheel >= 1 && loop.telemetry.limit_wheel <= 4);
    TEST_ASSERT_TRUE(largest_duty() <= 6000.0 / 32768.0);
    drive(0, 0, 0, 1500); /* at rest nothing limits */
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_NONE, loop.telemetry.limit);
    TEST_ASSERT_EQUAL_UINT16(0, loop.telemetry.limit_wheel);
}

/* Signs of x and y; turning to the left with them, each wheel is the fastest and bears most once.
 */
static const i16 direction_of_wheel[4][2] = {{-1, 1}, {-1, -1}, {1, -1}, {1, 1}};

static void expect_limit(control_limit limit, int wheel) {
    TEST_ASSERT_EQUAL(limit, loop.telemetry.limit);
    TEST_ASSERT_EQUAL_UINT16(wheel, loop.telemetry.limit_wheel);
}

static void limits_of_the_command_are_named_without_a_wheel(void) {
    drive(3000, 0, 0, 100);
    expect_limit(CONTROL_LIMIT_ACCELERATION, 0);
    drive(3000, 0, 0, 1700);
    expect_limit(CONTROL_LIMIT_SPEED, 0);
}

static void grip_that_limits_a_ramp_is_named_with_the_wheel(void) {
    for (int i = 0; i < 4; i++) {
        const i16 *sign = direction_of_wheel[i];
        start(1);
        parameters_set(&p, PARAMETER_ID_acceleration_limit_q10, 16000);
        drive((i16)(1000 * sign[0]), (i16)(1000 * sign[1]), 1000, 10);
        expect_limit(CONTROL_LIMIT_TRACTION, i + 1);
    }
}

/* A camera's largest correction moves the believed pose by 0.25 mm and 0.5 mrad in a tick, of which
 * the position control makes 1 m/s2 and 2.5 rad/s2: 17 N at the most loaded wheel, 14 N at the
 * next one. */
static void grip_that_limits_a_correction_is_named_with_the_wheel(void) {
    static const odometry_pose goal = {0, 0, 0};
    static const kinematics_velocity still = {0, 0, 0};
    for (int i = 0; i < 4; i++) {
        const i16 *sign = direction_of_wheel[i];
        /* 64 mm, 128 mrad */
        const odometry_pose seen = {-524288L * sign[0], -524288L * sign[1], -1048576L};
        start(1);
        parameters_set(&p, PARAMETER_ID_traction_limit_q8, 10 * 256);
        control_loop_command_pose(&loop, &goal, &still);
        reference_plant_tick(&plant, &loop);
        expect_limit(CONTROL_LIMIT_NONE, 0);
        control_loop_outside_pose(&loop, &seen, 0);
        reference_plant_tick(&plant, &loop);
        expect_limit(CONTROL_LIMIT_TRACTION, i + 1);
    }
}

/* Bridges that give four fifths of what the fastest wheel needs; the others need half of it. */
static void voltage_that_limits_is_named_with_the_wheel(void) {
    for (int i = 0; i < 4; i++) {
        const i16 *sign = direction_of_wheel[i];
        start(1);
        drive((i16)(500 * sign[0]), (i16)(300 * sign[1]), 1000, 600);
        expect_limit(CONTROL_LIMIT_NONE, 0);
        parameters_set(&p, PARAMETER_ID_duty_limit_q15, (i16)(0.8 * 32768.0 * plant.duty[i]));
        reference_plant_tick(&plant, &loop);
        expect_limit(CONTROL_LIMIT_VOLTAGE, i + 1);
    }
}

static void supply_voltage_does_not_change_the_motion(void) {
    double at_24_v;
    drive(800, 0, 0, 1200);
    at_24_v = true_x_mm();
    start(1);
    plant.supply_v = 16.0;
    drive(800, 0, 0, 1200);
    TEST_ASSERT_DOUBLE_WITHIN(4.0, at_24_v, true_x_mm());
}

static void a_supply_beyond_the_format_counts_as_its_end(void) {
    plant.supply_v = 65.0;
    drive(300, 0, 0, 500);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, loop.telemetry.fault);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.3, plant.state[PLANT_VX]);
}

/* Accelerating, a wheel that is told to slip turns faster than one that is told to roll. */
static void rims_carry_slip_only_when_it_is_compensated(void) {
    i16 target_q5[2];
    for (i16 compensated = 0; compensated < 2; compensated++) {
        start(compensated);
        drive(1000, 0, 0, 20);
        target_q5[compensated] = loop.wheel_target_rad_s_q5[2];
    }
    TEST_ASSERT_GREATER_THAN(target_q5[0] + 32, target_q5[1]);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(step_of_speed_without_slip_compensation);
    RUN_TEST(step_of_speed_with_slip_compensation);
    RUN_TEST(feed_forward_alone_follows_the_ramp);
    RUN_TEST(turning_robot_moves_along_its_own_axes);
    RUN_TEST(corrections_below_a_unit_are_not_lost);
    RUN_TEST(no_limit_cycle_at_standstill);
    RUN_TEST(no_limit_cycle_with_dry_friction);
    RUN_TEST(robot_that_never_moved_has_no_duty);
    RUN_TEST(duty_command_reaches_the_bridges_up_to_its_limit);
    RUN_TEST(weak_supply_is_reported_as_the_limit);
    RUN_TEST(limits_of_the_command_are_named_without_a_wheel);
    RUN_TEST(grip_that_limits_a_ramp_is_named_with_the_wheel);
    RUN_TEST(grip_that_limits_a_correction_is_named_with_the_wheel);
    RUN_TEST(voltage_that_limits_is_named_with_the_wheel);
    RUN_TEST(supply_voltage_does_not_change_the_motion);
    RUN_TEST(a_supply_beyond_the_format_counts_as_its_end);
    RUN_TEST(rims_carry_slip_only_when_it_is_compensated);
    return UNITY_END();
}
