/* The effects one by one: neutral means absent, each equation as documented, no side effects.
 *
 * A test of an equation puts the robot into one state in motion and compares what the plant does
 * there with the formula written out again.
 */
#include "tests/sim/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using namespace omnislip;

extern "C" void setUp() {}
extern "C" void tearDown() {}

using Layout = RobotLayout;
static const Robot::Command kCoast = {0.0, 0.0, 0.0, 0.0};
static const Robot::Command kDuty = {0.6, -0.4, 0.9, 0.2};
static const double kLoad_n = 20.0 * 9.81 / 4.0;
/* shaft speeds, angles, body velocity, pose: wheels 1 and 3 drive, 2 and 4 brake */
static const Robot::State kMoving = {300.0, -150.0, 40.0, -3.0, 5.0, 11.0, -7.0,
                                     2.0,   0.9,    -0.4, 1.5,  0.3, -0.6, 0.8};

/* What the plant does in the state kMoving, 2.5 s after the start. */
static RobotInternals<double> moving(const RobotModel &model) {
    Robot robot(model);
    robot.x = kMoving;
    robot.derivative(kDuty, 2.5);
    return robot.in;
}

static Robot::State acceleration(const RobotModel &model) {
    Robot robot(model);
    robot.x = kMoving;
    return robot.derivative(kDuty, 2.5);
}

/* All four drive forces, believed and with the effect, differ by `factor[i]`. */
static void assert_force_factors(const RobotModel &model, const std::array<double, 4> &factor) {
    const RobotInternals<double> believed = moving(RobotModel()), seen = moving(model);
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-11, factor[i] * believed.drive_force_n[i],
                                  seen.drive_force_n[i]);
    }
}

/* Extra shaft torque of the effect on each motor. */
static void assert_shaft_torques(const RobotModel &model, const std::array<double, 4> &torque_nm) {
    const RobotInternals<double> believed = moving(RobotModel()), seen = moving(model);
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, torque_nm[i],
                                  seen.friction_torque_nm[i] - believed.friction_torque_nm[i]);
    }
}

template <class Each>
static std::array<double, 4> per_wheel(Each &&each) {
    return {each(std::size_t{0}), each(std::size_t{1}), each(std::size_t{2}), each(std::size_t{3})};
}

/* ---- neutral ---- */

template <class AnyBench>
static typename AnyBench::State driven(AnyBench &bench) {
    typename AnyBench::Command command{};
    for (int k = 0; k < 20; ++k) {
        for (std::size_t i = 0; i < command.size(); ++i) {
            command[i] = std::sin(0.9 * k + 1.7 * static_cast<double>(i));
        }
        bench.drive(command, 0.02);
    }
    return bench.x;
}

static void neutral_effect_leaves_the_robot_bit_for_bit(void) {
    Robot plain;
    const Robot::State expected = driven(plain);
    for (int index = 0; index < kEffectCount; ++index) {
        RobotModel model;
        model.active[index] = true;
        Robot robot(model);
        const Robot::State reached = driven(robot);
        TEST_ASSERT_EQUAL_MEMORY(expected.data(), reached.data(), sizeof(expected));
    }
}

static void neutral_effect_leaves_the_axis_bit_for_bit(void) {
    Axis plain;
    const Axis::State expected = driven(plain);
    for (int index = 0; index < kEffectCount; ++index) {
        AxisModel model;
        model.active[index] = true;
        Axis axis(model);
        const Axis::State reached = driven(axis);
        TEST_ASSERT_EQUAL_MEMORY(expected.data(), reached.data(), sizeof(expected));
    }
}

static void effect_with_values_but_switched_off_does_nothing(void) {
    RobotModel model;
    model.each_slot([](const EffectInfo &info, int, int k, int, double &slot) {
        slot = info.parameters[k].neutral + info.parameters[k].typical;
    });
    Robot plain, off(model);
    const Robot::State expected = driven(plain), reached = driven(off);
    TEST_ASSERT_EQUAL_MEMORY(expected.data(), reached.data(), sizeof(expected));
}

/* Every effect of typical size at once, but for those that push: the robot does not creep. */
static void robot_at_rest_stays_at_rest_with_all_effects(void) {
    RobotModel model;
    model.each_slot([&](const EffectInfo &info, int index, int k, int, double &slot) {
        const std::string name = info.name;
        if (name != "floor_slope" && name != "force_offset") {
            slot = info.parameters[k].neutral + info.parameters[k].typical;
            model.active[index] = true;
        }
    });
    Robot robot(model);
    robot.drive(kCoast, 0.5);
    const Robot::State zero{};
    TEST_ASSERT_EQUAL_MEMORY(zero.data(), robot.x.data(), sizeof(zero));
}

/* ---- supply, driver, motor ---- */

/* Motor 1 brakes with the command forward, 3 takes a large current. */
static void assert_bus_in_balance(RobotModel model, double source_ohm) {
    const Robot::Command duty = {0.2, -0.1, 0.9, 0.2};
    Robot robot(model.effect("supply_sag", "source_resistance_ohm", source_ohm));
    robot.x = kMoving;
    robot.derivative(duty);
    double current_a = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
        current_a += robot.in.current_a[i] * duty[i];
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 24.0 - source_ohm * current_a, robot.in.bus_v);
}

static void sagging_bus_is_in_balance(void) {
    assert_bus_in_balance(RobotModel(), 0.05);
    assert_bus_in_balance(RobotModel(), 2.0);
}

static void sagging_bus_is_in_balance_with_limited_current(void) {
    assert_bus_in_balance(RobotModel().effect("current_limit", "limit_a", 8.0), 0.05);
    assert_bus_in_balance(RobotModel().effect("current_limit", "limit_a", 3.0), 0.3);
}

static void sagging_bus_is_in_balance_with_a_freewheeling_driver(void) {
    assert_bus_in_balance(RobotModel().effect("driver_freewheel", "braking_fraction", 0.3), 0.05);
    assert_bus_in_balance(RobotModel().effect("driver_freewheel", "braking_fraction", 0.0), 0.3);
}

static void current_follows_duty_voltage_and_back_emf(void) {
    const RobotInternals<double> in = moving(RobotModel());
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, (24.0 * kDuty[i] - 0.0255 * kMoving[i]) / 0.6,
                                  in.current_a[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.0255 * in.current_a[i], in.motor_torque_nm[i]);
    }
}

static void current_limit_clips_both_ways(void) {
    const RobotInternals<double> free = moving(RobotModel());
    const RobotInternals<double> in = moving(RobotModel().effect("current_limit", "limit_a", 9.0));
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_EQUAL_DOUBLE(std::max(std::min(free.current_a[i], 9.0), -9.0), in.current_a[i]);
    }
}

/* Braking with the command still forward freewheels; braking by a reversed command does not. */
static void freewheel_acts_only_while_the_command_keeps_its_sign(void) {
    const RobotModel model = RobotModel().effect("driver_freewheel", "braking_fraction", 0.25);
    const Robot::Command duty = {0.1, -0.1, 0.9, 0.0};
    Robot believed, robot(model);
    believed.x = robot.x = {300.0, 300.0, 300.0, 300.0};
    believed.derivative(duty);
    robot.derivative(duty);
    const double share[4] = {0.25, 1.0, 1.0, 0.25};
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, share[i] * believed.in.current_a[i],
                                  robot.in.current_a[i]);
    }
}

static void assert_driven(const RobotModel &model, const Robot::Command &expected) {
    const Robot robot(model);
    Robot::Command driven_duty;
    robot.plant.command(kDuty.data(), driven_duty.data());
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, expected[i], driven_duty[i]);
    }
}

static void driver_bends_the_duty(void) {
    assert_driven(RobotModel().effect("dead_zone", "duty", 0.25), {0.35, -0.15, 0.65, 0.0});
    assert_driven(RobotModel().effect("driver_nonlinearity", "cubic", 0.5),
                  {0.6 + 0.108, -0.4 - 0.032, 0.9 + 0.3645, 0.2 + 0.004});
}

static void battery_runs_down_with_time(void) {
    TEST_ASSERT_DOUBLE_WITHIN(
        1e-13, 24.0 * (1.0 - 0.01 * 2.5),
        moving(RobotModel().effect("state_of_charge_drift", "rate_1_s", 0.01)).bus_v);
}

/* In the air and after the start, W follows the falling voltage tau late: W = W0 (1 - r (t - tau)),
 * within one interval of constant duty. */
static void battery_runs_down_within_an_interval(void) {
    Robot robot(RobotModel()
                    .set("contact.mu_drive", 0.0)
                    .effect("state_of_charge_drift", "rate_1_s", 0.05));
    const double drag = 1.5e-5 + 0.0255 * 0.0255 / 0.6, tau_s = 2.5e-5 / drag;
    robot.drive({0.5, 0.0, 0.0, 0.0}, 2.0);
    const double nominal_rad_s = 0.0255 / 0.6 * 0.5 * 24.0 / drag;
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, nominal_rad_s * (1.0 - 0.05 * (2.0 - tau_s)), robot.x[0]);
}

/* Scaled k2 and k3: torque k2 i, back-EMF k3 W. */
static void weak_motor_scales_both_constants_of_its_wheel(void) {
    const RobotInternals<double> in = moving(RobotModel().effect("weak_motor", "scale", 0.8, 3));
    const double k = 0.8 * 0.0255;
    TEST_ASSERT_DOUBLE_WITHIN(1e-13, k * (24.0 * 0.9 - k * 40.0) / 0.6, in.motor_torque_nm[2]);
    TEST_ASSERT_EQUAL_DOUBLE(moving(RobotModel()).motor_torque_nm[0], in.motor_torque_nm[0]);
    const RobotInternals<double> all =
        moving(RobotModel().effect("torque_constant_error", "scale", 0.8));
    TEST_ASSERT_EQUAL_DOUBLE(in.motor_torque_nm[2], all.motor_torque_nm[2]);
}

/* ---- friction ---- */

static double smooth_sign(std::size_t i) {
    return std::tanh(kMoving[i] / 2.0);
}

static void friction_torques_are_as_documented(void) {
    const RobotInternals<double> in = moving(RobotModel());
    assert_shaft_torques(RobotModel().effect("coulomb_friction", "torque_nm", 0.02),
                         per_wheel([](auto i) { return -0.02 * smooth_sign(i); }));
    assert_shaft_torques(RobotModel().effect("stribeck_friction", "torque_nm", 0.02),
                         per_wheel([](auto i) {
                             const double ratio = kMoving[i] / 10.0;
                             return -0.02 * std::exp(-ratio * ratio) * smooth_sign(i);
                         }));
    assert_shaft_torques(
        RobotModel().effect("load_dependent_friction", "coefficient", 0.1),
        per_wheel([&](auto i) { return -0.1 * std::abs(in.motor_torque_nm[i]) * smooth_sign(i); }));
    assert_shaft_torques(
        RobotModel().effect("quadratic_wheel_drag", "coefficient", 1e-7),
        per_wheel([](auto i) { return -1e-7 * kMoving[i] * std::abs(kMoving[i]); }));
    assert_shaft_torques(
        RobotModel().effect("viscous_friction_error", "viscous_friction_nm_s", 1e-5),
        per_wheel([](auto i) { return -1e-5 * kMoving[i]; }));
    assert_shaft_torques(RobotModel().effect("one_wheel_drag", "torque_nm", 0.02, 2),
                         {0.0, -0.02 * smooth_sign(1), 0.0, 0.0});
}

static void asymmetric_friction_acts_in_the_positive_direction_only(void) {
    assert_shaft_torques(RobotModel()
                             .effect("asymmetric_friction", "torque_nm", 0.01)
                             .effect("asymmetric_friction", "viscous_nm_s", 1e-5),
                         per_wheel([](auto i) {
                             const double sign = smooth_sign(i);
                             return -(0.01 + 1e-5 * kMoving[i]) * sign * (1.0 + sign) / 2.0;
                         }));
}

static void cogging_repeats_with_the_shaft_angle(void) {
    assert_shaft_torques(
        RobotModel().effect("cogging", "torque_nm", 0.02).effect("cogging", "phase_rad", 0.4),
        per_wheel([](auto i) { return -0.02 * std::sin(7.0 * kMoving[4 + i] + 0.4); }));
}

/* The shafts turn by 2 mN m / (J (7 W)^2) to and fro: of 1e-4 rad at 894 rad/s and less beyond. */
static void cogging_fades_where_no_encoder_shows_it(void) {
    const double u = (std::pow(7.0 * 150.0, 2) * 2.5e-5 * 1e-4 / 0.002 - 1.0) / 1.25;
    const std::array<double, 4> left = {0.0, 1.0 - u * u * (3.0 - 2.0 * u), 1.0, 1.0};
    assert_shaft_torques(RobotModel().effect("cogging", "torque_nm", 0.002), per_wheel([&](auto i) {
                             return -0.002 * left[i] * std::sin(7.0 * kMoving[4 + i]);
                         }));
}

static void shaft_inertia_divides_the_shaft_acceleration(void) {
    const Robot::State believed = acceleration(RobotModel());
    const Robot::State heavy =
        acceleration(RobotModel().effect("motor_inertia_error", "inertia_kg_m2", 2.5e-5));
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, believed[i] / 2.0, heavy[i]);
    }
}

/* ---- wheels and contact ---- */

static void grip_effects_scale_the_drive_force(void) {
    assert_force_factors(RobotModel().effect("low_grip", "scale", 0.7), {0.7, 0.7, 0.7, 0.7});
    assert_force_factors(RobotModel().effect("uneven_grip", "scale", 0.7, 2), {1, 0.7, 1, 1});
    assert_force_factors(RobotModel().effect("grip_drift", "rate_1_s", 0.02),
                         {0.95, 0.95, 0.95, 0.95});
    const RobotInternals<double> in = moving(RobotModel());
    assert_force_factors(RobotModel().effect("grip_falloff", "fraction", 0.3),
                         per_wheel([&](auto i) {
                             const double ratio = in.slip_m_s[i] / 0.3;
                             return 1.0 - 0.3 * (1.0 - std::exp(-ratio * ratio));
                         }));
    assert_force_factors(
        RobotModel().effect("roller_ripple", "amplitude", 0.2),
        per_wheel([](auto i) { return 1.0 + 0.2 * std::sin(12.0 * kMoving[4 + i] / 12.0); }));
}

static void slip_stiffness_scales_the_slip(void) {
    const RobotInternals<double> in = moving(RobotModel());
    const auto believed = [&](auto i) { return 2.0 / kPi * std::atan(40.0 * in.slip_m_s[i]); };
    assert_force_factors(RobotModel().effect("slip_stiffness_error", "scale", 0.5),
                         per_wheel([&](auto i) {
                             return 2.0 / kPi * std::atan(20.0 * in.slip_m_s[i]) / believed(i);
                         }));
}

/* (1 - b - c - d - e - f - g - h) atan law + b tanh(x) + c brush + d x / sqrt(1 + x^2) +
 * e (1 - exp(-|x|)) + f x / (1 + |x|) + g min(x, 1) + h sin(1.4 atan(x / 1.4)), x = (2/pi) k s:
 * equal slope at rest; the brush sticks with a part of its length, 1 - |x|/3, until x = 3. */
static double bent(double speed_m_s) {
    const double x = 2.0 / kPi * 40.0 * speed_m_s;
    const double sticks = std::max(1.0 - std::abs(x) / 3.0, 0.0);
    const double brush = std::copysign(1.0 - std::pow(sticks, 3.0), x);
    const double exponential = std::copysign(1.0 - std::exp(-std::abs(x)), x);
    const double straight = std::copysign(std::min(std::abs(x), 1.0), x);
    return 0.03 * 2.0 / kPi * std::atan(40.0 * speed_m_s) + 0.4 * std::tanh(x) + 0.3 * brush +
           0.1 * x / std::sqrt(1.0 + x * x) + 0.05 * exponential + 0.07 * x / (1.0 + std::abs(x)) +
           0.03 * straight + 0.02 * std::sin(1.4 * std::atan(x / 1.4));
}

/* The rollers take the share `roller` of the change of the law. */
static void assert_bends(double roller) {
    const RobotInternals<double> in = moving(RobotModel()
                                                 .effect("contact_shape", "blend", 0.4)
                                                 .effect("contact_shape", "brush", 0.3)
                                                 .effect("contact_shape", "root", 0.1)
                                                 .effect("contact_shape", "exponential", 0.05)
                                                 .effect("contact_shape", "rational", 0.07)
                                                 .effect("contact_shape", "straight", 0.03)
                                                 .effect("contact_shape", "peaked", 0.02)
                                                 .effect("contact_shape", "roller", roller));
    for (int i = 0; i < 4; ++i) {
        const double across = in.roller_speed_m_s[i];
        const double straight = 2.0 / kPi * std::atan(40.0 * across);
        const double law = straight + roller * (bent(across) - straight);
        TEST_ASSERT_DOUBLE_WITHIN(1e-11, kLoad_n * 0.6 * bent(in.slip_m_s[i]), in.drive_force_n[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-11, -kLoad_n * 0.05 * law, in.roller_force_n[i]);
    }
}

static void contact_shape_bends_the_drive_and_a_share_of_the_rollers(void) {
    assert_bends(0.0);
    assert_bends(0.4);
    assert_bends(1.0);
}

static void carpet_grips_by_the_world_direction_of_the_drive_axis(void) {
    const double bearing[4] = {30.0, 150.0, 210.0, 330.0};
    assert_force_factors(RobotModel()
                             .effect("carpet_anisotropy", "cos2", 0.2)
                             .effect("carpet_anisotropy", "sin2", -0.1),
                         per_wheel([&](auto i) {
                             const double g = bearing[i] * kPi / 180.0 + 0.8;
                             const double p = std::atan2(std::cos(g), -std::sin(g));
                             return 1.0 + 0.2 * std::cos(2.0 * p) - 0.1 * std::sin(2.0 * p);
                         }));
}

static void patch_is_slippery_inside_only(void) {
    const RobotModel patch = RobotModel().effect("slippery_patch", "scale", 0.5);
    assert_force_factors(patch, {0.5, 0.5, 0.5, 0.5});
    assert_force_factors(RobotModel(patch).effect("slippery_patch", "x_min_m", 0.2),
                         {0.5, 0.5, 0.5, 0.5});
    assert_force_factors(RobotModel(patch).effect("slippery_patch", "x_min_m", 0.4), {1, 1, 1, 1});
    assert_force_factors(RobotModel(patch).effect("slippery_patch", "x_max_m", 0.2), {1, 1, 1, 1});
    assert_force_factors(RobotModel(patch).effect("slippery_patch", "y_min_m", -0.5), {1, 1, 1, 1});
    assert_force_factors(RobotModel(patch).effect("slippery_patch", "y_max_m", -0.7), {1, 1, 1, 1});
}

static void radius_enters_slip_and_reaction(void) {
    const RobotInternals<double> believed = moving(RobotModel());
    const auto assert_slip = [&](const RobotModel &model, double scale) {
        const double slip = believed.slip_m_s[0] + (scale - 1.0) * 0.05 * kMoving[0] / 12.0;
        TEST_ASSERT_DOUBLE_WITHIN(1e-13, slip, moving(model).slip_m_s[0]);
    };
    assert_slip(RobotModel().effect("wheel_radius_error", "scale", 0.9), 0.9);
    assert_slip(RobotModel().effect("wheel_radius_error", "scale", 0.9, 2), 1.0);
    assert_slip(RobotModel()
                    .effect("wheel_eccentricity", "amplitude", 0.1, 1)
                    .effect("wheel_eccentricity", "phase_rad", 0.3, 1),
                1.0 + 0.1 * std::sin(5.0 / 12.0 + 0.3));
}

static void wheel_mounted_turned_drives_in_another_direction(void) {
    const RobotInternals<double> in =
        moving(RobotModel().effect("wheel_angle_error", "angle_rad", 0.1, 1));
    const double g = kPi / 6.0 + 0.1, x = 0.2 * kHalfSqrt3, y = 0.1;
    const double hub_x = 0.9 - 1.5 * y, hub_y = -0.4 + 1.5 * x; /* velocity of the hub */
    TEST_ASSERT_DOUBLE_WITHIN(1e-13, -hub_x * std::sin(g) + hub_y * std::cos(g),
                              in.hub_speed_m_s[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-13, hub_x * std::cos(g) + hub_y * std::sin(g),
                              in.roller_speed_m_s[0]);
    TEST_ASSERT_EQUAL_DOUBLE(moving(RobotModel()).hub_speed_m_s[1], in.hub_speed_m_s[1]);
}

static void wheel_distance_is_the_lever_of_the_turn(void) {
    const RobotInternals<double> believed = moving(RobotModel());
    const RobotInternals<double> in =
        moving(RobotModel().effect("wheel_distance_error", "scale", 1.1));
    TEST_ASSERT_DOUBLE_WITHIN(1e-13, believed.hub_speed_m_s[0] + 0.02 * 1.5, in.hub_speed_m_s[0]);
}

static void roller_friction_adds_to_the_coefficient(void) {
    const double ratio =
        moving(RobotModel().effect("roller_friction", "mu", 0.03)).roller_force_n[0] /
        moving(RobotModel()).roller_force_n[0];
    TEST_ASSERT_DOUBLE_WITHIN(1e-13, 0.08 / 0.05, ratio);
}

/* The floor holds the body back; shaft and slip know nothing of it. */
static void rolling_resistance_brakes_the_body_and_not_the_shaft(void) {
    const RobotModel model = RobotModel().effect("rolling_resistance", "coefficient", 0.02);
    const RobotInternals<double> in = moving(RobotModel());
    const Robot::State believed = acceleration(RobotModel()), braked = acceleration(model);
    double force_x_n = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
        const double drive_x = i < 2 ? -0.5 : 0.5;
        force_x_n -= drive_x * 0.02 * kLoad_n * std::tanh(in.hub_speed_m_s[i] / 0.02);
        TEST_ASSERT_EQUAL_DOUBLE(believed[i], braked[i]);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, force_x_n / 20.0,
                              braked[Layout::kVelocity] - believed[Layout::kVelocity]);
}

/* ---- loads ---- */

static const double kWheelX[4] = {0.2 * kHalfSqrt3, -0.2 * kHalfSqrt3, -0.2 * kHalfSqrt3,
                                  0.2 * kHalfSqrt3};
static const double kWheelY[4] = {0.1, 0.1, -0.1, -0.1};

struct LoadBalance {
    double sum_n, moment_x_nm, moment_y_nm; /* sum N, sum N x, sum N y */
};

static LoadBalance balance_of(const RobotInternals<double> &in) {
    LoadBalance balance{0.0, 0.0, 0.0};
    for (int i = 0; i < 4; ++i) {
        balance.sum_n += in.load_n[i];
        balance.moment_x_nm += in.load_n[i] * kWheelX[i];
        balance.moment_y_nm += in.load_n[i] * kWheelY[i];
    }
    return balance;
}

/* Force of the floor on the body, in the body frame. */
static std::array<double, 2> floor_force_n(const RobotInternals<double> &in) {
    std::array<double, 2> force{};
    for (int i = 0; i < 4; ++i) {
        const double drive_x = -kWheelY[i] / 0.2, drive_y = kWheelX[i] / 0.2;
        force[0] += in.drive_force_n[i] * drive_x + in.roller_force_n[i] * drive_y;
        force[1] += in.drive_force_n[i] * drive_y - in.roller_force_n[i] * drive_x;
    }
    return force;
}

/* About the centre of gravity, h above the floor: sum N (x - cx) = -h Fx, and alike for y. */
static void assert_loads_carry_the_robot(const RobotModel &model, double height_m, double cog_x_m,
                                         double cog_y_m) {
    const RobotInternals<double> in = moving(model);
    const LoadBalance balance = balance_of(in);
    const std::array<double, 2> force_n = floor_force_n(in);
    const double weight_n = 20.0 * 9.81;
    TEST_ASSERT_DOUBLE_WITHIN(1e-11, weight_n, balance.sum_n);
    TEST_ASSERT_DOUBLE_WITHIN(1e-11, weight_n * cog_x_m - height_m * force_n[0],
                              balance.moment_x_nm);
    TEST_ASSERT_DOUBLE_WITHIN(1e-11, weight_n * cog_y_m - height_m * force_n[1],
                              balance.moment_y_nm);
}

static void loads_carry_the_robot_in_every_case(void) {
    const RobotModel high = RobotModel().effect("load_transfer", "cog_height_m", 0.15);
    const RobotModel off =
        RobotModel(high).effect("cog_offset", "x_m", 0.02).effect("cog_offset", "y_m", -0.03);
    assert_loads_carry_the_robot(RobotModel(), 0.0, 0.0, 0.0);
    assert_loads_carry_the_robot(high, 0.15, 0.0, 0.0);
    assert_loads_carry_the_robot(off, 0.15, 0.02, -0.03);
    assert_loads_carry_the_robot(RobotModel(off).effect("diagonal_load_bias", "force_n", 9.0), 0.15,
                                 0.02, -0.03);
}

/* The others balance it: three wheels leave nothing free, two across from each other neither. */
static void lifted_wheels_load_goes_to_the_others(void) {
    const RobotModel high = RobotModel().effect("load_transfer", "cog_height_m", 0.15);
    const RobotModel off =
        RobotModel(high).effect("cog_offset", "x_m", 0.02).effect("cog_offset", "y_m", -0.03);
    for (const double bias_n : {-60.0, 20.0, 60.0}) {
        const RobotModel tilted = RobotModel(off).effect("diagonal_load_bias", "force_n", bias_n);
        int lifted = 0;
        for (const double load_n : moving(tilted).load_n) {
            TEST_ASSERT_TRUE(load_n >= 0.0);
            lifted += load_n < 1e-11;
        }
        TEST_ASSERT_EQUAL_INT(1, lifted);
        assert_loads_carry_the_robot(tilted, 0.15, 0.02, -0.03);
    }
    const RobotInternals<double> on_two =
        moving(RobotModel().effect("diagonal_load_bias", "force_n", 60.0));
    for (int i = 0; i < 4; ++i)
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, kNull[i] > 0 ? 2.0 * kLoad_n : 0.0, on_two.load_n[i]);
}

/* A slope pulls at the centre of gravity as gravity does: what tips the robot is the floor's
 * force alone, so a robot that slides freely downhill keeps its loads. */
static void slope_alone_does_not_shift_load(void) {
    const RobotModel slope = RobotModel()
                                 .effect("load_transfer", "cog_height_m", 0.15)
                                 .effect("floor_slope", "x_m_s2", 1.0)
                                 .effect("floor_slope", "y_m_s2", -0.7);
    assert_loads_carry_the_robot(slope, 0.15, 0.0, 0.0);
}

static void accelerating_robot_leans_on_its_rear_wheels(void) {
    Robot robot(RobotModel().effect("load_transfer", "cog_height_m", 0.1));
    robot.x = {-100.0, -100.0, 100.0, 100.0};
    robot.derivative(kCoast);
    TEST_ASSERT_TRUE(robot.in.load_n[0] < kLoad_n && robot.in.load_n[3] < kLoad_n);
    TEST_ASSERT_TRUE(robot.in.load_n[1] > kLoad_n && robot.in.load_n[2] > kLoad_n);
}

/* A wheel that pulled at the floor from above would drive the robot the wrong way. */
static void wheels_of_a_tipping_robot_carry_nothing(void) {
    Robot robot(RobotModel()
                    .effect("cog_offset", "x_m", -0.1)
                    .effect("load_transfer", "cog_height_m", 0.3));
    robot.x = {-100.0, -100.0, 100.0, 100.0};
    robot.derivative(kCoast);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, robot.in.load_n[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, robot.in.load_n[3]);
    TEST_ASSERT_TRUE(robot.in.load_n[1] > kLoad_n && robot.in.load_n[2] > kLoad_n);
}

static void diagonal_bias_loads_wheels_one_and_three(void) {
    const RobotInternals<double> in =
        moving(RobotModel().effect("diagonal_load_bias", "force_n", 9.0));
    for (int i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, kLoad_n + 9.0 * kNull[i], in.load_n[i]);
    }
}

/* ---- body ---- */

static RobotModel on_ice() {
    return RobotModel().set("contact.mu_drive", 0.0).set("contact.mu_roller", 0.0);
}

/* Without a force the centre of gravity goes straight, however the wheel centre circles it. */
static void centre_of_gravity_flies_straight(void) {
    Robot robot(on_ice().effect("cog_offset", "x_m", 0.05).effect("cog_offset", "y_m", 0.02));
    robot.x[Layout::kVelocity + 1] = 0.5;
    robot.x[Layout::kVelocity + 2] = 4.0;
    robot.drive(kCoast, 1.5);
    const double theta = robot.x[Layout::kPose + 2];
    const double cog_x = robot.x[Layout::kPose] + 0.05 * std::cos(theta) - 0.02 * std::sin(theta);
    const double cog_y =
        robot.x[Layout::kPose + 1] + 0.05 * std::sin(theta) + 0.02 * std::cos(theta);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 6.0, theta);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.05 + 1.5 * (-4.0 * 0.02), cog_x);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.02 + 1.5 * (0.5 + 4.0 * 0.05), cog_y);
}

static void slope_accelerates_along_the_world_axes(void) {
    Robot robot(
        on_ice().effect("floor_slope", "x_m_s2", 0.4).effect("floor_slope", "y_m_s2", -0.2));
    robot.x[Layout::kPose + 2] = 1.1;
    robot.x[Layout::kVelocity + 2] = 2.0;
    robot.drive(kCoast, 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.2, robot.x[Layout::kPose]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -0.1, robot.x[Layout::kPose + 1]);
}

static void body_drag_decays_with_its_time_constant(void) {
    Robot robot(on_ice().effect("body_drag", "coefficient_n_s_m", 10.0));
    robot.x[Layout::kVelocity] = 1.0;
    robot.drive(kCoast, 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, std::exp(-0.5), robot.x[Layout::kVelocity]);
}

static void quadratic_drag_decays_as_one_over_time(void) {
    Robot robot(on_ice().effect("quadratic_body_drag", "coefficient", 10.0));
    robot.x[Layout::kVelocity] = 1.2;
    robot.x[Layout::kVelocity + 1] = -1.6;
    robot.drive(kCoast, 1.0);
    const double share = 1.0 / (1.0 + 2.0 * 10.0 / 20.0 * 1.0); /* v = v0 / (1 + v0 c t / m) */
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, 1.2 * share, robot.x[Layout::kVelocity]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, -1.6 * share, robot.x[Layout::kVelocity + 1]);
}

static void tether_swings_about_its_anchor(void) {
    Robot robot(on_ice()
                    .effect("tether_spring", "stiffness_n_m", 80.0)
                    .effect("tether_spring", "x_m", 1.0)
                    .effect("tether_spring", "y_m", 0.5));
    robot.x[Layout::kVelocity + 2] = 3.0;
    robot.drive(kCoast, kPi / 2.0); /* half a period of sqrt(k / m) = 2 rad/s */
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, 2.0, robot.x[Layout::kPose]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, 1.0, robot.x[Layout::kPose + 1]);
}

static void yaw_scrub_opposes_the_turn(void) {
    const Robot::State believed = acceleration(RobotModel());
    const Robot::State scrubbed = acceleration(RobotModel().effect("yaw_scrub", "torque_nm", 0.4));
    TEST_ASSERT_DOUBLE_WITHIN(1e-11, -0.4 * std::tanh(1.5 / 0.05) / 0.55,
                              scrubbed[Layout::kVelocity + 2] - believed[Layout::kVelocity + 2]);
}

static void payload_adds_mass_and_load_but_no_inertia(void) {
    const RobotModel loaded = RobotModel().effect("payload", "mass_kg", 5.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 25.0 * 9.81 / 4.0, moving(loaded).load_n[0]);
    const double ratio = acceleration(loaded)[Layout::kVelocity + 2] /
                         acceleration(RobotModel())[Layout::kVelocity + 2];
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 25.0 / 20.0, ratio);
}

static void inertia_error_adds_inertia(void) {
    const RobotModel slow = RobotModel().effect("inertia_error", "inertia_kg_m2", 0.11);
    const double ratio = acceleration(slow)[Layout::kVelocity + 2] /
                         acceleration(RobotModel())[Layout::kVelocity + 2];
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.55 / 0.66, ratio);
}

/* ---- sensors ---- */

/* Gyro and pose that the sensors show in the state kMoving at 2.5 s. */
static std::array<double, 4> shown(const RobotModel &model) {
    const Robot robot(model);
    double y[Layout::kOutputs];
    robot.plant.output(kMoving.data(), 2.5, y);
    return {y[4], y[5], y[6], y[7]};
}

static void assert_shown(const RobotModel &model, const std::array<double, 4> &expected) {
    const std::array<double, 4> y = shown(model);
    for (std::size_t j = 0; j < 4; ++j) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, expected[j], y[j]);
    }
}

static const double kWorldX_m_s = 0.9 * std::cos(0.8) + 0.4 * std::sin(0.8);
static const double kWorldY_m_s = 0.9 * std::sin(0.8) - 0.4 * std::cos(0.8);

static void sensors_show_the_state(void) {
    assert_shown(RobotModel(), {1.5, 0.3, -0.6, 0.8});
    assert_shown(RobotModel().effect("gyro_bias", "rate_rad_s", 0.1), {1.6, 0.3, -0.6, 0.8});
    assert_shown(RobotModel().effect("gyro_scale", "scale", 1.02), {1.53, 0.3, -0.6, 0.8});
}

static void late_camera_turns_back_the_way_since(void) {
    const Robot late(RobotModel().effect("pose_latency", "delay_s", 0.02));
    const Robot early(RobotModel().effect("pose_latency", "delay_s", -0.02));
    const double since[3] = {0.03, -0.05, 0.07};
    double y[Layout::kOutputs];
    late.plant.output(kMoving.data(), 2.5, y, since);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.3 - 0.03, y[5]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, -0.6 + 0.05, y[6]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.8 - 0.07, y[7]);
    early.plant.output(kMoving.data(), 2.5, y, since);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.3 + 0.02 * kWorldX_m_s, y[5]);
}

static void way_since_a_moment_is_even_between_rows_and_nothing_before_them(void) {
    const double time_s[4] = {1.0, 1.1, 1.3, 1.4};
    const double way[12] = {0.0, 0.0, 0.0, 1.0, -2.0, 3.0, 2.0, -3.0, 3.5, 4.0, -4.0, 3.75};
    const double late_s[5] = {0.0, 0.1, 0.15, 0.2, 9.0};
    const double expected[5][3] = {{0.0, 0.0, 0.0},
                                   {2.0, -1.0, 0.25},
                                   {2.25, -1.25, 0.375},
                                   {2.5, -1.5, 0.5},
                                   {4.0, -4.0, 3.75}};
    for (int j = 0; j < 5; ++j) {
        double since[3];
        way_since(time_s, way, 3, late_s[j], since);
        for (int c = 0; c < 3; ++c)
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected[j][c], since[c]);
    }
}

/* Where the way is not known: to first order in the delay. */
static void late_camera_shows_where_the_robot_was(void) {
    const double late = 0.02, skewed = 0.004 * 2.5;
    assert_shown(RobotModel().effect("pose_latency", "delay_s", late),
                 {1.5, 0.3 - late * kWorldX_m_s, -0.6 - late * kWorldY_m_s, 0.8 - late * 1.5});
    assert_shown(
        RobotModel().effect("clock_skew", "fraction", 0.004),
        {1.5, 0.3 - skewed * kWorldX_m_s, -0.6 - skewed * kWorldY_m_s, 0.8 - skewed * 1.5});
}

static void turned_camera_turns_the_position_and_not_the_heading(void) {
    const double c = std::cos(0.3), s = std::sin(0.3);
    assert_shown(RobotModel().effect("pose_rotation", "angle_rad", 0.3),
                 {1.5, c * 0.3 + s * 0.6, s * 0.3 - c * 0.6, 0.8});
}

/* A turned camera turns whatever there is to see, late or not. */
static void turned_camera_with_a_skewed_clock_turns_the_late_pose(void) {
    const RobotModel skewed = RobotModel().effect("clock_skew", "fraction", 0.004);
    const std::array<double, 4> late = shown(skewed);
    const double c = std::cos(0.3), s = std::sin(0.3);
    assert_shown(RobotModel(skewed).effect("pose_rotation", "angle_rad", 0.3),
                 {1.5, c * late[1] - s * late[2], s * late[1] + c * late[2], late[3]});
}

static void encoders_lose_and_gain_counts(void) {
    const Robot::State scaled = acceleration(RobotModel().effect("encoder_scale", "scale", 1.1, 2));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.1 * -150.0, scaled[Layout::kAngle + 1]);
    TEST_ASSERT_EQUAL_DOUBLE(300.0, scaled[Layout::kAngle]);
    const Robot::State lost = acceleration(RobotModel().effect("encoder_dropout", "fraction", 0.2));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.8 * 300.0, lost[Layout::kAngle]);
    TEST_ASSERT_EQUAL_DOUBLE(-150.0, lost[Layout::kAngle + 1]); /* 150 is not above 150 */
}

/* What sensors show does not move the robot. */
static void sensors_do_not_act_on_the_motion(void) {
    Robot plain, misled(RobotModel()
                            .effect("encoder_scale", "scale", 0.9)
                            .effect("encoder_dropout", "fraction", 0.2)
                            .effect("gyro_bias", "rate_rad_s", 0.3)
                            .effect("pose_latency", "delay_s", 0.02)
                            .effect("pose_rotation", "angle_rad", 0.3));
    plain.drive(kDuty, 1.0);
    misled.drive(kDuty, 1.0);
    for (std::size_t i = Layout::kVelocity; i < Layout::kStates; ++i) {
        TEST_ASSERT_EQUAL_DOUBLE(plain.x[i], misled.x[i]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(neutral_effect_leaves_the_robot_bit_for_bit);
    RUN_TEST(neutral_effect_leaves_the_axis_bit_for_bit);
    RUN_TEST(effect_with_values_but_switched_off_does_nothing);
    RUN_TEST(robot_at_rest_stays_at_rest_with_all_effects);
    RUN_TEST(sagging_bus_is_in_balance);
    RUN_TEST(sagging_bus_is_in_balance_with_limited_current);
    RUN_TEST(sagging_bus_is_in_balance_with_a_freewheeling_driver);
    RUN_TEST(current_follows_duty_voltage_and_back_emf);
    RUN_TEST(current_limit_clips_both_ways);
    RUN_TEST(freewheel_acts_only_while_the_command_keeps_its_sign);
    RUN_TEST(driver_bends_the_duty);
    RUN_TEST(battery_runs_down_with_time);
    RUN_TEST(battery_runs_down_within_an_interval);
    RUN_TEST(weak_motor_scales_both_constants_of_its_wheel);
    RUN_TEST(friction_torques_are_as_documented);
    RUN_TEST(asymmetric_friction_acts_in_the_positive_direction_only);
    RUN_TEST(cogging_repeats_with_the_shaft_angle);
    RUN_TEST(cogging_fades_where_no_encoder_shows_it);
    RUN_TEST(shaft_inertia_divides_the_shaft_acceleration);
    RUN_TEST(grip_effects_scale_the_drive_force);
    RUN_TEST(slip_stiffness_scales_the_slip);
    RUN_TEST(contact_shape_bends_the_drive_and_a_share_of_the_rollers);
    RUN_TEST(carpet_grips_by_the_world_direction_of_the_drive_axis);
    RUN_TEST(patch_is_slippery_inside_only);
    RUN_TEST(radius_enters_slip_and_reaction);
    RUN_TEST(wheel_mounted_turned_drives_in_another_direction);
    RUN_TEST(wheel_distance_is_the_lever_of_the_turn);
    RUN_TEST(roller_friction_adds_to_the_coefficient);
    RUN_TEST(rolling_resistance_brakes_the_body_and_not_the_shaft);
    RUN_TEST(loads_carry_the_robot_in_every_case);
    RUN_TEST(slope_alone_does_not_shift_load);
    RUN_TEST(accelerating_robot_leans_on_its_rear_wheels);
    RUN_TEST(lifted_wheels_load_goes_to_the_others);
    RUN_TEST(wheels_of_a_tipping_robot_carry_nothing);
    RUN_TEST(diagonal_bias_loads_wheels_one_and_three);
    RUN_TEST(centre_of_gravity_flies_straight);
    RUN_TEST(slope_accelerates_along_the_world_axes);
    RUN_TEST(body_drag_decays_with_its_time_constant);
    RUN_TEST(quadratic_drag_decays_as_one_over_time);
    RUN_TEST(tether_swings_about_its_anchor);
    RUN_TEST(yaw_scrub_opposes_the_turn);
    RUN_TEST(payload_adds_mass_and_load_but_no_inertia);
    RUN_TEST(inertia_error_adds_inertia);
    RUN_TEST(sensors_show_the_state);
    RUN_TEST(late_camera_turns_back_the_way_since);
    RUN_TEST(way_since_a_moment_is_even_between_rows_and_nothing_before_them);
    RUN_TEST(late_camera_shows_where_the_robot_was);
    RUN_TEST(turned_camera_turns_the_position_and_not_the_heading);
    RUN_TEST(turned_camera_with_a_skewed_clock_turns_the_late_pose);
    RUN_TEST(encoders_lose_and_gain_counts);
    RUN_TEST(sensors_do_not_act_on_the_motion);
    return UNITY_END();
}
