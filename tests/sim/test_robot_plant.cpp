/* Physics of the slip plant: energy, rest, closed forms, symmetry of its equations, step size. */
#include "tests/sim/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using namespace omnislip;

extern "C" void setUp() {}
extern "C" void tearDown() {}

using Layout = RobotLayout;
static const double kGravity_m_s2 = 9.81;
static const Robot::Command kCoast = {0.0, 0.0, 0.0, 0.0};

static double squared(double x) {
    return x * x;
}

/* Saturating function of eq. (13). */
static double grip(double k_s) {
    return 2.0 / kPi * std::atan(k_s);
}

/* ---- energy ---- */

/* The robot with one more state: work put in at the motor terminals and by outside forces, less
 * what armature, shaft friction, sliding wheels and rollers turn into heat. */
class EnergyAudit {
  public:
    static constexpr int kMotors = 4;
    static constexpr int kStates = Layout::kStates + 1;

    explicit EnergyAudit(const RobotPlant<double> &plant) : plant_(plant) {}

    void command(const double *duty, double *held) const {
        std::copy_n(duty, kMotors, held);
    }

    void derivative(const double *x, const double *duty, const double &time_s, double *dx,
                    RobotInternals<double> &in) const {
        RobotPlant<double>::Step step;
        double all[Layout::kAll] = {}, rate[Layout::kAll] = {}; /* the plant's, memory included */
        std::copy_n(x, Layout::kStates, all);
        plant_.begin_step(all, duty, 0.0, step);
        plant_.derivative(all, step, time_s, rate, in);
        std::copy_n(rate, Layout::kStates, dx);
        dx[Layout::kStates] = power_w(x, step.duty, in);
    }

    double kinetic_j(const double *x) const {
        const Constants<double, 4> &c = plant_.constants();
        const double *v = x + Layout::kVelocity;
        double twice_j =
            c.mass_kg * (squared(v[0] - v[2] * c.cog_y_m) + squared(v[1] + v[2] * c.cog_x_m)) +
            c.inertia_kg_m2 * squared(v[2]);
        for (int i = 0; i < 4; ++i) {
            twice_j += c.shaft_inertia_kg_m2[i] * squared(x[i]);
        }
        return twice_j / 2.0;
    }

  private:
    double power_w(const double *x, const double *driven, const RobotInternals<double> &in) const {
        const Constants<double, 4> &c = plant_.constants();
        const double *v = x + Layout::kVelocity;
        double power = in.external_force_x_n * (v[0] - v[2] * c.cog_y_m) +
                       in.external_force_y_n * (v[1] + v[2] * c.cog_x_m) +
                       in.external_torque_nm * v[2];
        for (int i = 0; i < 4; ++i) {
            power += driven[i] * in.bus_v * in.current_a[i];
            power -= c.resistance_ohm * squared(in.current_a[i]);
            power += in.friction_torque_nm[i] * x[i];
            power -= in.drive_force_n[i] * in.slip_m_s[i];
            power += in.roller_force_n[i] * in.roller_speed_m_s[i];
        }
        return power;
    }

    const RobotPlant<double> &plant_;
};

/* |kinetic energy gained - energy balance| after 0.6 s of changing duty. */
static double energy_error_j(const RobotModel &model, double step_s) {
    static const Robot::Command duties[3] = {
        {0.5, -0.3, 0.7, 0.1}, {-0.6, 0.4, 0.2, 0.8}, {0.1, 0.3, -0.4, -0.2}};
    const Robot robot(model);
    const EnergyAudit audit(robot.plant);
    double x[EnergyAudit::kStates] = {};
    RobotInternals<double> in{};
    for (int k = 0; k < 3; ++k) {
        advance(audit, x, duties[k].data(), 0.2 * k, 0.2, step_s, 0.0, in);
    }
    TEST_ASSERT_TRUE(audit.kinetic_j(x) > 1.0);
    return std::abs(audit.kinetic_j(x) - x[Layout::kStates]);
}

static void assert_energy_balance_of_order_four(const RobotModel &model) {
    const double coarse = energy_error_j(model, 1e-3), fine = energy_error_j(model, 0.5e-3),
                 finest = energy_error_j(model, 0.25e-3);
    TEST_ASSERT_DOUBLE_WITHIN(1e-2, 0.0, coarse);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 4.5, std::log2(coarse / fine));
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 4.5, std::log2(fine / finest));
}

static void energy_is_balanced_to_the_order_of_the_integrator(void) {
    assert_energy_balance_of_order_four(RobotModel());
}

static void energy_is_balanced_with_the_effects_of_geometry_and_load(void) {
    assert_energy_balance_of_order_four(RobotModel()
                                            .effect("cog_offset", "x_m", 0.03)
                                            .effect("cog_offset", "y_m", -0.02)
                                            .effect("load_transfer", "cog_height_m", 0.1)
                                            .effect("diagonal_load_bias", "force_n", 8.0)
                                            .effect("wheel_angle_error", "angle_rad", 0.1, 2)
                                            .effect("wheel_eccentricity", "amplitude", 0.05, 3)
                                            .effect("wheel_radius_error", "scale", 1.04, 4));
}

static void energy_is_balanced_with_the_effects_of_motor_and_body(void) {
    assert_energy_balance_of_order_four(RobotModel()
                                            .effect("weak_motor", "scale", 0.8, 1)
                                            .effect("supply_sag", "source_resistance_ohm", 0.1)
                                            .effect("coulomb_friction", "torque_nm", 0.005)
                                            .effect("body_drag", "coefficient_n_s_m", 6.0)
                                            .effect("tether_spring", "stiffness_n_m", 20.0)
                                            .effect("floor_slope", "y_m_s2", 0.5)
                                            .effect("cog_offset", "x_m", 0.03));
}

/* ---- rest ---- */

static void robot_at_rest_stays_at_rest_exactly(void) {
    Robot robot;
    robot.x[Layout::kPose] = 1.5;
    robot.x[Layout::kPose + 2] = 0.7;
    const Robot::State before = robot.x;
    robot.drive(kCoast, 1.0);
    TEST_ASSERT_EQUAL_MEMORY(before.data(), robot.x.data(), sizeof(before));
}

/* ---- motor ---- */

/* In the air: W = W_end (1 - exp(-t / tau)), tau = J0 / (b0 + k2 k3 / Ra). */
static void wheel_in_the_air_steps_as_the_closed_form(void) {
    Robot robot(RobotModel().set("contact.mu_drive", 0.0));
    const double drag = 1.5e-5 + 0.0255 * 0.0255 / 0.6, tau_s = 2.5e-5 / drag;
    const double end_rad_s = 0.0255 / 0.6 * 0.5 * 24.0 / drag;
    robot.drive({0.5, -0.5, 0.25, 0.0}, 0.03, 1e-4);
    const double reached = end_rad_s * (1.0 - std::exp(-0.03 / tau_s));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, reached, robot.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, -reached, robot.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, reached / 2.0, robot.x[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, robot.x[3]);
    const double turned = end_rad_s * (0.03 - tau_s * (1.0 - std::exp(-0.03 / tau_s)));
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, turned, robot.x[Layout::kAngle]);
    for (std::size_t i = Layout::kVelocity; i < Layout::kStates; ++i) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, robot.x[i]);
    }
}

static void no_load_rim_speed_is_3_9_m_s(void) {
    Robot robot(RobotModel().set("contact.mu_drive", 0.0));
    robot.drive({1.0, 1.0, 1.0, 1.0}, 0.5);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 3.9, robot.x[0] * 0.05 / 12.0);
}

/* ---- sliding on the limit of grip ---- */

/* Wheels locked by an inertia without end. The drive directions give mu / 2 ahead and mu s to the
 * side (s = sqrt(3)/2), the rollers mu_F s ahead and mu_F / 2 to the side. */
static RobotModel locked_wheels() {
    return RobotModel().set("motor.inertia_kg_m2", 1e9);
}

static void locked_wheels_brake_ahead_as_the_geometry_says(void) {
    Robot robot(locked_wheels());
    robot.x[Layout::kVelocity] = 1.7;
    const Robot::State change = robot.derivative(kCoast);
    const double a =
        0.6 * 0.5 * grip(40.0 * 0.5 * 1.7) + 0.05 * kHalfSqrt3 * grip(40.0 * kHalfSqrt3 * 1.7);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -kGravity_m_s2 * a, change[Layout::kVelocity]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, change[Layout::kVelocity + 1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, change[Layout::kVelocity + 2]);
}

static void locked_wheels_brake_sideways_as_the_geometry_says(void) {
    Robot robot(locked_wheels());
    robot.x[Layout::kVelocity + 1] = -1.7;
    const Robot::State change = robot.derivative(kCoast);
    const double a =
        0.6 * kHalfSqrt3 * grip(40.0 * kHalfSqrt3 * 1.7) + 0.05 * 0.5 * grip(40.0 * 0.5 * 1.7);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, change[Layout::kVelocity]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, kGravity_m_s2 * a, change[Layout::kVelocity + 1]);
}

/* k v >> 1: constant deceleration; grip(x) > 1 - (2/pi) / x bounds how far from it. */
static void coasting_robot_slides_to_the_stopping_distance(void) {
    Robot robot(locked_wheels().set("contact.slip_stiffness_s_m", 4000.0));
    robot.x[Layout::kVelocity] = 2.0;
    robot.drive(kCoast, 0.4);
    const double a = kGravity_m_s2 * (0.6 / 2.0 + 0.05 * kHalfSqrt3);
    const double slow = 2.0 - 0.4 * a;
    const double short_of = 2.0 / kPi / (4000.0 * 0.5 * slow);
    TEST_ASSERT_DOUBLE_WITHIN(0.4 * a * short_of, slow, robot.x[Layout::kVelocity]);
    TEST_ASSERT_DOUBLE_WITHIN(0.08 * a * short_of, 2.0 * 0.4 - 0.08 * a, robot.x[Layout::kPose]);
}

/* Motors without torque, wheels that roll: the rollers brake with mu_F m g sqrt(3) / 2 the robot
 * and, through the drive, four rotors of n^2 J0 / R^2 whose rims move half as fast. */
static void free_robot_rolls_out_on_its_rollers(void) {
    Robot robot(RobotModel()
                    .set("motor.torque_constant_nm_a", 0.0)
                    .set("motor.viscous_friction_nm_s", 0.0)
                    .set("contact.slip_stiffness_s_m", 4000.0));
    const double rolling_rad_s = 0.5 * 1.5 * 12.0 / 0.05;
    robot.x = {-rolling_rad_s, -rolling_rad_s, rolling_rad_s, rolling_rad_s};
    robot.x[Layout::kVelocity] = 1.5;
    robot.drive(kCoast, 2.0);
    const double rotors_kg = 144.0 * 2.5e-5 / (0.05 * 0.05);
    const double a = 0.05 * 20.0 * kGravity_m_s2 * kHalfSqrt3 / (20.0 + rotors_kg);
    const double short_of = 2.0 / kPi / (4000.0 * kHalfSqrt3 * (1.5 - 2.0 * a));
    TEST_ASSERT_DOUBLE_WITHIN(2.0 * a * short_of, 1.5 - 2.0 * a, robot.x[Layout::kVelocity]);
    TEST_ASSERT_DOUBLE_WITHIN(2.0 * a * short_of, 3.0 - 2.0 * a, robot.x[Layout::kPose]);
}

/* Wheels that spin far too fast push with all the grip there is: a = mu g / 2 straight ahead. */
static void spinning_wheels_accelerate_at_the_limit_of_grip(void) {
    Robot robot(RobotModel()
                    .set("contact.mu_drive", 0.1)
                    .set("contact.mu_roller", 0.0)
                    .set("contact.slip_stiffness_s_m", 4000.0));
    for (std::size_t i = 0; i < 4; ++i) {
        robot.x[i] = i < 2 ? -900.0 : 900.0;
    }
    robot.drive({-1.0, -1.0, 1.0, 1.0}, 1.0);
    const double a = 0.1 * kGravity_m_s2 / 2.0; /* slip > 3 m/s: 1 - grip < 6e-5 */
    TEST_ASSERT_DOUBLE_WITHIN(6e-5 * a, a, robot.x[Layout::kVelocity]);
    TEST_ASSERT_DOUBLE_WITHIN(6e-5 * a, a / 2.0, robot.x[Layout::kPose]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, robot.x[Layout::kPose + 1]);
}

static void spinning_wheels_turn_the_robot_at_mu_m_g_l_over_iz(void) {
    Robot robot(RobotModel().set("contact.mu_drive", 0.02).set("contact.slip_stiffness_s_m", 4e3));
    for (std::size_t i = 0; i < 4; ++i) {
        robot.x[i] = 900.0;
    }
    robot.drive({1.0, 1.0, 1.0, 1.0}, 1.0);
    const double alpha = 0.02 * 20.0 * kGravity_m_s2 * 0.20 / 0.55;
    TEST_ASSERT_DOUBLE_WITHIN(6e-5 * alpha, alpha, robot.x[Layout::kVelocity + 2]);
    TEST_ASSERT_DOUBLE_WITHIN(6e-5 * alpha, alpha / 2.0, robot.x[Layout::kPose + 2]);
}

/* ---- structure ---- */

/* n . hub speed = 0 for every body motion, so n . slip = (R/n) n . W: one slip signal for free. */
static void alternating_sum_of_slip_is_that_of_the_wheels(void) {
    Robot robot;
    robot.x = {100.0, -50.0, 80.0, 20.0, 0, 0, 0, 0, 0.8, -1.1, 3.0, 0, 0, 0.4};
    robot.derivative(kCoast);
    double slip = 0.0, rim = 0.0;
    for (int i = 0; i < 4; ++i) {
        slip += kNull[i] * robot.in.slip_m_s[i];
        rim += kNull[i] * 0.05 / 12.0 * robot.x[static_cast<std::size_t>(i)];
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, rim, slip);
}

/* Wheels renumbered (with their angles and everything of their own): the same robot. */
static void numbering_of_the_wheels_does_not_matter(void) {
    const double angle_deg[4] = {25.0, 155.0, 220.0, 330.0}, scale[4] = {1.0, 0.98, 1.03, 0.95};
    const Robot::Command duty = {0.4, -0.2, 0.6, 0.3};
    RobotModel model, renumbered;
    for (int i = 0; i < 4; ++i) {
        const int j = (i + 1) % 4;
        const std::string first = "robot.wheel_angles_deg[" + std::to_string(i) + "]";
        const std::string second = "robot.wheel_angles_deg[" + std::to_string(j) + "]";
        model.set(first, angle_deg[i]).effect("wheel_radius_error", "scale", scale[i], i + 1);
        renumbered.set(second, angle_deg[i]).effect("wheel_radius_error", "scale", scale[i], j + 1);
    }
    Robot robot(model), other(renumbered);
    robot.drive(duty, 1.0);
    other.drive({duty[3], duty[0], duty[1], duty[2]}, 1.0);
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-8, robot.x[i], other.x[(i + 1) % 4]);
    }
    for (std::size_t i = Layout::kVelocity; i < Layout::kStates; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, robot.x[i], other.x[i]);
    }
}

/* ---- rules of the integrator ---- */

/* y' = -2 t y^2 from y = 1, whose solution is 1 / (1 + t^2): neither linear nor the same at all
 * times. */
struct Bell {
    void derivative(const double *y, int, const double &t, double *dy, int &) const {
        dy[0] = -2.0 * t * y[0] * y[0];
    }
};

template <class Rule>
static double bell_error(int steps) {
    const double h = 2.0 / steps;
    double y = 1.0;
    int none = 0;
    for (int k = 0; k < steps; ++k) {
        take_step<Rule, 1>(Bell(), &y, 0, k * h, h, none);
    }
    return std::abs(y - 0.2);
}

template <class Rule>
static void assert_order_four(void) {
    TEST_ASSERT_DOUBLE_WITHIN(0.25, 4.0, std::log2(bell_error<Rule>(100) / bell_error<Rule>(200)));
}

static void error_of_either_rule_falls_with_the_fourth_power_of_the_step(void) {
    assert_order_four<Rk4>();
    assert_order_four<Merson>();
}

/* ---- step size ---- */

static void steps_divide_the_interval_and_keep_to_both_bounds(void) {
    TEST_ASSERT_EQUAL_INT(1, step_count(0.0, 1e-3, 1e6));
    TEST_ASSERT_EQUAL_INT(1, step_count(1e-3, 1e-3, 10.0));
    TEST_ASSERT_EQUAL_INT(5, step_count(5e-3, 1e-3, 1000.0));
    TEST_ASSERT_EQUAL_INT(6, step_count(5.1e-3, 1e-3, 1000.0));
    TEST_ASSERT_EQUAL_INT(1, step_count(1e-3, 1e-3, 0.0));
    TEST_ASSERT_EQUAL_INT(10, step_count(5e-3, 1e-3, 2800.0));
    TEST_ASSERT_EQUAL_INT(10, step_count(5e-3, 1e-3, 4000.0)); /* half a millisecond is enough */
    TEST_ASSERT_EQUAL_INT(35, step_count(5e-3, 1e-3, 14000.0));
}

/* Full reversals every 50 ms, compared with ten times finer steps. */
static void assert_default_step_is_stable(const RobotModel &model) {
    Robot robot(model), fine(model);
    for (int k = 0; k < 40; ++k) {
        const double d = k % 2 == 0 ? 1.0 : -1.0;
        const Robot::Command duty = {d, -d, 0.9 * d, 0.3 * d};
        robot.drive(duty, 0.05);
        fine.drive(duty, 0.05, 1e-4);
    }
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(0.01 * 930.0, fine.x[i], robot.x[i]);
    }
    for (std::size_t i = Layout::kVelocity; i < Layout::kPose; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(0.05, fine.x[i], robot.x[i]);
    }
}

static void stiff_light_robot_is_stable_at_the_default_step(void) {
    assert_default_step_is_stable(RobotModel()
                                      .set("robot.mass_kg", 2.0)
                                      .set("contact.mu_drive", 1.2)
                                      .set("contact.slip_stiffness_s_m", 400.0));
}

/* Wheels that slide pass six magnets a turn 570 times a second: a row of 5 ms has three of them,
 * and a step that sees each at another place would see a steady torque now and then. To a count. */
static void shafts_that_cog_fast_are_followed_at_the_default_step(void) {
    const RobotModel model =
        RobotModel().effect("cogging", "torque_nm", 0.1).effect("cogging", "cycles_per_rev", 6.0);
    Robot robot(model), fine(model);
    for (int row = 0; row < 200; ++row) {
        const double d = 0.3 + 0.003 * row;
        robot.drive({d, -d, -0.8 * d, 0.9 * d}, 5e-3, 5e-3);
        fine.drive({d, -d, -0.8 * d, 0.9 * d}, 5e-3, 1e-5);
        for (std::size_t i = 0; i < 4; ++i) {
            TEST_ASSERT_DOUBLE_WITHIN(2.0 * kPi / 2000.0, fine.x[4 + i], robot.x[4 + i]);
        }
    }
    TEST_ASSERT_TRUE(std::abs(fine.x[0]) > 600.0);
}

/* A gentle turn keeps the wheels on the steep part of the friction law. */
static void robot_of_small_inertia_turns_without_chatter(void) {
    Robot robot(RobotModel().set("robot.inertia_kg_m2", 0.08).set("contact.mu_drive", 1.2));
    robot.drive({0.1, 0.1, 0.1, 0.1}, 1.0);
    const double drag = 1.5e-5 + 0.0255 * 0.0255 / 0.6;
    const double end_rad_s = 0.0255 / 0.6 * 0.1 * 24.0 / drag;
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-6 * end_rad_s, end_rad_s, robot.x[i]);
    }
}

static void robot_with_dragging_rollers_is_stable_at_the_default_step(void) {
    assert_default_step_is_stable(RobotModel()
                                      .set("robot.mass_kg", 2.0)
                                      .set("contact.mu_drive", 0.05)
                                      .set("contact.mu_roller", 0.6)
                                      .set("contact.slip_stiffness_s_m", 400.0));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(energy_is_balanced_to_the_order_of_the_integrator);
    RUN_TEST(energy_is_balanced_with_the_effects_of_geometry_and_load);
    RUN_TEST(energy_is_balanced_with_the_effects_of_motor_and_body);
    RUN_TEST(robot_at_rest_stays_at_rest_exactly);
    RUN_TEST(wheel_in_the_air_steps_as_the_closed_form);
    RUN_TEST(no_load_rim_speed_is_3_9_m_s);
    RUN_TEST(locked_wheels_brake_ahead_as_the_geometry_says);
    RUN_TEST(locked_wheels_brake_sideways_as_the_geometry_says);
    RUN_TEST(coasting_robot_slides_to_the_stopping_distance);
    RUN_TEST(free_robot_rolls_out_on_its_rollers);
    RUN_TEST(spinning_wheels_accelerate_at_the_limit_of_grip);
    RUN_TEST(spinning_wheels_turn_the_robot_at_mu_m_g_l_over_iz);
    RUN_TEST(alternating_sum_of_slip_is_that_of_the_wheels);
    RUN_TEST(numbering_of_the_wheels_does_not_matter);
    RUN_TEST(error_of_either_rule_falls_with_the_fourth_power_of_the_step);
    RUN_TEST(steps_divide_the_interval_and_keep_to_both_bounds);
    RUN_TEST(stiff_light_robot_is_stable_at_the_default_step);
    RUN_TEST(shafts_that_cog_fast_are_followed_at_the_default_step);
    RUN_TEST(robot_of_small_inertia_turns_without_chatter);
    RUN_TEST(robot_with_dragging_rollers_is_stable_at_the_default_step);
    return UNITY_END();
}
