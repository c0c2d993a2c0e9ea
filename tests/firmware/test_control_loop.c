/* The whole firmware in closed loop with the double precision plant of reference_plant.h.
 *
 * Each closed-loop test asks three things: what the firmware believes, what the plant does, and
 * whether they agree.
 */
#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "tests/firmware/reference.h"
#include "tests/firmware/reference_plant.h"

static parameters p;
static control_loop loop;
static reference_plant plant;

static const kinematics_velocity still = {0, 0, 0};

static void start(i16 slip_compensation) {
    parameters_set_defaults(&p);
    parameters_set(&p, PARAMETER_ID_slip_compensation, slip_compensation);
    reference_plant_reset(&plant);
    reference_plant_start(&plant, &loop, &p);
}

void setUp(void) {
    start(1);
}

void tearDown(void) {}

static void drive(i16 x_mm_s, i16 y_mm_s, i16 omega_mrad_s, int ticks) {
    for (int n = 0; n < ticks; n++) {
        if (n % 100 == 0)
            control_loop_command_velocity(&loop, x_mm_s, y_mm_s, omega_mrad_s);
        reference_plant_tick(&plant, &loop);
    }
}

static double believed_x_mm(void) {
    return loop.telemetry.pose.x_mm_q13 / 8192.0;
}
static double believed_y_mm(void) {
    return loop.telemetry.pose.y_mm_q13 / 8192.0;
}
static double true_x_mm(void) {
    return plant.state[PLANT_X] * 1000.0;
}
static double true_y_mm(void) {
    return plant.state[PLANT_Y] * 1000.0;
}

static double largest_duty(void) {
    double largest = 0.0;
    for (int i = 0; i < 4; i++)
        largest = fmax(largest, fabs(plant.duty[i]));
    return largest;
}

/* ---- velocity ---- */

static void step_to_1500_mm_s(i16 slip_compensation) {
    const kinematics_velocity *believed;
    double fastest = 0.0;
    start(slip_compensation);
    for (int n = 0; n < 30; n++) {
        drive(1500, 0, 0, 100);
        fastest = fmax(fastest, plant.state[PLANT_VX]);
    }
    TEST_ASSERT_TRUE(fastest < 1.05 * 1.5);
    believed = slip_compensation ? &loop.telemetry.observed : &loop.telemetry.rolling;
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.5, believed->x_m_s_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.015, 1.5, plant.state[PLANT_VX]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 0.0, true_y_mm());
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_NONE, loop.telemetry.limit);
}

static void step_of_speed_without_slip_compensation(void) {
    step_to_1500_mm_s(0);
}
static void step_of_speed_with_slip_compensation(void) {
    step_to_1500_mm_s(1);
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
    drive(1500, 0, 0, 2000);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 1.5, plant.state[PLANT_VX]);
}

static void rolling_odometry_misses_the_slip_of_the_start_and_the_observer_does_not(void) {
    double missed_mm;
    start(0);
    drive(1500, 0, 0, 3000);
    missed_mm = believed_x_mm() - true_x_mm();
    /* 15 N and rollers cost about 50 mm/s of slip for 1 s and 6 mm/s afterwards */
    TEST_ASSERT_TRUE(missed_mm > 50.0 && missed_mm < 120.0);
    start(1);
    drive(1500, 0, 0, 3000);
    TEST_ASSERT_DOUBLE_WITHIN(8.0, true_x_mm(), believed_x_mm());
}

static void turning_robot_moves_along_its_own_axes(void) {
    drive(500, 300, 1000, 3000);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.5, plant.state[PLANT_VX]);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.3, plant.state[PLANT_VY]);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 1.0, plant.state[PLANT_W]);
    TEST_ASSERT_DOUBLE_WITHIN(8.0, true_x_mm(), believed_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(8.0, true_y_mm(), believed_y_mm());
}

static void no_limit_cycle_at_standstill(void) {
    reference_plant before;
    drive(800, -400, 2000, 2000);
    drive(0, 0, 0, 3000);
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
        drive(800, -400, 2000, 2000);
        drive(0, 0, 0, 4000);
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

/* ---- the impact ---- */

/* |y| of the plant 1.5 s after a sideways impulse at 1.5 m/s, mm. */
static double remaining_after_impulse_mm(i16 slip_compensation, double impulse_n_s, double mu) {
    start(slip_compensation);
    plant.mu_drive = mu;
    drive(1500, 0, 0, 2000);
    plant.state[PLANT_VY] += impulse_n_s / 20.0;
    drive(1500, 0, 0, 1500);
    return fabs(true_y_mm());
}

static void impact_is_seen_and_corrected(void) {
    const double plain_mm = remaining_after_impulse_mm(0, 10.0, 0.6);
    const double compensated_mm = remaining_after_impulse_mm(1, 10.0, 0.6);
    /* sliding with 0.6 * 9.81 * 2 sqrt 3 / 4 m/s2 from 0.5 m/s takes 25 mm */
    TEST_ASSERT_DOUBLE_WITHIN(5.0, 24.0, plain_mm);
    TEST_ASSERT_TRUE(compensated_mm < 0.4 * plain_mm);
    TEST_ASSERT_DOUBLE_WITHIN(compensated_mm + 1.0, 0.0, fabs(believed_y_mm()));
}

/* The firmware believes a grip of 0.6. */
static void correction_of_impacts_does_not_need_exact_grip(void) {
    static const double grips[] = {0.5, 0.57, 0.63, 0.7};
    static const double impulses[] = {6.0, 10.0, 15.0};
    for (int g = 0; g < 4; g++) {
        for (int k = 0; k < 3; k++) {
            const double plain_mm = remaining_after_impulse_mm(0, impulses[k], grips[g]);
            const double compensated_mm = remaining_after_impulse_mm(1, impulses[k], grips[g]);
            TEST_ASSERT_TRUE(compensated_mm < plain_mm);
        }
    }
}

/* Grip believed a third too low: slip is seen where there is none, but its limit, 0.23 m/s, bounds
 * the harm. */
static void grip_believed_too_low_does_bounded_harm(void) {
    const double plain_mm = remaining_after_impulse_mm(0, 6.0, 0.9);
    const double compensated_mm = remaining_after_impulse_mm(1, 6.0, 0.9);
    TEST_ASSERT_TRUE(compensated_mm > plain_mm && compensated_mm < 2.0 * plain_mm);
}

static void null_slip_shows_a_wheel_on_a_slippery_spot(void) {
    int largest = 0;
    static const i16 duty_q15[4] = {6000, 0, 0, 0};
    for (int n = 0; n < 100; n++) {
        control_loop_command_duty(&loop, duty_q15);
        reference_plant_tick(&plant, &loop);
        largest = abs(loop.telemetry.null_slip_m_s_q13) > largest
                      ? abs(loop.telemetry.null_slip_m_s_q13)
                      : largest;
    }
    TEST_ASSERT_TRUE(largest > 400); /* 50 mm/s */
}

/* ---- pose ---- */

static void go_to(const odometry_pose *goal, int ticks) {
    for (int n = 0; n < ticks; n++) {
        TEST_ASSERT_EQUAL(TRAJECTORY_OK, control_loop_command_pose(&loop, goal, &still));
        reference_plant_tick(&plant, &loop);
    }
}

static void pose_command_arrives_in_belief_and_in_truth(void) {
    const odometry_pose goal = {8192000, -4096000, 12867964}; /* 1 m, -0.5 m, 90 degrees */
    go_to(&goal, 6000);
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 1000.0, believed_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(0.5, -500.0, believed_y_mm());
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 1570.8, loop.telemetry.pose.theta_mrad_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(8.0, 1000.0, true_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(8.0, -500.0, true_y_mm());
    TEST_ASSERT_DOUBLE_WITHIN(0.01, REFERENCE_PI / 2.0, plant.state[PLANT_THETA]);
    TEST_ASSERT_TRUE(hypot(plant.state[PLANT_VX], plant.state[PLANT_VY]) < 0.002);
}

static void unreachable_pose_leaves_the_command_in_force(void) {
    const odometry_pose far = {(i32)I32_MAX, (i32)I32_MIN, 0};
    drive(500, 0, 0, 1000);
    TEST_ASSERT_EQUAL(TRAJECTORY_TOO_FAR, control_loop_command_pose(&loop, &far, &still));
    reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL(CONTROL_MODE_VELOCITY, loop.telemetry.mode);
}

static void change_of_command_does_not_jump(void) {
    const odometry_pose goal = {16384000, 4096000, 0};
    double slowest = 10.0;
    drive(1000, 0, 0, 1500);
    for (int n = 0; n < 300; n++) {
        go_to(&goal, 1);
        slowest = fmin(slowest, plant.state[PLANT_VX]);
    }
    /* 1.47 m/s2 for 0.3 s at most, and the traction of corrections */
    TEST_ASSERT_TRUE(slowest > 0.45);
}

/* A camera that sees the robot 200 mm beside its belief: the robot drives there, and the speed
 * that is demanded of it never changes faster than the grip limit allows. */
static void outside_pose_moves_the_robot_without_a_jump_of_the_speed(void) {
    double most_m_s2 = 0.0;
    drive(1000, 0, 0, 2000);
    for (int n = 0; n < 4000; n++) {
        const traction_change before = loop.demand;
        double dx, dy;
        if (n % 20 == 0) {
            const odometry_pose seen = {(i32)lround(true_x_mm() * 8192.0),
                                        (i32)lround((true_y_mm() + 200.0) * 8192.0), 0};
            TEST_ASSERT_TRUE(control_loop_outside_pose(&loop, &seen, 0));
        }
        drive(1000, 0, 0, 1);
        dx = loop.demand.axis_q22[0] - before.axis_q22[0];
        dy = loop.demand.axis_q22[1] - before.axis_q22[1];
        most_m_s2 = fmax(most_m_s2, hypot(dx, dy) / 4194.304);
    }
    TEST_ASSERT_TRUE(most_m_s2 < 1.05); /* 4 / s times 0.25 m/s; a jump would be the grip, 2 */
    TEST_ASSERT_DOUBLE_WITHIN(2.0, -200.0, true_y_mm());
    TEST_ASSERT_DOUBLE_WITHIN(2.0, 0.0, believed_y_mm());
}

/* A camera that says that a standing robot looks 100 mrad to the left of its belief: it turns back,
 * and stays where it is. */
static void heading_error_is_turned_back(void) {
    drive(0, 0, 0, 100);
    for (int n = 0; n < 200; n++) {
        const odometry_pose seen = {
            0, 0, (i32)lround((1000.0 * plant.state[PLANT_THETA] + 100.0) * 8192.0)};
        TEST_ASSERT_TRUE(control_loop_outside_pose(&loop, &seen, 0));
        drive(0, 0, 0, 20);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.001, -0.1, plant.state[PLANT_THETA]);
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 0.0, loop.telemetry.pose.theta_mrad_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 0.0, true_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 0.0, true_y_mm());
}

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
    plant.seen_angle_rad[1] = 31.0;
    control_loop_init(&loop, &p);
    supervisor_report(&loop, SUPERVISOR_FAULT_STORE);
    control_loop_tick(&loop);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_STORE, loop.telemetry.fault);
    TEST_ASSERT_EQUAL_INT16(0, loop.telemetry.shaft_rad_s_q5[1]);
    TEST_ASSERT_FALSE(control_loop_arm(&loop));
    TEST_ASSERT_TRUE(control_loop_clear_fault(&loop));
    TEST_ASSERT_TRUE(control_loop_arm(&loop));
    drive(500, 0, 0, 500);
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 0.5, plant.state[PLANT_VX]);
}

/* ---- what ends in zero duty ---- */

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
        drive(1000, 0, 0, 500);
        plant.supply_v = supplies_v[k];
        reference_plant_tick(&plant, &loop);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, largest_duty());
        TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_UNDER_VOLTAGE, loop.telemetry.fault);
    }
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
}

static void weak_supply_is_reported_as_the_limit(void) {
    plant.supply_v = 12.5; /* no-load rim speed 2 m/s, 4.1 m/s forward at most */
    parameters_set(&p, PARAMETER_ID_duty_limit_q15, 6000);
    drive(1500, 0, 0, 1500);
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_VOLTAGE, loop.telemetry.limit);
    TEST_ASSERT_TRUE(loop.telemetry.limit_wheel >= 1 && loop.telemetry.limit_wheel <= 4);
    TEST_ASSERT_TRUE(largest_duty() <= 6000.0 / 32768.0);
}

static void supply_voltage_does_not_change_the_motion(void) {
    double at_24_v;
    drive(800, 0, 0, 2000);
    at_24_v = true_x_mm();
    start(1);
    plant.supply_v = 16.0;
    drive(800, 0, 0, 2000);
    TEST_ASSERT_DOUBLE_WITHIN(4.0, at_24_v, true_x_mm());
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

static void a_supply_beyond_the_format_counts_as_its_end(void) {
    plant.supply_v = 65.0;
    drive(300, 0, 0, 500);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_NONE, loop.telemetry.fault);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.3, plant.state[PLANT_VX]);
}

/* A command that differs in any one of its numbers is another command. */
static void each_number_of_a_pose_command_counts(void) {
    const odometry_pose goal = {500L * 8192, 300L * 8192, 200L * 8192};
    const kinematics_velocity arrival = {100, 200, 300};
    for (int number = 0; number < 6; number++) {
        odometry_pose other = goal;
        kinematics_velocity other_arrival = arrival;
        trajectory before;
        start(1);
        control_loop_command_pose(&loop, &goal, &arrival);
        before = loop.target;
        control_loop_command_pose(&loop, &goal, &arrival);
        TEST_ASSERT_EQUAL_MEMORY(&before, &loop.target, sizeof before);
        *(number == 0   ? &other.x_mm_q13
          : number == 1 ? &other.y_mm_q13
                        : &other.theta_mrad_q13) += number < 3 ? 8192 : 0;
        *(number == 3   ? &other_arrival.x_m_s_q13
          : number == 4 ? &other_arrival.y_m_s_q13
                        : &other_arrival.omega_rad_s_q11) += (i16)(number < 3 ? 0 : 50);
        control_loop_command_pose(&loop, &other, &other_arrival);
        TEST_ASSERT_TRUE(memcmp(&before, &loop.target, sizeof before) != 0);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(step_of_speed_without_slip_compensation);
    RUN_TEST(step_of_speed_with_slip_compensation);
    RUN_TEST(feed_forward_alone_follows_the_ramp);
    RUN_TEST(rolling_odometry_misses_the_slip_of_the_start_and_the_observer_does_not);
    RUN_TEST(turning_robot_moves_along_its_own_axes);
    RUN_TEST(no_limit_cycle_at_standstill);
    RUN_TEST(no_limit_cycle_with_dry_friction);
    RUN_TEST(robot_that_never_moved_has_no_duty);
    RUN_TEST(impact_is_seen_and_corrected);
    RUN_TEST(correction_of_impacts_does_not_need_exact_grip);
    RUN_TEST(grip_believed_too_low_does_bounded_harm);
    RUN_TEST(null_slip_shows_a_wheel_on_a_slippery_spot);
    RUN_TEST(pose_command_arrives_in_belief_and_in_truth);
    RUN_TEST(unreachable_pose_leaves_the_command_in_force);
    RUN_TEST(change_of_command_does_not_jump);
    RUN_TEST(outside_pose_moves_the_robot_without_a_jump_of_the_speed);
    RUN_TEST(heading_error_is_turned_back);
    RUN_TEST(commands_need_arming);
    RUN_TEST(fault_at_boot_waits_to_be_cleared);
    RUN_TEST(command_that_is_not_repeated_dies_after_200_ms);
    RUN_TEST(stop_is_zero_duty_in_the_next_tick);
    RUN_TEST(low_supply_is_zero_duty_in_the_same_tick);
    RUN_TEST(duty_command_reaches_the_bridges_up_to_its_limit);
    RUN_TEST(weak_supply_is_reported_as_the_limit);
    RUN_TEST(supply_voltage_does_not_change_the_motion);
    RUN_TEST(garbage_from_outside_keeps_the_duty_within_its_limit);
    RUN_TEST(any_allowed_parameters_keep_the_duty_within_its_limit);
    RUN_TEST(a_bridge_that_protects_itself_is_told_with_its_first_wheel);
    RUN_TEST(rims_carry_slip_only_when_it_is_compensated);
    RUN_TEST(a_fault_of_a_wheel_is_told_with_its_number);
    RUN_TEST(a_supply_beyond_the_format_counts_as_its_end);
    RUN_TEST(each_number_of_a_pose_command_counts);
    return UNITY_END();
}
