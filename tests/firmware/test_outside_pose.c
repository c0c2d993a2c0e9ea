/* Late poses from outside against the closed form of the motion they belong to. */
#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "firmware/outside_pose.h"
#include "tests/firmware/reference.h"

/* A robot on a circle: truth in double, belief with an error from the start and, optionally, a
 * drift. */
typedef struct {
    double x_mm, y_mm, theta_mrad;
} place;

static parameters p;
static outside_pose outside;
static odometry_pose pose;
static int now_ms;

static const double radius_mm = 800.0, turn_mrad_ms = 1.5; /* 1.2 m/s */

static place truth_at(int time_ms) {
    const double turned_rad = turn_mrad_ms * time_ms / 1000.0;
    const place there = {radius_mm * sin(turned_rad), radius_mm * (1.0 - cos(turned_rad)),
                         1000.0 * turned_rad};
    return there;
}

static odometry_pose to_pose(place there) {
    odometry_pose result;
    result.x_mm_q13 = (i32)lround(there.x_mm * 8192.0);
    result.y_mm_q13 = (i32)lround(there.y_mm * 8192.0);
    result.theta_mrad_q13 =
        (i32)lround(1000.0 * reference_wrap_rad(there.theta_mrad / 1000.0) * 8192.0);
    return result;
}

/* The belief starts displaced and turned. */
static void start(double x_mm, double y_mm, double theta_mrad) {
    const place there = {x_mm, y_mm, theta_mrad};
    parameters_set_defaults(&p);
    pose = to_pose(there);
    outside_pose_reset(&outside, &pose);
    now_ms = 0;
}

void setUp(void) {
    start(0.0, 0.0, 0.0);
}

void tearDown(void) {}

/* One tick of odometry that sees the true velocity times `scale`. */
static void tick(double scale) {
    kinematics_velocity body = {0, 0, 0};
    body.x_m_s_q13 = (i16)lround(scale * radius_mm * turn_mrad_ms / 1000.0 * 8192.0);
    body.omega_rad_s_q11 = (i16)lround(turn_mrad_ms * 2048.0);
    odometry_step(&pose, &body);
    outside_pose_step(&outside, &pose);
    now_ms++;
}

static double distance_mm(void) {
    const place there = truth_at(now_ms);
    return hypot(pose.x_mm_q13 / 8192.0 - there.x_mm, pose.y_mm_q13 / 8192.0 - there.y_mm);
}

static double turn_mrad(void) {
    const double error_rad = pose.theta_mrad_q13 / 8192000.0 - truth_at(now_ms).theta_mrad / 1000.0;
    return 1000.0 * fabs(reference_wrap_rad(error_rad));
}

/* Drives with a camera of this period and delay; what it says about its delay may be wrong. */
static void drive(int ticks, int period_ms, int delay_ms, int said_ms, double scale) {
    for (int n = 0; n < ticks; n++) {
        tick(scale);
        if (now_ms % period_ms == 0 && now_ms >= delay_ms) {
            const odometry_pose seen = to_pose(truth_at(now_ms - delay_ms));
            TEST_ASSERT_TRUE(outside_pose_take(&outside, &p, &pose, &seen, (i16)said_ms, 1));
        }
    }
}

static void any_known_delay_is_undone(void) {
    for (int delay_ms = 0; delay_ms <= OUTSIDE_POSE_LONGEST_AGE_MS; delay_ms += 15) {
        start(60.0, -40.0, 150.0);
        drive(3000, delay_ms % 2 ? 17 : 33, delay_ms, delay_ms, 1.0);
        /* interpolation 0.1 mm, 32 um for the motion since, velocities rounded to 0.06 mm/s */
        TEST_ASSERT_TRUE(distance_mm() < 0.5);
        TEST_ASSERT_TRUE(turn_mrad() < 0.3);
    }
}

/* The test above would see a delay that is off by 2 ms: the robot drives 1.2 mm/ms. */
static void a_wrong_delay_shows_as_the_way_driven_in_it(void) {
    drive(3000, 20, 100, 90, 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 12.0, distance_mm());
}

static void drift_is_held_at_what_grows_until_it_is_corrected(void) {
    double before_mm;
    drive(2000, 2001, 0, 0, 1.03); /* no camera */
    before_mm = distance_mm();
    TEST_ASSERT_TRUE(before_mm > 20.0);
    start(0.0, 0.0, 0.0);
    drive(4000, 20, 80, 80, 1.03);
    /* 36 mm/s of drift, seen 80 ms late and given within about 64 + 80 ms */
    TEST_ASSERT_TRUE(distance_mm() < 36.0 * 0.3);
    TEST_ASSERT_TRUE(distance_mm() > 36.0 * 0.08);
}

static void a_correction_is_given_in_small_steps(void) {
    odometry_pose seen = {8192L * 300, -8192L * 300, 8192L * 500};
    int ticks = 0;
    TEST_ASSERT_TRUE(outside_pose_take(&outside, &p, &pose, &seen, 0, 1));
    for (odometry_pose before = pose; ticks < 2000; ticks++, before = pose) {
        outside_pose_step(&outside, &pose);
        TEST_ASSERT_INT32_WITHIN(2048, before.x_mm_q13, pose.x_mm_q13);
        TEST_ASSERT_INT32_WITHIN(2048, before.y_mm_q13, pose.y_mm_q13);
        TEST_ASSERT_INT32_WITHIN(4096, before.theta_mrad_q13, pose.theta_mrad_q13);
    }
    /* the share outside_pose_gain of it, less what 1/64 rounds to nothing */
    TEST_ASSERT_INT32_WITHIN(32, 8192L * 75, pose.x_mm_q13);
    TEST_ASSERT_INT32_WITHIN(32, -8192L * 75, pose.y_mm_q13);
    TEST_ASSERT_INT32_WITHIN(32, 8192L * 125, pose.theta_mrad_q13);
}

static void a_robot_that_does_not_drive_takes_the_pose_as_it_is(void) {
    const place there = {2000.0, -3000.0, -2500.0};
    const odometry_pose seen = to_pose(there);
    TEST_ASSERT_TRUE(outside_pose_take(&outside, &p, &pose, &seen, 50, 0));
    TEST_ASSERT_EQUAL_MEMORY(&seen, &pose, sizeof pose);
    /* and again: the history has moved with it */
    TEST_ASSERT_TRUE(outside_pose_take(&outside, &p, &pose, &seen, 50, 0));
    TEST_ASSERT_EQUAL_MEMORY(&seen, &pose, sizeof pose);
}

/* 100 ms at (1, 0.5) m/s, then a pose seen at their start that is turned by a quarter: the way
 * since then is turned with it. */
static void the_way_since_then_turns_with_the_heading(void) {
    const kinematics_velocity body = {8192, 4096, 0};
    const odometry_pose seen = {0, 0, ODOMETRY_FULL_TURN_MRAD_Q13 / 4};
    for (int n = 0; n < 100; n++) {
        odometry_step(&pose, &body);
        outside_pose_step(&outside, &pose);
    }
    TEST_ASSERT_TRUE(outside_pose_take(&outside, &p, &pose, &seen, 100, 0));
    TEST_ASSERT_DOUBLE_WITHIN(0.1, -50.0, pose.x_mm_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 100.0, pose.y_mm_q13 / 8192.0);
    TEST_ASSERT_INT32_WITHIN(1, ODOMETRY_FULL_TURN_MRAD_Q13 / 4, pose.theta_mrad_q13);
}

/* 10 ms at 1 m/s from the reset: 5 ms ago the robot was at 5 mm, and a camera that saw it there has
 * no news. */
static void the_past_begins_with_the_reset(void) {
    const kinematics_velocity body = {8192, 0, 0};
    const odometry_pose seen = {5L * 8192, 0, 0};
    for (int n = 0; n < 10; n++) {
        odometry_step(&pose, &body);
        outside_pose_step(&outside, &pose);
    }
    TEST_ASSERT_TRUE(outside_pose_take(&outside, &p, &pose, &seen, 5, 0));
    TEST_ASSERT_INT32_WITHIN(8, 10L * 8192, pose.x_mm_q13); /* 1 um */
}

static void poses_of_unknown_age_are_refused(void) {
    const odometry_pose seen = {1000, 1000, 1000}, before = pose;
    const outside_pose state = outside;
    TEST_ASSERT_FALSE(outside_pose_take(&outside, &p, &pose, &seen, -1, 0));
    TEST_ASSERT_FALSE(outside_pose_take(&outside, &p, &pose, &seen, 241, 0));
    TEST_ASSERT_FALSE(outside_pose_take(&outside, &p, &pose, &seen, I16_MAX, 1));
    parameters_set(&p, PARAMETER_ID_outside_pose_gain_q15, 0);
    TEST_ASSERT_FALSE(outside_pose_take(&outside, &p, &pose, &seen, 10, 0));
    TEST_ASSERT_EQUAL_MEMORY(&before, &pose, sizeof pose);
    TEST_ASSERT_EQUAL_MEMORY(&state, &outside, sizeof outside);
}

/* Whatever arrives, the pose stays a pose and moves by small steps only. */
static void garbage_does_no_harm(void) {
    uint64_t seed = 29;
    for (u32 n = 0; n < REFERENCE_CASES(200000); n++) {
        const odometry_pose seen = {(i32)reference_random(&seed), (i32)reference_random(&seed),
                                    (i32)reference_random(&seed)};
        odometry_pose before;
        outside_pose_take(&outside, &p, &pose, &seen, (i16)(reference_random(&seed) % 260), 1);
        before = pose;
        outside_pose_step(&outside, &pose);
        TEST_ASSERT_INT32_WITHIN(2048, before.x_mm_q13, pose.x_mm_q13);
        TEST_ASSERT_TRUE(labs(pose.theta_mrad_q13) <= ODOMETRY_FULL_TURN_MRAD_Q13 / 2 + 1);
        if (n % 5000 == 0)
            outside_pose_take(&outside, &p, &pose, &seen, 100, 0);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(any_known_delay_is_undone);
    RUN_TEST(a_wrong_delay_shows_as_the_way_driven_in_it);
    RUN_TEST(drift_is_held_at_what_grows_until_it_is_corrected);
    RUN_TEST(a_correction_is_given_in_small_steps);
    RUN_TEST(a_robot_that_does_not_drive_takes_the_pose_as_it_is);
    RUN_TEST(the_way_since_then_turns_with_the_heading);
    RUN_TEST(the_past_begins_with_the_reset);
    RUN_TEST(poses_of_unknown_age_are_refused);
    RUN_TEST(garbage_does_no_harm);
    return UNITY_END();
}
