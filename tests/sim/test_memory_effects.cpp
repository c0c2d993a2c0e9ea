/* The effects with memory: closed forms, the limit in which they vanish, order of the step.
 *
 * A robot or rotor of "endless" inertia keeps its speed, so that one equation is left to compare.
 */
#include "tests/sim/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using namespace omnislip;

extern "C" void setUp() {}
extern "C" void tearDown() {}

using Layout = RobotLayout;
static const double kEndless = 1e9;
static const Robot::Command kRest = {0.0, 0.0, 0.0, 0.0};
static const Robot::Command kDuty = {0.6, -0.4, 0.9, 0.2};
static const Robot::State kMoving = {300.0, -150.0, 40.0, -3.0, 5.0, 11.0, -7.0,
                                     2.0,   0.9,    -0.4, 1.5,  0.3, -0.6, 0.8};
static const double kDriveInertia_kg_m2 = 2.5e-5 * 12.0 * 12.0; /* seen at the wheel */
static const double kReduced_kg_m2 = kLoadShare * (1.0 - kLoadShare) * kDriveInertia_kg_m2;

/* An axis of force 1 and mass 1 without friction. */
static AxisModel free_axis() {
    return AxisModel().set("axis.inertia", 1.0).set("axis.input_gain", 1.0);
}

/* Shaft speeds and body velocity stay as they are. */
static RobotModel unmoved() {
    return RobotModel()
        .set("motor.inertia_kg_m2", kEndless)
        .set("robot.mass_kg", kEndless)
        .set("contact.gravity_m_s2", 9.81 * 20.0 / kEndless)
        .set("robot.inertia_kg_m2", kEndless);
}

/* ---- driver ---- */

static void lagging_driver_follows_a_step_exponentially(void) {
    const double lag_s = 0.013, first = 0.2, second = 0.9, duration_s = 0.03;
    Axis axis(free_axis().effect("driver_lag", "time_constant_s", lag_s));
    axis.drive({first}, 0.1, 7e-3);
    const double before = axis.x[0];
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, first * 0.1, before);
    axis.drive({second}, duration_s, 7e-3);
    const double decay = std::exp(-duration_s / lag_s);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, second + (first - second) * decay,
                              axis.all[AxisPlant<double>::kCommanded]);
    const double momentum = second * duration_s + (first - second) * lag_s * (1.0 - decay);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, momentum, axis.x[0] - before);
}

static void lag_of_a_wheel_is_that_of_an_axis(void) {
    Robot robot(RobotModel().effect("driver_lag", "time_constant_s", 0.02, 3));
    robot.drive(kRest, 0.005);
    robot.drive(kDuty, 0.01);
    const double expected[4] = {0.6, -0.4, 0.9 * (1.0 - std::exp(-0.5)), 0.2};
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, expected[i], robot.all[Layout::kDrivenDuty + i]);
    }
}

/* Speed at `time_s` of the free axis under 0 before 0.1 s and 1 after, late by `delay_s`. */
static void delayed_step_starts_late(void) {
    for (const double delay_s : {0.001, 0.0137, 0.05, 0.1}) {
        Axis axis(free_axis().effect("actuation_delay", "delay_s", delay_s));
        axis.drive({0.0}, 0.1);
        for (int k = 1; k <= 20; ++k) {
            axis.drive({1.0}, 0.01);
            const double pushed_s = std::max(0.01 * k - delay_s, 0.0);
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, pushed_s, axis.x[0]);
        }
    }
}

static Robot::Command swaying(int k) {
    Robot::Command duty;
    for (std::size_t i = 0; i < 4; ++i)
        duty[i] = k < 1 ? 0.0 : 0.7 * std::sin(0.4 * k + 1.3 * static_cast<double>(i));
    return duty;
}

static void delay_of_whole_rows_shifts_the_trajectory(void) {
    Robot plain, late(RobotModel().effect("actuation_delay", "delay_s", 0.015));
    std::vector<Robot::State> path;
    for (int k = 0; k < 60; ++k) {
        plain.drive(swaying(k), 0.005);
        late.drive(swaying(k), 0.005);
        path.push_back(plain.x);
        if (k < 3)
            continue;
        for (std::size_t i = 0; i < 14; ++i) {
            const double expected = path[static_cast<std::size_t>(k - 3)][i];
            TEST_ASSERT_DOUBLE_WITHIN(1e-10 * (1.0 + std::abs(expected)), expected, late.x[i]);
        }
    }
}

/* ---- motor ---- */

static void current_rises_with_the_time_constant_of_the_winding(void) {
    const double inductance_h = 1.2e-3;
    Robot robot(unmoved().effect("armature_inductance", "inductance_h", inductance_h));
    robot.drive(kRest, 0.001);
    robot.drive(kDuty, 0.003);
    const double share = 1.0 - std::exp(-0.003 * 0.6 / inductance_h);
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, 24.0 * kDuty[i] / 0.6 * share,
                                  robot.all[Layout::kCoilCurrent + i]);
    }
}

static void sagging_bus_balances_the_late_current(void) {
    Robot robot(RobotModel()
                    .effect("armature_inductance", "inductance_h", 1e-3)
                    .effect("supply_sag", "source_resistance_ohm", 0.1));
    robot.drive(kRest, 0.001);
    robot.drive(kDuty, 0.002);
    RobotInternals<double> in;
    double dx[Layout::kAll], drawn_a = 0.0;
    look(robot.plant, robot.all.data(), kDuty.data(), robot.time_s, dx, in);
    for (std::size_t i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, robot.all[Layout::kCoilCurrent + i], in.current_a[i]);
        drawn_a += kDuty[i] * in.current_a[i];
    }
    TEST_ASSERT_TRUE(drawn_a > 5.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 24.0 - 0.1 * drawn_a, in.bus_v);
}

static void late_current_is_limited_when_it_flows(void) {
    Robot robot(unmoved()
                    .effect("armature_inductance", "inductance_h", 1e-3)
                    .effect("current_limit", "limit_a", 5.0));
    robot.drive(kRest, 0.001);
    robot.drive({1.0, 1.0, 1.0, 1.0}, 0.001);
    TEST_ASSERT_TRUE(robot.all[Layout::kCoilCurrent] > 5.0);
    TEST_ASSERT_EQUAL_DOUBLE(5.0, robot.in.current_a[0]);
}

static void warm_winding_draws_less_current(void) {
    const double coefficient = 0.01, heat = 30.0;
    Robot robot(unmoved().effect("winding_heating", "coefficient", coefficient, 2));
    robot.drive(kDuty, 0.001);
    robot.all[Layout::kHeat + 1] = heat;
    robot.drive(kDuty, 1e-6);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, -16.0 / (1.0 + coefficient * heat), robot.in.current_a[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 36.0, robot.in.current_a[2]);
}

static void winding_warms_towards_the_balance_with_its_cooling(void) {
    for (const double cooling_s : {60.0, 25.0}) {
        Robot robot(unmoved()
                        .effect("winding_heating", "coefficient", 1e-12)
                        .effect("winding_heating", "cooling_time_s", cooling_s));
        robot.drive(kDuty, 20.0, 0.01);
        for (std::size_t i = 0; i < 4; ++i) {
            const double current_a = 24.0 * kDuty[i] / 0.6;
            const double heat =
                current_a * current_a * cooling_s * (1.0 - std::exp(-20.0 / cooling_s));
            TEST_ASSERT_DOUBLE_WITHIN(1e-7 * heat, heat, robot.all[Layout::kHeat + i]);
        }
    }
}

/* ---- contact ---- */

/* dz/dt = pace (phi - z) / length at a slip and a speed that stay, or pace (s - z) / length. */
static void bristles_relax_with_the_distance(double rolling) {
    const double length_m = 2e-3, duration_s = 0.004;
    Robot robot(unmoved()
                    .effect("bristle_relaxation", "length_m", length_m)
                    .effect("bristle_relaxation", "rolling", rolling));
    robot.x = kMoving;
    robot.x[Layout::kVelocity + 2] = 0.0; /* or the body's velocity turns in its frame */
    robot.drive(kRest, 1e-6);
    for (int i = 0; i < 4; ++i)
        robot.all[static_cast<std::size_t>(Layout::kGrip + i)] = 0.0;
    robot.drive(kRest, duration_s);
    for (std::size_t i = 0; i < 4; ++i) {
        const double slip_m_s = robot.in.slip_m_s[i], hub_m_s = robot.in.hub_speed_m_s[i];
        const double law = 2.0 / kPi * std::atan(40.0 * slip_m_s);
        const double slipped_m_s = slip_m_s / law;
        const double rolled_m_s = std::abs(hub_m_s + slip_m_s) + std::abs(slip_m_s) + 0.02;
        const double share = std::min(rolling, 1.0);
        const double pace_m_s = (1.0 - share) * slipped_m_s + share * rolled_m_s;
        const double gained = 1.0 - std::exp(-pace_m_s * duration_s / length_m);
        const double goes_to = rolling > 1.5 ? slip_m_s : law;
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, goes_to * gained, robot.all[Layout::kGrip + i]);
    }
}

/* The law at the slip that is held, which has all but got there. */
static void force_of_a_slip_that_lags_is_that_of_the_law(void) {
    const double length_m = 2e-3;
    for (const double held : {0.5, 1.0}) {
        Robot robot(unmoved()
                        .effect("bristle_relaxation", "length_m", length_m)
                        .effect("bristle_relaxation", "rolling", 2.0));
        robot.x = kMoving;
        robot.x[Layout::kVelocity + 2] = 0.0;
        robot.drive(kRest, 1e-6);
        for (std::size_t i = 0; i < 4; ++i)
            robot.all[Layout::kGrip + i] = held * robot.in.slip_m_s[i];
        robot.drive(kRest, 1e-9);
        for (std::size_t i = 0; i < 4; ++i) {
            const double law = 2.0 / kPi * std::atan(40.0 * held * robot.in.slip_m_s[i]);
            const double force_n = 0.6 * robot.in.load_n[i] * law;
            TEST_ASSERT_DOUBLE_WITHIN(1e-4, force_n, robot.in.drive_force_n[i]);
        }
    }
}

static void bristles_relax_with_the_distance_slipped(void) {
    bristles_relax_with_the_distance(0.0);
}

static void tyres_relax_with_the_distance_rolled_too(void) {
    bristles_relax_with_the_distance(0.7);
    bristles_relax_with_the_distance(1.0);
}

static void slip_lags_with_the_distance_rolled(void) {
    bristles_relax_with_the_distance(2.0);
}

/* ---- gear ---- */

/* Without grip and motor: two inertias on a spring. */
static void compliant_shaft_rings_at_its_natural_frequency(void) {
    const double stiffness = 80.0, twist = 0.01;
    const double period_s = 2.0 * kPi / std::sqrt(stiffness / kReduced_kg_m2);
    Robot robot(RobotModel()
                    .set("contact.mu_drive", 0.0)
                    .set("motor.torque_constant_nm_a", 0.0)
                    .set("motor.viscous_friction_nm_s", 0.0)
                    .effect("shaft_compliance", "stiffness_nm_rad", stiffness)
                    .effect("shaft_compliance", "damping_nm_s_rad", 0.0));
    robot.drive(kRest, 1e-6);
    robot.all[Layout::kTwist] = twist;
    const double start_rad = robot.x[Layout::kAngle];
    robot.drive(kRest, period_s / 2.0, 1e-5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, -twist, robot.all[Layout::kTwist]);
    /* the motor's share of the swing, in angle of the shaft */
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, -2.0 * twist * kLoadShare * 12.0,
                              robot.x[Layout::kAngle] - start_rad);
    robot.drive(kRest, period_s / 2.0, 1e-5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, twist, robot.all[Layout::kTwist]);
}

static void damper_takes_the_energy_out_of_the_twist(void) {
    const double stiffness = 80.0, damping = 0.05, twist = 0.01;
    const double rate = damping / (2.0 * kReduced_kg_m2);
    const double damped = std::sqrt(stiffness / kReduced_kg_m2 - rate * rate);
    Robot robot(RobotModel()
                    .set("contact.mu_drive", 0.0)
                    .set("motor.torque_constant_nm_a", 0.0)
                    .set("motor.viscous_friction_nm_s", 0.0)
                    .effect("shaft_compliance", "stiffness_nm_rad", stiffness)
                    .effect("shaft_compliance", "damping_nm_s_rad", damping));
    robot.drive(kRest, 1e-6);
    robot.all[Layout::kTwist] = twist;
    robot.drive(kRest, 2.0 * kPi / damped, 1e-5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, twist * std::exp(-rate * 2.0 * kPi / damped),
                              robot.all[Layout::kTwist]);
}

/* From steady driving to steady braking the motor gains the play on the wheel, and what the teeth
 * give way under the torque that the road takes. */
static void lost_motion_of_a_reversal_is_the_play(void) {
    const double play = 0.02;
    const double tooth = kToothFrequency_rad_s * kToothFrequency_rad_s * kReduced_kg_m2;
    Robot robot(RobotModel()
                    .set("robot.mass_kg", kEndless)
                    .set("contact.gravity_m_s2", 9.81 * 20.0 / kEndless)
                    .set("robot.inertia_kg_m2", kEndless)
                    .effect("gear_backlash", "angle_rad", play));
    const auto steady_twist = [&](double duty, double &road_nm) {
        robot.drive({duty, duty, duty, duty}, 0.5);
        road_nm = 0.05 * robot.in.drive_force_n[0];
        return robot.all[Layout::kTwist];
    };
    double driving_nm, braking_nm;
    const double driving = steady_twist(0.1, driving_nm), braking = steady_twist(-0.1, braking_nm);
    TEST_ASSERT_TRUE(driving_nm > 0.5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, play + (driving_nm - braking_nm) / tooth, driving - braking);
}

/* Inside of the play the motor of an axis moves its own share of the inertia only. */
static void motor_is_alone_inside_of_the_play(void) {
    Axis axis(free_axis().effect("gear_backlash", "angle_rad", 1.0));
    axis.drive({0.0}, 0.1);
    axis.drive({1.0}, 0.5);
    const double expected_m_s = 0.5 / (1.0 - kLoadShare);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected_m_s, axis.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -expected_m_s, axis.all[AxisPlant<double>::kSlack]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, axis.x[1], axis.all[AxisPlant<double>::kTwist]);
}

/* The spectral radius of the shaft's equations as what their powers grow by. */
static double growth(double stiffness, double damping, double motor_1_s, double wheel_1_s,
                     double share) {
    const double motor = 1.0 - share; /* inertias of both sides, together 1 */
    double a[3][3] = {{-(damping + motor_1_s) / motor, damping / motor, -stiffness / motor},
                      {damping / share, -(damping + wheel_1_s) / share, stiffness / share},
                      {1.0, -1.0, 0.0}};
    double logarithm = 0.0, power = 1.0;
    for (int squared = 0; squared < 20; ++squared) {
        double product[3][3] = {}, size = 0.0;
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                for (int k = 0; k < 3; ++k)
                    product[i][j] += a[i][k] * a[k][j];
                size = std::max(size, std::abs(product[i][j]));
            }
        }
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j)
                a[i][j] = product[i][j] / size;
        }
        power *= 2.0;
        logarithm += std::log(size) / power;
    }
    return std::exp(logarithm);
}

/* Of an inertia of 1. */
static SoftGear<double> soft_gear(double stiffness, double damping, double share) {
    Constants<double, 1> c;
    forget(c);
    c.stiffness_nm_rad[0] = stiffness;
    c.damping_nm_s_rad[0] = damping;
    c.load_share[0] = share;
    SoftGear<double> gear;
    gear.prepare(c, 0, 1.0);
    return gear;
}

/* Ringing, dead-beat and bridged springs, weak and strong brakes on either side. */
static void rate_of_a_soft_gear_is_its_fastest_eigenvalue(void) {
    for (double share : {0.05, 0.2, 0.5, 0.9}) {
        for (double stiffness : {1e2, 1e4, 1e6}) {
            for (double ratio : {0.0, 0.3, 1.0, 4.0}) {
                for (double motor_1_s : {0.0, 7.0, 300.0}) {
                    for (double wheel_1_s : {0.0, 40.0, 2000.0}) {
                        const double reduced = share * (1.0 - share);
                        const double damping = 2.0 * ratio * std::sqrt(stiffness * reduced);
                        const SoftGear<double> gear = soft_gear(stiffness, damping, share);
                        const double closed =
                            growth(stiffness, damping, motor_1_s, wheel_1_s, share);
                        const double apart = std::max(motor_1_s / (1.0 - share), wheel_1_s / share);
                        const double fastest = std::max(closed, apart);
                        TEST_ASSERT_DOUBLE_WITHIN(1e-3 * fastest, fastest,
                                                  gear.rate_1_s(motor_1_s, wheel_1_s));
                    }
                }
            }
        }
    }
    const SoftGear<double> stiff = soft_gear(kUnbounded, 0.0, kLoadShare);
    TEST_ASSERT_EQUAL_DOUBLE(47.0, stiff.rate_1_s(7.0, 40.0));
}

/* Both sides together have the momentum that the motor was given. */
static void play_keeps_the_momentum(void) {
    Axis axis(free_axis().effect("gear_backlash", "angle_rad", 0.01));
    axis.drive({1.0}, 0.2);
    axis.drive({-1.0}, 0.5);
    const double motor = axis.x[0], wheel = motor + axis.all[AxisPlant<double>::kSlack];
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.2 - 0.5, (1.0 - kLoadShare) * motor + kLoadShare * wheel);
}

/* Two masses on a spring, pushed by F from rest: the centre of mass moves as the rigid axis does,
 * the twist is p F / k (1 - cos w t), w^2 = k / (p (1 - p) M), and p of it is the motor's lead. */
static AxisModel two_masses(double stiffness_n_m, double damping_n_s_m, double load_share) {
    return free_axis()
        .effect("shaft_compliance", "stiffness_nm_rad", stiffness_n_m)
        .effect("shaft_compliance", "damping_nm_s_rad", damping_n_s_m)
        .effect("shaft_compliance", "load_share", load_share);
}

static void motor_of_a_soft_axis_rings_about_the_rigid_motion(void) {
    const double stiffness = 400.0, force = 2.0, duration_s = 0.37;
    for (const double share : {0.1, 0.5, 0.8}) {
        Axis axis(two_masses(stiffness, 0.0, share));
        axis.drive({0.0}, 0.1);
        axis.drive({force}, duration_s);
        const double rate = std::sqrt(stiffness / (share * (1.0 - share)));
        const double twist = share * force / stiffness * (1.0 - std::cos(rate * duration_s));
        const double centre = force * duration_s * duration_s / 2.0;
        TEST_ASSERT_DOUBLE_WITHIN(1e-7, twist, axis.all[AxisPlant<double>::kTwist]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-7, centre + share * twist, axis.x[1]);
    }
}

static void damped_twist_of_an_axis_decays(void) {
    const double stiffness = 400.0, damping = 1.5, share = 0.3, twist = 0.01;
    const double reduced = share * (1.0 - share), rate = damping / (2.0 * reduced);
    const double damped = std::sqrt(stiffness / reduced - rate * rate);
    const double period_s = 2.0 * kPi / damped;
    Axis axis(two_masses(stiffness, damping, share));
    axis.drive({0.0}, 1e-6);
    axis.all[AxisPlant<double>::kTwist] = twist;
    axis.drive({0.0}, period_s);
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, twist * std::exp(-rate * period_s),
                              axis.all[AxisPlant<double>::kTwist]);
}

/* The stiffer the spring, the nearer the rigid axis: the motor leads it by p^2 F / k. */
static void stiff_axis_is_the_rigid_one(void) {
    const double force = 1.0, share = 0.2;
    for (const double stiffness : {1e3, 1e5, 1e8}) {
        Axis rigid(free_axis()), soft(two_masses(stiffness, 0.0, share));
        for (Axis *axis : {&rigid, &soft}) {
            axis->drive({0.0}, 0.1);
            axis->drive({force}, 0.2);
        }
        TEST_ASSERT_DOUBLE_WITHIN(2.001 * share * share * force / stiffness, rigid.x[1], soft.x[1]);
    }
}

/* Motor, spring and a pendulum behind it: nothing brakes. */
static void soft_pendulum_keeps_its_energy(void) {
    const double stiffness = 5.0, share = 0.6, inertia = 0.02, torque = 0.5 * 9.81 * 0.2;
    Axis axis(AxisModel()
                  .set("axis.inertia", inertia)
                  .set("axis.pendulum_mass_kg", 0.5)
                  .set("axis.pendulum_length_m", 0.2)
                  .effect("shaft_compliance", "stiffness_nm_rad", stiffness)
                  .effect("shaft_compliance", "damping_nm_s_rad", 0.0)
                  .effect("shaft_compliance", "load_share", share));
    const auto energy = [&] {
        const double motor = axis.x[0], load = motor + axis.all[AxisPlant<double>::kSlack];
        const double twist = axis.all[AxisPlant<double>::kTwist];
        return (1.0 - share) * inertia * motor * motor / 2.0 + share * inertia * load * load / 2.0 +
               stiffness * twist * twist / 2.0 + torque * (1.0 - std::cos(axis.x[1] - twist));
    };
    axis.x[1] = 2.5;
    axis.drive({0.0}, 1e-6);
    axis.all[AxisPlant<double>::kTwist] = 0.1;
    const double before = energy();
    axis.drive({0.0}, 2.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, before, energy());
}

/* ---- all ---- */

struct Tuning {
    const char *effect, *parameter;
    double vanishing, typical;
};
static const Tuning kTunings[] = {
    {"actuation_delay", "delay_s", 1e-9, 0.004},
    {"driver_lag", "time_constant_s", 1e-9, 0.004},
    {"armature_inductance", "inductance_h", 1e-10, 8e-4},
    {"winding_heating", "coefficient", 1e-10, 0.002},
    {"bristle_relaxation", "length_m", 1e-9, 0.001},
    {"gear_backlash", "angle_rad", 1e-9, 0.01},
    {"shaft_compliance", "stiffness_nm_rad", 1e7, 100.0},
};

static Robot::State driven(const RobotModel &model, double step_s) {
    Robot robot(model);
    for (int k = 0; k < 12; ++k)
        robot.drive(swaying(3 * k), 0.02, step_s);
    return robot.x;
}

static double apart(const Robot::State &a, const Robot::State &b) {
    double worst = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i)
        worst = std::max(worst, std::abs(a[i] - b[i]) / (1.0 + std::abs(a[i])));
    return worst;
}

/* Of a play that vanishes the teeth remain: a stiff shaft, but for the pulling of its damper. */
static void vanishing_memory_is_the_plant_without_it(void) {
    const double stiffness = kToothFrequency_rad_s * kToothFrequency_rad_s * kReduced_kg_m2;
    const double damping = 2.0 * kToothDampingRatio * kToothFrequency_rad_s * kReduced_kg_m2;
    const Robot::State rigid = driven(RobotModel(), 1e-4);
    const Robot::State teeth = driven(RobotModel()
                                          .effect("shaft_compliance", "stiffness_nm_rad", stiffness)
                                          .effect("shaft_compliance", "damping_nm_s_rad", damping),
                                      1e-4);
    for (const Tuning &t : kTunings) {
        const bool play = std::string(t.effect) == "gear_backlash";
        const RobotModel vanishing = RobotModel().effect(t.effect, t.parameter, t.vanishing);
        const RobotModel typical = RobotModel().effect(t.effect, t.parameter, t.typical);
        const double left = apart(play ? teeth : rigid, driven(vanishing, 1e-4));
        TEST_ASSERT_TRUE_MESSAGE(left < (play ? 2e-3 : 2e-5), t.effect);
        TEST_ASSERT_TRUE_MESSAGE(apart(rigid, driven(typical, 1e-4)) > 3e-2, t.effect);
    }
}

/* Both sides of the gear swing on closed teeth at their frequency and damping ratio. */
static void teeth_are_springs_of_their_frequency(void) {
    const double frequency = 800.0, ratio = 0.1;
    const Robot::State sprung = driven(
        RobotModel()
            .effect("shaft_compliance", "stiffness_nm_rad", frequency * frequency * kReduced_kg_m2)
            .effect("shaft_compliance", "damping_nm_s_rad",
                    2.0 * ratio * frequency * kReduced_kg_m2),
        1e-4);
    const RobotModel usual = RobotModel().effect("gear_backlash", "angle_rad", 1e-9);
    RobotModel other = usual;
    other.effect("gear_backlash", "tooth_frequency_rad_s", frequency)
        .effect("gear_backlash", "tooth_damping_ratio", ratio);
    const double left = apart(sprung, driven(other, 1e-4));
    TEST_ASSERT_TRUE(left < 2e-3);
    TEST_ASSERT_TRUE(apart(sprung, driven(usual, 1e-4)) > 5.0 * left);
}

/* Memory that has settled changes nothing but what comes later. */
static void settled_robot_accelerates_as_without_memory(void) {
    Robot plain;
    plain.x = kMoving;
    const Robot::State expected = plain.derivative(kDuty);
    for (const Tuning &t : kTunings) {
        Robot robot(RobotModel().effect(t.effect, t.parameter, t.typical));
        robot.x = kMoving;
        const Robot::State found = robot.derivative(kDuty);
        for (std::size_t i = 0; i < 14; ++i) {
            TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(1e-9 * (1.0 + std::abs(expected[i])), expected[i],
                                              found[i], t.effect);
        }
    }
}

/* Lags are of second order in the step, a spring of fourth; teeth that meet have no order. */
static void error_falls_with_the_square_of_the_step(void) {
    for (const Tuning &t : kTunings) {
        if (std::string(t.effect) == "gear_backlash")
            continue;
        const RobotModel model = RobotModel().effect(t.effect, t.parameter, t.typical);
        const Robot::State exact = driven(model, 1e-5);
        const double coarse = apart(exact, driven(model, 4e-4));
        const double fine = apart(exact, driven(model, 2e-4));
        TEST_ASSERT_TRUE_MESSAGE(coarse < 2e-3, t.effect);
        TEST_ASSERT_TRUE_MESSAGE(fine < coarse / 3.0, t.effect);
    }
}

static void step_of_a_gear_with_play_hardly_matters(void) {
    const RobotModel model = RobotModel().effect("gear_backlash", "angle_rad", 0.01);
    const Robot::State exact = driven(model, 1e-5);
    TEST_ASSERT_TRUE(apart(exact, driven(model, 1e-3)) < 1e-2);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(lagging_driver_follows_a_step_exponentially);
    RUN_TEST(lag_of_a_wheel_is_that_of_an_axis);
    RUN_TEST(delayed_step_starts_late);
    RUN_TEST(delay_of_whole_rows_shifts_the_trajectory);
    RUN_TEST(current_rises_with_the_time_constant_of_the_winding);
    RUN_TEST(sagging_bus_balances_the_late_current);
    RUN_TEST(late_current_is_limited_when_it_flows);
    RUN_TEST(warm_winding_draws_less_current);
    RUN_TEST(winding_warms_towards_the_balance_with_its_cooling);
    RUN_TEST(bristles_relax_with_the_distance_slipped);
    RUN_TEST(tyres_relax_with_the_distance_rolled_too);
    RUN_TEST(slip_lags_with_the_distance_rolled);
    RUN_TEST(force_of_a_slip_that_lags_is_that_of_the_law);
    RUN_TEST(compliant_shaft_rings_at_its_natural_frequency);
    RUN_TEST(damper_takes_the_energy_out_of_the_twist);
    RUN_TEST(lost_motion_of_a_reversal_is_the_play);
    RUN_TEST(motor_is_alone_inside_of_the_play);
    RUN_TEST(rate_of_a_soft_gear_is_its_fastest_eigenvalue);
    RUN_TEST(play_keeps_the_momentum);
    RUN_TEST(motor_of_a_soft_axis_rings_about_the_rigid_motion);
    RUN_TEST(damped_twist_of_an_axis_decays);
    RUN_TEST(stiff_axis_is_the_rigid_one);
    RUN_TEST(soft_pendulum_keeps_its_energy);
    RUN_TEST(vanishing_memory_is_the_plant_without_it);
    RUN_TEST(teeth_are_springs_of_their_frequency);
    RUN_TEST(settled_robot_accelerates_as_without_memory);
    RUN_TEST(error_falls_with_the_square_of_the_step);
    RUN_TEST(step_of_a_gear_with_play_hardly_matters);
    return UNITY_END();
}
