/* Each line of the table of errata in sim/README.md: the corrected form holds, the printed does
 * not.
 *
 * The rigid model is code of its own (matrices), the slip plant another (wheel by wheel). Where a
 * term is in both, both are asked.
 */
#include "rigid_model.h"
#include "tests/sim/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using namespace omnislip;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::Vector4d;

extern "C" void setUp() {}
extern "C" void tearDown() {}

static const double kLever_m = 0.20;

static RigidModel rigid_of(const Robot &robot) {
    return RigidModel(robot.plant.constants());
}

static void assert_zero(double bound, const Eigen::MatrixXd &m) {
    TEST_ASSERT_DOUBLE_WITHIN(bound, 0.0, m.cwiseAbs().maxCoeff());
}

static void set_velocity(Robot &robot, const Vector3d &v) {
    for (int i = 0; i < 3; ++i) {
        robot.x[static_cast<std::size_t>(RobotLayout::kVelocity + i)] = v[i];
    }
}

static Vector3d velocity_part(const Robot::State &x) {
    return Vector3d(x[RobotLayout::kVelocity], x[RobotLayout::kVelocity + 1],
                    x[RobotLayout::kVelocity + 2]);
}

/* ---- (3) J and its inverse ---- */

static void jacobian_is_the_corrected_matrix(void) {
    const Robot robot;
    WheelMap expected;
    expected << -0.5, kHalfSqrt3, kLever_m, -0.5, -kHalfSqrt3, kLever_m, /* wheels 1 and 2 */
        0.5, -kHalfSqrt3, kLever_m, 0.5, kHalfSqrt3, kLever_m;           /* wheels 3 and 4 */
    assert_zero(1e-15, rigid_of(robot).jacobian() - expected);
}

static void jacobian_columns_are_orthogonal(void) {
    const WheelMap j = rigid_of(Robot()).jacobian();
    const Vector3d expected(1.0, 3.0, 4.0 * kLever_m * kLever_m);
    assert_zero(1e-15, j.transpose() * j - Matrix3d(expected.asDiagonal()));
}

static void pseudo_inverse_undoes_the_jacobian(void) {
    const WheelMap j = rigid_of(Robot()).jacobian();
    assert_zero(1e-14, pseudo_inverse(j) * j - Matrix3d::Identity());
}

static void pseudo_inverse_has_three_rows_as_printed_without_the_stray(void) {
    const double a = 2.0 / std::sqrt(3.0), l = 1.0 / kLever_m;
    Eigen::Matrix<double, 3, 4> expected;
    expected << -2, -2, 2, 2, a, -a, -a, a, l, l, l, l;
    assert_zero(1e-14, pseudo_inverse(rigid_of(Robot()).jacobian()) - 0.25 * expected);
}

static void null_space_is_the_alternating_vector(void) {
    const Vector4d n = Eigen::Map<const Vector4d>(kNull);
    const WheelMap j = rigid_of(Robot()).jacobian();
    assert_zero(1e-15, j.transpose() * n);
    assert_zero(1e-14,
                n * n.transpose() / 4.0 - (Eigen::Matrix4d::Identity() - j * pseudo_inverse(j)));
}

/* ---- (4) Iz in A ---- */

static void spin_depends_on_the_inertia_and_not_on_the_mass(void) {
    const Vector4d turn(6.0, 6.0, 6.0, 6.0);
    const Robot nominal, heavy(RobotModel().set("robot.mass_kg", 40.0)),
        slow(RobotModel().set("robot.inertia_kg_m2", 1.10));
    const double alpha = rigid_of(nominal).acceleration(Vector3d::Zero(), turn)[2];
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, alpha,
                              rigid_of(heavy).acceleration(Vector3d::Zero(), turn)[2]);
    /* rotors count as n^2 J0 / R^2 4 L^2 = 0.2304 kg m^2 */
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, alpha * (0.55 + 0.2304) / (1.10 + 0.2304),
                              rigid_of(slow).acceleration(Vector3d::Zero(), turn)[2]);
}

static double plant_spin(const RobotModel &model) {
    Robot robot(model);
    for (std::size_t i = 0; i < 4; ++i) {
        robot.x[i] = 100.0;
    }
    return robot.derivative({0.0, 0.0, 0.0, 0.0})[RobotLayout::kVelocity + 2];
}

static void spin_of_the_slip_plant_divides_by_the_inertia(void) {
    /* alpha = 4 N mu (2/pi) atan(k s) L / Iz with 4 N = m g and s = R W / n */
    const double slip = 0.05 * 100.0 / 12.0;
    const double moment = 20.0 * 9.81 * 0.6 * (2.0 / kPi) * std::atan(40.0 * slip) * kLever_m;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, moment / 0.55, plant_spin(RobotModel()));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, moment / 1.10,
                              plant_spin(RobotModel().set("robot.inertia_kg_m2", 1.10)));
}

/* ---- (5), (10): no rotation in the body frame; H = J' ---- */

static void heading_does_not_change_the_body_acceleration(void) {
    const Robot::Command duty = {0.3, -0.2, 0.5, 0.1};
    Robot north, east;
    set_velocity(north, Vector3d(0.4, -0.7, 1.1));
    east.x = north.x;
    east.x[RobotLayout::kPose + 2] = kPi / 2.0;
    const Vector3d a = velocity_part(north.derivative(duty));
    assert_zero(0.0, a - velocity_part(east.derivative(duty)));

    const RigidModel rigid = rigid_of(north);
    double x[6] = {0.4, -0.7, 1.1, 0.0, 0.0, 0.0}, dx[6], turned[6];
    const double u[4] = {7.2, -4.8, 12.0, 2.4};
    RigidInternals in;
    rigid.derivative(x, u, 0.0, dx, in);
    x[5] = kPi / 2.0;
    rigid.derivative(x, u, 0.0, turned, in);
    TEST_ASSERT_EQUAL_MEMORY(dx, turned, 3 * sizeof(double));
}

static void traction_maps_to_the_body_by_the_transposed_jacobian(void) {
    const Robot robot;
    const RigidModel rigid = rigid_of(robot);
    const double x[6] = {0.4, -0.7, 1.1, 0.3, 0.2, 0.9}, u[4] = {7.2, -4.8, 12.0, 2.4};
    double dx[6];
    RigidInternals in;
    rigid.derivative(x, u, 0.0, dx, in);
    const Vector3d v(x), change(dx);
    const Vector3d momentum = Vector3d(20.0, 20.0, 0.55).cwiseProduct(change);
    assert_zero(
        1e-12, momentum + rigid.velocity_product(v) - rigid.jacobian().transpose() * in.traction_n);
}

/* Every wheel pushes in turn: the body feels row i of J, lever L included. */
static void plant_force_of_one_wheel_is_a_column_of_h(void) {
    for (std::size_t i = 0; i < 4; ++i) {
        Robot robot;
        robot.x[i] = 200.0;
        const Robot::State change = robot.derivative({0.0, 0.0, 0.0, 0.0});
        const Vector3d momentum = Vector3d(20.0, 20.0, 0.55).cwiseProduct(velocity_part(change));
        const Vector3d row = rigid_of(robot).jacobian().row(static_cast<int>(i)).transpose();
        assert_zero(1e-10, momentum - row * robot.in.drive_force_n[i]);
        TEST_ASSERT_GREATER_THAN(0, static_cast<int>(robot.in.drive_force_n[i]));
    }
}

/* ---- (7), (9), (10): n^2 ---- */

/* Largest difference of the body velocity from the rigid model over 0.4 s; k mu of the contact
 * times `stiffer`, rollers free. */
static double distance_from_rigid(double stiffer) {
    Robot robot(RobotModel().set("contact.mu_drive", 0.6 * stiffer).set("contact.mu_roller", 0.0));
    const RigidModel rigid = rigid_of(robot);
    double x[6] = {}, worst = 0.0;
    const double voltage_v[2][4] = {{12.0, -6.0, 3.0, 9.0}, {-4.0, 8.0, 11.0, -2.0}};
    RigidInternals in;
    for (const double *u : voltage_v) {
        for (int k = 0; k < 20; ++k) {
            robot.drive({u[0] / 24.0, u[1] / 24.0, u[2] / 24.0, u[3] / 24.0}, 0.01);
            advance(rigid, x, u, 0.0, 0.01, 1e-4, 0.0, in);
            const Vector3d apart = velocity_part(robot.x) - Vector3d(x);
            worst = std::max(worst, apart.cwiseAbs().maxCoeff());
        }
    }
    return worst;
}

/* Grip without end leaves a slip of f / (N mu (2/pi) k): first order in 1 / (k mu). */
static void slip_plant_tends_to_the_rigid_model_as_grip_grows(void) {
    const double near = distance_from_rigid(100.0), nearer = distance_from_rigid(1000.0);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, 0.0, near);
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 10.0, near / nearer);
}

/* Straight ahead, steady: rim speed = (R/n) k2 u / (k2 k3 + b0 Ra); n printed for n^2 on the left
 * would make it n times that. */
static void steady_speed_is_that_of_the_gear(void) {
    const Robot robot;
    const RigidModel rigid = rigid_of(robot);
    const Vector4d u(-12.0, -12.0, 12.0, 12.0);
    const Vector3d v = rigid.damping_matrix().ldlt().solve(rigid.input_map() * u);
    const double shaft = 0.0255 * 12.0 / (0.0255 * 0.0255 + 1.5e-5 * 0.6);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.05 / 12.0 * shaft, v[0] / 2.0);
}

static void rotor_inertia_counts_with_the_gear_ratio_squared(void) {
    const double rim_kg = 144.0 * 2.5e-5 / (0.05 * 0.05); /* n^2 J0 / R^2 */
    const Vector3d expected(20.0 + rim_kg, 20.0 + 3.0 * rim_kg,
                            0.55 + 4.0 * kLever_m * kLever_m * rim_kg);
    assert_zero(1e-12, rigid_of(Robot()).mass_matrix() - Matrix3d(expected.asDiagonal()));
}

static void with_gear_ratio_one_both_readings_agree(void) {
    const Robot robot(RobotModel().set("motor.gear_ratio", 1.0));
    const double rim_kg = 2.5e-5 / (0.05 * 0.05);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 20.0 + rim_kg, rigid_of(robot).mass_matrix()(0, 0));
}

/* ---- (12) hub velocities; V_F outward ---- */

static void hub_speed_is_the_projection_without_alpha(void) {
    Robot robot;
    const Vector3d v(0.9, -0.4, 2.5);
    set_velocity(robot, v);
    robot.derivative({0.0, 0.0, 0.0, 0.0});
    const Vector4d hub = Eigen::Map<const Vector4d>(robot.in.hub_speed_m_s);
    assert_zero(1e-14, hub - rigid_of(robot).jacobian() * v);
}

static void roller_speed_is_outward_and_its_force_opposes_it(void) {
    const double bearing[4] = {30.0, 150.0, 210.0, 330.0};
    Robot robot;
    set_velocity(robot, Vector3d(0.9, -0.4, 2.5));
    robot.derivative({0.0, 0.0, 0.0, 0.0});
    for (int i = 0; i < 4; ++i) {
        const double g = bearing[i] * kPi / 180.0;
        const double outward = 0.9 * std::cos(g) - 0.4 * std::sin(g);
        const double force = -20.0 * 9.81 / 4.0 * 0.05 * 2.0 / kPi * std::atan(40.0 * outward);
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, outward, robot.in.roller_speed_m_s[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-13, force, robot.in.roller_force_n[i]);
    }
}

/* ---- (1), (3): world pose, body velocity ---- */

static void body_velocity_turned_by_the_heading_moves_the_pose(void) {
    Robot robot;
    set_velocity(robot, Vector3d(1.0, 0.5, 0.3));
    robot.x[RobotLayout::kPose + 2] = kPi / 2.0;
    const Robot::State change = robot.derivative({0.0, 0.0, 0.0, 0.0});
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.5, change[RobotLayout::kPose]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.0, change[RobotLayout::kPose + 1]);
    TEST_ASSERT_EQUAL_DOUBLE(0.3, change[RobotLayout::kPose + 2]);
}

/* No force: the body keeps its world velocity while it spins, so its body velocity turns. */
static void force_free_spinning_body_flies_straight(void) {
    Robot robot(RobotModel().set("contact.mu_drive", 0.0).set("contact.mu_roller", 0.0));
    set_velocity(robot, Vector3d(1.0, 0.5, 3.0));
    robot.drive({0.0, 0.0, 0.0, 0.0}, 2.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 2.0, robot.x[RobotLayout::kPose]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0, robot.x[RobotLayout::kPose + 1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 6.0, robot.x[RobotLayout::kPose + 2]);
}

/* ---- (13) slip, not hub speed ---- */

static void wheel_that_rolls_without_slip_is_not_braked(void) {
    Robot robot(RobotModel().set("contact.mu_roller", 0.0));
    const Vector3d v(1.2, 0.3, 0.0);
    set_velocity(robot, v);
    const Vector4d rim = rigid_of(robot).jacobian() * v;
    for (int i = 0; i < 4; ++i) {
        robot.x[static_cast<std::size_t>(i)] = 12.0 / 0.05 * rim[i];
    }
    const Robot::State change = robot.derivative({0.0, 0.0, 0.0, 0.0});
    assert_zero(1e-10, velocity_part(change));
    for (int i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.0, robot.in.drive_force_n[i]);
    }
}

/* ---- "replace b0 by mu" ---- */

/* b0 [N m s] stays at the shaft, mu [1] limits the force [N]: neither does the other's work. */
static void viscous_friction_is_at_the_shaft_and_grip_limits_the_force(void) {
    Robot robot(RobotModel()
                    .set("motor.resistance_ohm", 1e12)
                    .set("motor.viscous_friction_nm_s", 5e-4)
                    .set("contact.mu_drive", 0.0));
    robot.x[0] = 300.0;
    robot.drive({0.0, 0.0, 0.0, 0.0}, 0.05, 1e-4);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 300.0 * std::exp(-5e-4 / 2.5e-5 * 0.05), robot.x[0]);

    Robot gripping(RobotModel().set("motor.viscous_friction_nm_s", 5e-4));
    gripping.x[0] = 1e9;
    gripping.derivative({0.0, 0.0, 0.0, 0.0});
    TEST_ASSERT_DOUBLE_WITHIN(1e-4, 0.6 * 20.0 * 9.81 / 4.0, gripping.in.drive_force_n[0]);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(jacobian_is_the_corrected_matrix);
    RUN_TEST(jacobian_columns_are_orthogonal);
    RUN_TEST(pseudo_inverse_undoes_the_jacobian);
    RUN_TEST(pseudo_inverse_has_three_rows_as_printed_without_the_stray);
    RUN_TEST(null_space_is_the_alternating_vector);
    RUN_TEST(spin_depends_on_the_inertia_and_not_on_the_mass);
    RUN_TEST(spin_of_the_slip_plant_divides_by_the_inertia);
    RUN_TEST(heading_does_not_change_the_body_acceleration);
    RUN_TEST(traction_maps_to_the_body_by_the_transposed_jacobian);
    RUN_TEST(plant_force_of_one_wheel_is_a_column_of_h);
    RUN_TEST(slip_plant_tends_to_the_rigid_model_as_grip_grows);
    RUN_TEST(steady_speed_is_that_of_the_gear);
    RUN_TEST(rotor_inertia_counts_with_the_gear_ratio_squared);
    RUN_TEST(with_gear_ratio_one_both_readings_agree);
    RUN_TEST(hub_speed_is_the_projection_without_alpha);
    RUN_TEST(roller_speed_is_outward_and_its_force_opposes_it);
    RUN_TEST(body_velocity_turned_by_the_heading_moves_the_pose);
    RUN_TEST(force_free_spinning_body_flies_straight);
    RUN_TEST(wheel_that_rolls_without_slip_is_not_braked);
    RUN_TEST(viscous_friction_is_at_the_shaft_and_grip_limits_the_force);
    return UNITY_END();
}
