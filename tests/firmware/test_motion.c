/* Odometry, traction limit and trajectory against closed forms. */
#include <stdlib.h>
#include <unity.h>

#include "firmware/odometry.h"
#include "firmware/traction.h"
#include "firmware/trajectory.h"
#include "tests/firmware/reference.h"

static parameters p;

static const odometry_pose origin = {0, 0, 0};
static const kinematics_velocity still = {0, 0, 0};

void setUp(void) {
    parameters_set_defaults(&p);
}

void tearDown(void) {}

/* ---- odometry ---- */

static void a_straight_run_is_exact(void) {
    odometry_pose pose = {0, 0, 0};
    const kinematics_velocity v = {12288, -8192, 0};
    for (int n = 0; n < 2000; n++)
        odometry_step(&pose, &v);
    /* 1.5 m/s and -1 m/s for 2 s; the cosine of 0 is one LSB short of 1 */
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 3000.0, pose.x_mm_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.5, -2000.0, pose.y_mm_q13 / 8192.0);
    TEST_ASSERT_EQUAL_INT32(0, pose.theta_mrad_q13);
}

/* 2 rad/s for pi/2 s at 1 m/s: half a circle of radius 0.5 m, to the left or to the right. */
static void half_a_circle_ends_beside_its_start(void) {
    for (int direction = -1; direction <= 1; direction += 2) {
        odometry_pose pose = {0, 0, 0};
        const kinematics_velocity v = {8192, 0, (i16)(direction * 4096)};
        for (int n = 0; n < 1571; n++)
            odometry_step(&pose, &v);
        /* 0.2 ms more than pi/2 s are 0.2 mm */
        TEST_ASSERT_DOUBLE_WITHIN(0.1, -0.2, pose.x_mm_q13 / 8192.0);
        TEST_ASSERT_DOUBLE_WITHIN(0.1, direction * 1000.0, pose.y_mm_q13 / 8192.0);
    }
}

static void theta_wraps_in_both_directions(void) {
    for (int direction = -1; direction <= 1; direction += 2) {
        odometry_pose pose = {0, 0, 0};
        const kinematics_velocity v = {0, 0, (i16)(direction * 4096)};
        for (int n = 0; n < 3000; n++)
            odometry_step(&pose, &v);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, direction * (6000.0 - 2000.0 * REFERENCE_PI),
                                  pose.theta_mrad_q13 / 8192.0);
    }
}

static void left_of_a_robot_that_looks_left_is_backward(void) {
    odometry_pose pose = {0, 0, ODOMETRY_FULL_TURN_MRAD_Q13 / 4};
    const kinematics_velocity v = {0, 8192, 0};
    odometry_step(&pose, &v);
    TEST_ASSERT_INT32_WITHIN(1, -8192, pose.x_mm_q13);
    TEST_ASSERT_INT32_WITHIN(4, 0, pose.y_mm_q13);
}

static void the_position_saturates_instead_of_wrapping(void) {
    odometry_pose pose = {(i32)I32_MAX - 100, 0, 0};
    const kinematics_velocity v = {8192, 0, 0};
    odometry_step(&pose, &v);
    TEST_ASSERT_EQUAL_INT32(I32_MAX, pose.x_mm_q13);
}

static void to_the_body_is_a_turn_by_the_negative_heading(void) {
    for (u32 angle = 0; angle < 65536; angle += 7) {
        i16 x = 20000, y = -9000, turned_x = x, turned_y = y;
        odometry_world_to_body(odometry_heading_of((u16)angle), &x, &y);
        odometry_rotate((u16)(65536 - angle), &turned_x, &turned_y);
        TEST_ASSERT_EQUAL_INT(turned_x, x);
        TEST_ASSERT_EQUAL_INT(turned_y, y);
    }
}

/* ---- traction ---- */

/* Newton for 20 kg and 0.55 kg m2: 2 m/s2 towards world x push a robot that looks left to its
 * right, towards world y forward; 10 rad/s2 turn it however it looks. */
static void inertia_is_mass_times_acceleration_in_the_body_frame(void) {
    const traction_change to_x = {{8389, 0, 41943}}, to_y = {{0, 8389, -41943}};
    kinematics_force force = traction_inertia_force(&p, odometry_heading_of(16384), &to_x);
    TEST_ASSERT_INT16_WITHIN(2, 0, force.x_n_q6);
    TEST_ASSERT_INT16_WITHIN(2, -40 * 64, force.y_n_q6);
    TEST_ASSERT_INT16_WITHIN(2, 1408, force.torque_n_m_q8); /* 5.5 N m */
    force = traction_inertia_force(&p, odometry_heading_of(16384), &to_y);
    TEST_ASSERT_INT16_WITHIN(2, 40 * 64, force.x_n_q6);
    TEST_ASSERT_INT16_WITHIN(2, 0, force.y_n_q6);
    TEST_ASSERT_INT16_WITHIN(2, -1408, force.torque_n_m_q8);
}

static void a_change_within_the_grip_passes_unchanged(void) {
    /* 2 m/s2 forward: 20 N per wheel, below the limit of 20.6 N */
    traction_change change = {{8389, 0, 0}};
    TEST_ASSERT_EQUAL_UINT(0, traction_limit(&p, odometry_heading_of(0), &change));
    TEST_ASSERT_EQUAL_INT32(8389, change.axis_q22[0]);
}

static void a_change_beyond_the_grip_keeps_its_direction(void) {
    for (u32 heading = 0; heading < 65536; heading += 999) {
        traction_change change = {{40000, -20000, 10000}};
        TEST_ASSERT_NOT_EQUAL_UINT(0,
                                   traction_limit(&p, odometry_heading_of((u16)heading), &change));
        TEST_ASSERT_INT32_WITHIN(2, -change.axis_q22[0] / 2, change.axis_q22[1]);
        TEST_ASSERT_INT32_WITHIN(2, change.axis_q22[0] / 4, change.axis_q22[2]);
        TEST_ASSERT_GREATER_THAN_INT32(1000, change.axis_q22[0]);
    }
}

static void the_limited_force_is_the_limit(void) {
    traction_change change = {{40000, -20000, 10000}};
    kinematics_force force;
    i16 wheel[4];
    int largest = 0;
    traction_limit(&p, odometry_heading_of(5000), &change);
    force = traction_inertia_force(&p, odometry_heading_of(5000), &change);
    traction_wheel_forces(&p, &force, wheel);
    for (int i = 0; i < 4; i++)
        largest = abs(wheel[i]) > largest ? abs(wheel[i]) : largest;
    /* one LSB of the acceleration is 1/1024 m/s2 * 10 kg = 2.5 LSB of the force */
    TEST_ASSERT_INT_WITHIN(8, PARAMETER_GET(&p, traction_limit_q8), largest);
}

/* Once its load is spread, that is: before, a wheel is loaded beyond the limit. */
static void a_change_that_takes_no_more_than_the_limit_passes(void) {
    const traction_change demand = {{20000, 20000, 60000}};
    traction_change change = demand;
    const kinematics_force force = traction_inertia_force(&p, odometry_heading_of(0), &demand);
    i16 wheel[4], largest = 0;
    traction_wheel_forces(&p, &force, wheel);
    for (int i = 0; i < 4; i++)
        largest = (i16)abs(wheel[i]) > largest ? (i16)abs(wheel[i]) : largest;
    for (i16 spare = 0; spare <= 1; spare++) {
        parameters_set(&p, PARAMETER_ID_traction_limit_q8, largest + spare);
        TEST_ASSERT_EQUAL_UINT(0, traction_limit(&p, odometry_heading_of(0), &change));
        TEST_ASSERT_EQUAL_MEMORY(&demand, &change, sizeof demand);
    }
    parameters_set(&p, PARAMETER_ID_traction_limit_q8, largest - 1);
    TEST_ASSERT_NOT_EQUAL_UINT(0, traction_limit(&p, odometry_heading_of(0), &change));
}

/* Beyond what the formats of force and acceleration hold, the limit holds all the same. */
static void no_demand_is_too_large_for_the_limit(void) {
    for (int axis = 0; axis < 3; axis++) {
        traction_change change = {{0, 0, 0}};
        kinematics_force force;
        i16 wheel[4];
        change.axis_q22[axis] = 20000000;
        TEST_ASSERT_NOT_EQUAL_UINT(0, traction_limit(&p, odometry_heading_of(0), &change));
        force = traction_inertia_force(&p, odometry_heading_of(0), &change);
        traction_wheel_forces(&p, &force, wheel);
        for (int i = 0; i < 4; i++)
            TEST_ASSERT_TRUE(abs(wheel[i]) <= PARAMETER_GET(&p, traction_limit_q8) + 8);
        TEST_ASSERT_GREATER_THAN_INT32(1000, change.axis_q22[axis]);
    }
}

/* ---- spreading the load ---- */

static double largest_of(const double force[4], const double null[4], double z) {
    double largest = 0.0;
    for (int i = 0; i < 4; i++)
        largest = fmax(largest, fabs(force[i] + z * null[i]));
    return largest;
}

/* The smallest largest force over all z, by ternary search of a convex function. */
static double best_largest(const double force[4], const double null[4]) {
    double low = -1000.0, high = 1000.0;
    for (int n = 0; n < 200; n++) {
        const double a = low + (high - low) / 3.0, b = high - (high - low) / 3.0;
        if (largest_of(force, null, a) < largest_of(force, null, b)) {
            high = b;
        } else {
            low = a;
        }
    }
    return largest_of(force, null, low);
}

/* Any force on the body: the wheels still give it, and no other choice loads the worst less. */
static void check_spread(int x_n_q6, int y_n_q6, int torque_q8) {
    const kinematics_force force = {(i16)x_n_q6, (i16)y_n_q6, (i16)torque_q8};
    kinematics_force given;
    i16 plain_q8[4], spread_q8[4];
    double plain_n[4], null[4], spread_n = 0.0;
    kinematics_wheel_forces(&p, &force, plain_q8);
    traction_wheel_forces(&p, &force, spread_q8);
    for (int i = 0; i < 4; i++) {
        plain_n[i] = plain_q8[i] / 256.0;
        null[i] = PARAMETER_WHEELS(&p, null_1_q13)[i] / 8192.0;
        spread_n = fmax(spread_n, fabs(spread_q8[i] / 256.0));
    }
    /* the pair is chosen in steps of 1/64 N, forces are rounded to 1/256 N */
    TEST_ASSERT_DOUBLE_WITHIN(2.0 / 64.0, best_largest(plain_n, null), spread_n);
    kinematics_body_force(&p, spread_q8, &given);
    TEST_ASSERT_INT_WITHIN(2, x_n_q6, given.x_n_q6); /* four forces of 1/512 N: 0.5 of Q6 */
    TEST_ASSERT_INT_WITHIN(2, y_n_q6, given.y_n_q6);
    TEST_ASSERT_INT_WITHIN(2, torque_q8, given.torque_n_m_q8);
}

static void check_spreads(uint64_t seed) {
    for (int n = 0; n < REFERENCE_CASES(5000); n++) {
        check_spread(reference_random_i16(&seed, 4000), reference_random_i16(&seed, 4000),
                     reference_random_i16(&seed, 3000));
    }
}

static void spread_is_the_best_there_is(void) {
    check_spreads(41);
}

/* A robot with its wheels at these angles, J+ and the null vector. */
static void set_wheels(const double angles_deg[4], const double forward[3][4],
                       const double null[4]) {
    for (int i = 0; i < 4; i++) {
        const double g = angles_deg[i] * REFERENCE_PI / 180.0;
        p.value[PARAMETER_ID_drive_x_1_q15 + i] = (i16)lround(-sin(g) * 32767.0);
        p.value[PARAMETER_ID_drive_y_1_q15 + i] = (i16)lround(cos(g) * 32767.0);
        p.value[PARAMETER_ID_forward_x_1_q13 + i] = (i16)lround(forward[0][i] * 8192.0);
        p.value[PARAMETER_ID_forward_y_1_q13 + i] = (i16)lround(forward[1][i] * 8192.0);
        p.value[PARAMETER_ID_forward_omega_1_q13 + i] = (i16)lround(forward[2][i] * 8192.0);
        p.value[PARAMETER_ID_null_1_q13 + i] = (i16)lround(null[i] * 8192.0);
    }
}

/* Wheels at 20, 120, 215 and 320 degrees: the null vector has four different entries. */
static void spread_is_the_best_for_uneven_wheels_too(void) {
    static const double angles_deg[4] = {20.0, 120.0, 215.0, 320.0};
    static const double forward[3][4] = {{-0.244682, -0.520923, 0.389240, 0.376364},
                                         {0.372077, -0.223994, -0.411181, 0.263099},
                                         {1.072745, 1.363658, 1.444648, 1.118949}};
    static const double null[4] = {1.186806, -0.810282, 0.777152, -1.153677};
    set_wheels(angles_deg, forward, null);
    check_spreads(43);
}

/* Three directions, one of them with two wheels: only these can share a load. */
static void spread_leaves_wheels_alone_that_have_no_partner(void) {
    static const double angles_deg[4] = {60.0, 60.0, 180.0, 300.0};
    static const double forward[3][4] = {{-0.288675, -0.288675, 0.0, 0.577350},
                                         {0.166667, 0.166667, -0.666667, 0.333333},
                                         {0.833283, 0.833283, 1.666565, 1.666565}};
    static const double null[4] = {1.414214, -1.414214, 0.0, 0.0};
    set_wheels(angles_deg, forward, null);
    check_spreads(53);
}

static void x_y_and_rotation_at_once_spare_the_worst_wheel_a_third(void) {
    /* 40 N, 40 sqrt 3 N and 16 N m: 20 N of each on wheel 4 */
    const kinematics_force force = {40 * 64, 4434, 16 * 256};
    i16 plain_q8[4], spread_q8[4];
    kinematics_wheel_forces(&p, &force, plain_q8);
    traction_wheel_forces(&p, &force, spread_q8);
    TEST_ASSERT_INT_WITHIN(8, 60 * 256, plain_q8[3]);
    TEST_ASSERT_INT_WITHIN(8, 40 * 256, spread_q8[3]);
}

static void the_limit_names_the_wheel(void) {
    traction_change forward_left_turn = {{20000, 20000, 60000}};
    TEST_ASSERT_EQUAL_UINT(4, traction_limit(&p, odometry_heading_of(0), &forward_left_turn));
}

/* ---- trajectory ---- */

typedef struct {
    double speed_m_s, acceleration_m_s2, omega_rad_s, force_n;
    int ticks;
} extremes;

/* Largest force of a wheel that this change of one tick takes, with the heading of the target. */
static double wheel_force_n(const trajectory *t, const traction_change *before) {
    traction_change change;
    kinematics_force force;
    i16 wheel_q8[4];
    double largest_n = 0.0;
    for (int axis = 0; axis < 3; axis++)
        change.axis_q22[axis] = t->velocity.axis_q22[axis] - before->axis_q22[axis];
    force = traction_inertia_force(
        &p, odometry_heading_of(odometry_binary_angle(t->position_q13[2])), &change);
    kinematics_wheel_forces(&p, &force, wheel_q8);
    for (int i = 0; i < 4; i++)
        largest_n = fmax(largest_n, abs(wheel_q8[i]) / 256.0);
    return largest_n;
}

static extremes run_to_arrival(trajectory *t) {
    extremes most = {0.0, 0.0, 0.0, 0.0, 0};
    while (t->ticks_left > 0) {
        const traction_change before = t->velocity;
        double dx, dy;
        trajectory_step_to_pose(t, &p);
        dx = t->velocity.axis_q22[0] - before.axis_q22[0];
        dy = t->velocity.axis_q22[1] - before.axis_q22[1];
        most.acceleration_m_s2 = fmax(most.acceleration_m_s2, hypot(dx, dy) / 4194.304);
        most.speed_m_s = fmax(most.speed_m_s,
                              hypot(t->velocity.axis_q22[0], t->velocity.axis_q22[1]) / 4194304.0);
        most.omega_rad_s = fmax(most.omega_rad_s, fabs(t->velocity.axis_q22[2] / 4194304.0));
        most.force_n = fmax(most.force_n, wheel_force_n(t, &before));
        most.ticks++;
    }
    return most;
}

static void arrival_is_exact_with_the_velocity_asked_for(void) {
    const odometry_pose goal = {12345678, -7654321, 10000000};
    const kinematics_velocity arrival = {4000, 2000, -1000};
    trajectory t;
    trajectory_start(&t, &origin, &still);
    TEST_ASSERT_EQUAL(TRAJECTORY_OK, trajectory_plan(&t, &p, &goal, &arrival));
    run_to_arrival(&t);
    TEST_ASSERT_EQUAL_INT32(goal.x_mm_q13, t.position_q13[0]);
    TEST_ASSERT_EQUAL_INT32(goal.y_mm_q13, t.position_q13[1]);
    TEST_ASSERT_EQUAL_INT32(goal.theta_mrad_q13, t.position_q13[2]);
    TEST_ASSERT_EQUAL_INT32(4000L * 512, t.velocity.axis_q22[0]);
    TEST_ASSERT_EQUAL_INT32(-1000L * 2048, t.velocity.axis_q22[2]);
}

static void short_move_takes_the_time_of_the_acceleration_limit(void) {
    /* cubic from rest to rest: a = 6 D / T^2, so 0.5 m at 1.4717 m/s2 take 1.4278 s */
    const odometry_pose goal = {4096000, 0, 0};
    trajectory t;
    extremes most;
    trajectory_start(&t, &origin, &still);
    trajectory_plan(&t, &p, &goal, &still);
    most = run_to_arrival(&t);
    TEST_ASSERT_INT_WITHIN(25, 1428 + 13, most.ticks);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 1.45, most.acceleration_m_s2);
}

/* At a quarter of the time 3/16 - 2/64 = 10/64 of the way is done, at half of it half. Changes of
 * speed are cut off by up to one unit, 2^-22 mm per tick, which n ticks can add up to n^2 / 2^23
 * mm: 27 um at a quarter. */
static void the_way_is_on_the_cubic(void) {
    const odometry_pose goal = {8192000, -4096000, 0};
    trajectory t;
    int ticks;
    trajectory_start(&t, &origin, &still);
    trajectory_plan(&t, &p, &goal, &still);
    ticks = t.ticks_left;
    t.ticks_left = (u16)(ticks -= ticks % 4);
    for (int n = 0; n < ticks / 4; n++)
        trajectory_step_to_pose(&t, &p);
    TEST_ASSERT_INT32_WITHIN(220, 1280000, t.position_q13[0]);
    TEST_ASSERT_INT32_WITHIN(220, -640000, t.position_q13[1]);
    for (int n = 0; n < ticks / 4; n++)
        trajectory_step_to_pose(&t, &p);
    TEST_ASSERT_INT32_WITHIN(880, 4096000, t.position_q13[0]);
}

static void long_move_takes_the_time_of_the_speed_limit(void) {
    /* the largest speed of a cubic from rest to rest is 1.5 D / T: 15 m at 2.353 m/s take 9.56 s */
    const odometry_pose goal = {122880000, 0, 0};
    trajectory t;
    extremes most;
    trajectory_start(&t, &origin, &still);
    trajectory_plan(&t, &p, &goal, &still);
    most = run_to_arrival(&t);
    TEST_ASSERT_INT_WITHIN(150, 9563 + 75, most.ticks);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 2.33, most.speed_m_s);
}

/* The same for rotation: 3 rad at 1 rad/s take 4.5 s. */
static void long_turn_takes_the_time_of_the_speed_limit(void) {
    const odometry_pose goal = {0, 0, 3000L * 8192};
    trajectory t;
    extremes most;
    parameters_set(&p, PARAMETER_ID_omega_limit_q11, 2048);
    trajectory_start(&t, &origin, &still);
    trajectory_plan(&t, &p, &goal, &still);
    most = run_to_arrival(&t);
    TEST_ASSERT_INT_WITHIN(35, 4500 + 35, most.ticks); /* 1/64 */
    TEST_ASSERT_TRUE(most.omega_rad_s < 1.001);
}

/* The plan to begin with, as trajectory.h derives it: the longer of
 *     (|v1 - v0| + 6 |s|) / a + sqrt(6 |D| / a)   and   3 |D| / (2 v_limit - max |v|),
 * in s, for moves whose time at the mean speed, D s / s^2, is none. */
static void check_first_plan(double plan_s, const odometry_pose *goal,
                             const kinematics_velocity *v0, const kinematics_velocity *v1) {
    trajectory t;
    trajectory_start(&t, &origin, v0);
    TEST_ASSERT_EQUAL(TRAJECTORY_OK, trajectory_plan(&t, &p, goal, v1));
    TEST_ASSERT_DOUBLE_WITHIN(10.0, 1000.0 * plan_s, t.ticks_left);
}

static void the_first_plan_surely_fits(void) {
    const double a = 1507.0 / 1024.0, alpha = 5479.0 / 256.0;
    /* from (1, 0) to (0, -0.5) m/s over (-2, 2) m: |v1 - v0| = sqrt 1.25, |s| half of it */
    const odometry_pose corner = {-2000L * 8192, 2000L * 8192, 0};
    const kinematics_velocity forward = {8192, 0, 0}, right = {0, -4096, 0};
    /* away from the goal at 2 m/s, which is 20 m behind */
    const odometry_pose behind = {-20000L * 8192, 0, 0};
    const kinematics_velocity away = {16384, 0, 0};
    /* from 3 to -2 rad/s over 1.5 rad */
    const odometry_pose turned = {0, 0, 1500L * 8192};
    const kinematics_velocity turning = {0, 0, 6144}, turning_back = {0, 0, -4096};
    check_first_plan(4.0 * sqrt(1.25) / a + sqrt(6.0 * sqrt(8.0) / a), &corner, &forward, &right);
    check_first_plan(3.0 * 20.0 / (2.0 * 19275.0 / 8192.0 - 2.0), &behind, &away, &still);
    check_first_plan(8.0 / alpha + sqrt(6.0 * 1.5 / alpha), &turned, &turning, &turning_back);
}

/* 2 m/s when the limit is lowered to 0.5 m/s: the limit itself takes the place of
 * 2 v_limit - max |v|, which would be negative. */
static void a_limit_below_the_present_speed_gives_the_first_plan_its_time(void) {
    const odometry_pose behind = {-5000L * 8192, 0, 0};
    const kinematics_velocity away = {16384, 0, 0};
    parameters_set(&p, PARAMETER_ID_speed_limit_q13, 4096);
    check_first_plan(3.0 * 5.0 / 0.5, &behind, &away, &still);
}

/* The least that turns already, 0.5 to 4 mrad/s, must not cost time: as from rest, 1.43 s. */
static void a_robot_that_hardly_turns_moves_as_fast_as_one_that_does_not(void) {
    const odometry_pose goal = {4096000, 0, 0};
    for (i16 omega = -8; omega <= 8; omega++) {
        const kinematics_velocity v = {0, 0, omega};
        trajectory t;
        trajectory_start(&t, &origin, &v);
        trajectory_plan(&t, &p, &goal, &still);
        TEST_ASSERT_INT_WITHIN(25, 1428 + 13, run_to_arrival(&t).ticks);
    }
}

/* The time at the mean speed where that fits, of a robot that turns on the spot: 0.5 rad from 6 to
 * 4 rad/s take 0.1 s. The one that surely fits would be 1.9 s. */
static void the_first_plan_of_a_turn_is_the_time_at_the_mean_speed(void) {
    const odometry_pose goal = {0, 0, 500L * 8192};
    const kinematics_velocity v0 = {0, 0, 12288}, v1 = {0, 0, 8192};
    trajectory t;
    trajectory_start(&t, &origin, &v0);
    TEST_ASSERT_EQUAL(TRAJECTORY_OK, trajectory_plan(&t, &p, &goal, &v1));
    TEST_ASSERT_INT_WITHIN(1, 100, t.ticks_left);
}

static odometry_pose random_pose(uint64_t *seed) {
    odometry_pose pose;
    pose.x_mm_q13 = (i32)reference_random(seed) / 100;
    pose.y_mm_q13 = (i32)reference_random(seed) / 100;
    pose.theta_mrad_q13 = (i32)reference_random(seed) / 10;
    return pose;
}

static kinematics_velocity random_velocity(uint64_t *seed) {
    kinematics_velocity v;
    v.x_m_s_q13 = reference_random_i16(seed, 12000);
    v.y_m_s_q13 = reference_random_i16(seed, 12000);
    v.omega_rad_s_q11 = reference_random_i16(seed, 16000);
    return v;
}

/* Closed form for a move from rest to rest: with u = D / T the speed is 1.5 u, the acceleration
 * 6 D / T^2, and the shares of the grip of both add up. */
static double smallest_ticks(double distance_m, double turn_rad) {
    const double grip_n = 5274.0 / 256.0;
    const double grip_m_s2 = grip_n / 20.0 / sqrt(0.25 + 1.0 / 12.0);
    const double grip_rad_s2 = grip_n / 0.55 / 1.25;
    double smallest_s = 1.5 * distance_m / (19275.0 / 8192.0);
    smallest_s = fmax(smallest_s, 1.5 * turn_rad / 10.0);
    smallest_s = fmax(smallest_s, sqrt(6.0 * distance_m / (1507.0 / 1024.0)));
    smallest_s = fmax(smallest_s, sqrt(6.0 * turn_rad / (5479.0 / 256.0)));
    return 1000.0 * fmax(smallest_s, sqrt(6.0 * (distance_m / grip_m_s2 + turn_rad / grip_rad_s2)));
}

/* The bisection leaves 1/64; until it ends, 16 ticks are driven on a longer plan. */
static void moves_from_rest_take_the_time_that_their_limits_need(void) {
    uint64_t seed = 47;
    for (int n = 0; n < REFERENCE_CASES(500); n++) {
        const int reach_mm = n % 2 ? 300 : 6000;
        const odometry_pose goal = {reference_random_i16(&seed, (i16)reach_mm) * 8192L,
                                    reference_random_i16(&seed, (i16)reach_mm) * 8192L,
                                    reference_random_i16(&seed, 3100) * 8192L * (n % 3 > 0)};
        const double needed = smallest_ticks(hypot(goal.x_mm_q13, goal.y_mm_q13) / 8192e3,
                                             labs(goal.theta_mrad_q13) / 8192e3);
        trajectory t;
        int ticks;
        trajectory_start(&t, &origin, &still);
        TEST_ASSERT_EQUAL(TRAJECTORY_OK, trajectory_plan(&t, &p, &goal, &still));
        ticks = run_to_arrival(&t).ticks;
        TEST_ASSERT_TRUE(ticks > 0.99 * needed - 1.0);
        TEST_ASSERT_TRUE(ticks < needed * (1.0 + 1.0 / 64.0) + 16.0);
    }
}

/* At the speed of arrival already, the way takes its natural time or less, not that of stopping and
 * starting again: the surely sufficient time is 5 s. */
static void a_goal_on_the_way_takes_the_time_of_the_way(void) {
    const odometry_pose goal = {8192000, 4096000, 0};
    const kinematics_velocity v = {8192, 4096, 0};
    trajectory t;
    trajectory_start(&t, &origin, &v);
    trajectory_plan(&t, &p, &goal, &v);
    TEST_ASSERT_LESS_OR_EQUAL_INT(1000, run_to_arrival(&t).ticks);
}

/* From any motion to any goal, retargeted half-way: limits hold, the target never jumps, arrival is
 * exact. */
static void limits_hold_when_the_goal_changes_in_flight(void) {
    uint64_t seed = 11;
    for (int n = 0; n < REFERENCE_CASES(300); n++) {
        const odometry_pose first = random_pose(&seed), second = random_pose(&seed);
        const kinematics_velocity v1 = random_velocity(&seed), v2 = random_velocity(&seed);
        trajectory t;
        extremes most;
        traction_change before;
        trajectory_start(&t, &origin, &still);
        TEST_ASSERT_EQUAL(TRAJECTORY_OK, trajectory_plan(&t, &p, &first, &v1));
        for (int k = t.ticks_left / 2; k > 0; k--)
            trajectory_step_to_pose(&t, &p);
        before = t.velocity;
        TEST_ASSERT_EQUAL(TRAJECTORY_OK, trajectory_plan(&t, &p, &second, &v2));
        TEST_ASSERT_EQUAL_MEMORY(&before, &t.velocity, sizeof before);
        most = run_to_arrival(&t);
        TEST_ASSERT_EQUAL_INT32(second.x_mm_q13, t.position_q13[0]);
        TEST_ASSERT_TRUE(most.speed_m_s < 2.353 * 1.001);
        TEST_ASSERT_TRUE(most.omega_rad_s < 10.0 * 1.001);
        TEST_ASSERT_TRUE(most.acceleration_m_s2 < 1.4717 * 1.02);
        TEST_ASSERT_TRUE(most.force_n < 20.6 * 1.02);
    }
}

static void theta_goes_the_shorter_way_round(void) {
    const odometry_pose here = {0, 0, 25000000}, goal = {0, 0, -25000000};
    trajectory t;
    trajectory_start(&t, &here, &still);
    trajectory_plan(&t, &p, &goal, &still);
    trajectory_step_to_pose(&t, &p);
    for (int n = 0; n < 50; n++)
        trajectory_step_to_pose(&t, &p);
    TEST_ASSERT_GREATER_THAN_INT32(0, t.velocity.axis_q22[2]);
}

static void a_goal_beyond_60_s_is_refused_and_the_plan_kept(void) {
    const odometry_pose near = {819200, 0, 0}, far = {(i32)I32_MAX, (i32)I32_MIN, 0};
    trajectory t, before;
    trajectory_start(&t, &origin, &still);
    trajectory_plan(&t, &p, &near, &still);
    before = t;
    TEST_ASSERT_EQUAL(TRAJECTORY_TOO_FAR, trajectory_plan(&t, &p, &far, &still));
    TEST_ASSERT_EQUAL_MEMORY(&before, &t, sizeof t);
}

static u16 limited_wheel;

static control_limit step_velocity(trajectory *t, const kinematics_velocity *command) {
    return trajectory_step_velocity(t, &p, command, &limited_wheel);
}

static void velocity_ramps_along_the_commanded_direction(void) {
    const kinematics_velocity command = {8192, -4096, 0};
    trajectory t;
    trajectory_start(&t, &origin, &still);
    for (int n = 0; n < 300; n++) {
        TEST_ASSERT_EQUAL(CONTROL_LIMIT_ACCELERATION, step_velocity(&t, &command));
        TEST_ASSERT_EQUAL_UINT16(0, limited_wheel);
    }
    /* 1.4717 m/s2 for 0.3 s along (2, -1) / sqrt 5 */
    TEST_ASSERT_DOUBLE_WITHIN(0.002, 0.3949, t.velocity.axis_q22[0] / 4194304.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.002, -0.1974, t.velocity.axis_q22[1] / 4194304.0);
    for (int n = 0; n < 600; n++)
        step_velocity(&t, &command);
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_NONE, step_velocity(&t, &command));
    /* The command passes a rotation by 0, whose cosine is one LSB short of 1. */
    TEST_ASSERT_INT32_WITHIN(512, 8192L * 512, t.velocity.axis_q22[0]);
    TEST_ASSERT_INT32_WITHIN(512, -4096L * 512, t.velocity.axis_q22[1]);
}

static void a_velocity_ends_the_plan(void) {
    const odometry_pose goal = {8192000, 0, 0};
    const kinematics_velocity command = {0, 4096, 0};
    traction_change before;
    trajectory t;
    trajectory_start(&t, &origin, &still);
    trajectory_plan(&t, &p, &goal, &still);
    for (int n = 0; n < 200; n++)
        trajectory_step_to_pose(&t, &p);
    step_velocity(&t, &command);
    before = t.velocity;
    trajectory_step_to_pose(&t, &p); /* nothing is planned: onwards */
    TEST_ASSERT_EQUAL_MEMORY(&before, &t.velocity, sizeof before);
}

static void velocity_commands_are_limited_along_their_direction(void) {
    const kinematics_velocity command = {32767, -32767, 0};
    trajectory t;
    trajectory_start(&t, &origin, &still);
    for (int n = 0; n < 4000; n++)
        step_velocity(&t, &command);
    TEST_ASSERT_EQUAL(CONTROL_LIMIT_SPEED, step_velocity(&t, &command));
    TEST_ASSERT_DOUBLE_WITHIN(0.002, 2.3529 / sqrt(2.0), t.velocity.axis_q22[0] / 4194304.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.002, -2.3529 / sqrt(2.0), t.velocity.axis_q22[1] / 4194304.0);
}

/* Either sense; a change of the rotation alone is cut by its own limit. */
static void limits_of_rotation_have_names_too(void) {
    static const i16 commands_q11[] = {-30000, 30000};
    static const i32 limits_q22[] = {-20480L * 2048, 20480L * 2048};
    for (int sense = 0; sense < 2; sense++) {
        const kinematics_velocity fast = {0, 0, commands_q11[sense]};
        trajectory t;
        parameters_set(&p, PARAMETER_ID_angular_acceleration_limit_q8, 2560);
        trajectory_start(&t, &origin, &still);
        TEST_ASSERT_EQUAL(CONTROL_LIMIT_ACCELERATION, step_velocity(&t, &fast));
        for (int n = 0; n < 2000; n++)
            step_velocity(&t, &fast);
        TEST_ASSERT_EQUAL(CONTROL_LIMIT_SPEED, step_velocity(&t, &fast));
        TEST_ASSERT_INT32_WITHIN(2048, limits_q22[sense], t.velocity.axis_q22[2]);
    }
}

static void a_ramp_beyond_the_grip_is_cut_and_says_so(void) {
    const kinematics_velocity command = {12288, 0, 0};
    trajectory t;
    parameters_set(&p, PARAMETER_ID_acceleration_limit_q10, 8000);
    trajectory_start(&t, &origin, &still);
    for (int n = 0; n < 100; n++) {
        TEST_ASSERT_EQUAL(CONTROL_LIMIT_TRACTION, step_velocity(&t, &command));
        TEST_ASSERT_EQUAL_UINT16(1, limited_wheel);
    }
    /* 20.6 N per wheel push 20 kg with 2.06 m/s2 */
    TEST_ASSERT_DOUBLE_WITHIN(0.003, 0.206, t.velocity.axis_q22[0] / 4194304.0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_straight_run_is_exact);
    RUN_TEST(half_a_circle_ends_beside_its_start);
    RUN_TEST(theta_wraps_in_both_directions);
    RUN_TEST(left_of_a_robot_that_looks_left_is_backward);
    RUN_TEST(the_position_saturates_instead_of_wrapping);
    RUN_TEST(to_the_body_is_a_turn_by_the_negative_heading);
    RUN_TEST(inertia_is_mass_times_acceleration_in_the_body_frame);
    RUN_TEST(a_change_within_the_grip_passes_unchanged);
    RUN_TEST(a_change_beyond_the_grip_keeps_its_direction);
    RUN_TEST(a_change_that_takes_no_more_than_the_limit_passes);
    RUN_TEST(no_demand_is_too_large_for_the_limit);
    RUN_TEST(the_limited_force_is_the_limit);
    RUN_TEST(spread_is_the_best_there_is);
    RUN_TEST(spread_is_the_best_for_uneven_wheels_too);
    RUN_TEST(spread_leaves_wheels_alone_that_have_no_partner);
    RUN_TEST(x_y_and_rotation_at_once_spare_the_worst_wheel_a_third);
    RUN_TEST(the_limit_names_the_wheel);
    RUN_TEST(arrival_is_exact_with_the_velocity_asked_for);
    RUN_TEST(short_move_takes_the_time_of_the_acceleration_limit);
    RUN_TEST(the_way_is_on_the_cubic);
    RUN_TEST(long_move_takes_the_time_of_the_speed_limit);
    RUN_TEST(long_turn_takes_the_time_of_the_speed_limit);
    RUN_TEST(the_first_plan_surely_fits);
    RUN_TEST(a_limit_below_the_present_speed_gives_the_first_plan_its_time);
    RUN_TEST(a_robot_that_hardly_turns_moves_as_fast_as_one_that_does_not);
    RUN_TEST(the_first_plan_of_a_turn_is_the_time_at_the_mean_speed);
    RUN_TEST(moves_from_rest_take_the_time_that_their_limits_need);
    RUN_TEST(a_goal_on_the_way_takes_the_time_of_the_way);
    RUN_TEST(limits_hold_when_the_goal_changes_in_flight);
    RUN_TEST(theta_goes_the_shorter_way_round);
    RUN_TEST(a_goal_beyond_60_s_is_refused_and_the_plan_kept);
    RUN_TEST(velocity_ramps_along_the_commanded_direction);
    RUN_TEST(a_velocity_ends_the_plan);
    RUN_TEST(velocity_commands_are_limited_along_their_direction);
    RUN_TEST(limits_of_rotation_have_names_too);
    RUN_TEST(a_ramp_beyond_the_grip_is_cut_and_says_so);
    return UNITY_END();
}
