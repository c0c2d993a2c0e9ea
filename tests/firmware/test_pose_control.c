/* Poses in closed loop: the way to a pose, an outside pose, commands that replace each other. */
#include <string.h>
#include <unity.h>

#include "tests/firmware/closed_loop.h"
#include "tests/firmware/reference.h"

static const kinematics_velocity still = {0, 0, 0};

void setUp(void) {
    start(1);
}

void tearDown(void) {}

static void go_to(const odometry_pose *goal, int ticks) {
    for (int n = 0; n < ticks; n++) {
        TEST_ASSERT_EQUAL(TRAJECTORY_OK, control_loop_command_pose(&loop, goal, &still));
        reference_plant_tick(&plant, &loop);
    }
}

static void pose_command_arrives_in_belief_and_in_truth(void) {
    const odometry_pose goal = {8192000, -4096000, 12867964}; /* 1 m, -0.5 m, 90 degrees */
    go_to(&goal, 4500);
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
    drive(500, 0, 0, 300);
    TEST_ASSERT_EQUAL(TRAJECTORY_TOO_FAR, control_loop_command_pose(&loop, &far, &still));
    reference_plant_tick(&plant, &loop);
    TEST_ASSERT_EQUAL(CONTROL_MODE_VELOCITY, loop.telemetry.mode);
}

static void change_of_command_does_not_jump(void) {
    const odometry_pose goal = {16384000, 4096000, 0};
    double slowest = 10.0;
    drive(1000, 0, 0, 1200);
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
    drive(1000, 0, 0, 1200);
    for (int n = 0; n < 3000; n++) {
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

/* A camera that sees a standing robot 30 mm ahead and 20 mm to the right of its belief, turned left
 * by 100 mrad: it undoes each of the three. */
static void a_standing_robot_returns_to_where_it_was_told_to_stand(void) {
    drive(0, 0, 0, 100);
    for (int n = 0; n < 125; n++) {
        const odometry_pose seen = {
            (i32)lround((true_x_mm() + 30.0) * 8192.0), (i32)lround((true_y_mm() - 20.0) * 8192.0),
            (i32)lround((1000.0 * plant.state[PLANT_THETA] + 100.0) * 8192.0)};
        TEST_ASSERT_TRUE(control_loop_outside_pose(&loop, &seen, 0));
        drive(0, 0, 0, 20);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.001, -0.1, plant.state[PLANT_THETA]);
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 0.0, loop.telemetry.pose.theta_mrad_q13 / 8192.0);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, -30.0, true_x_mm());
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 20.0, true_y_mm());
}

/* On the way the plan has become short; a repetition leaves it so. After another command the same
 * pose is planned from where the robot then is. */
static void only_a_repeated_pose_command_keeps_its_plan(void) {
    const odometry_pose goal = {500L * 8192, 0, 0};
    trajectory before;
    go_to(&goal, 100);
    before = loop.target;
    control_loop_command_pose(&loop, &goal, &still);
    TEST_ASSERT_EQUAL_MEMORY(&before, &loop.target, sizeof before);
    drive(0, 0, 0, 1);
    before = loop.target;
    control_loop_command_pose(&loop, &goal, &still);
    TEST_ASSERT_TRUE(memcmp(&before, &loop.target, sizeof before) != 0);
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
    RUN_TEST(pose_command_arrives_in_belief_and_in_truth);
    RUN_TEST(unreachable_pose_leaves_the_command_in_force);
    RUN_TEST(change_of_command_does_not_jump);
    RUN_TEST(outside_pose_moves_the_robot_without_a_jump_of_the_speed);
    RUN_TEST(a_standing_robot_returns_to_where_it_was_told_to_stand);
    RUN_TEST(only_a_repeated_pose_command_keeps_its_plan);
    RUN_TEST(each_number_of_a_pose_command_counts);
    return UNITY_END();
}
