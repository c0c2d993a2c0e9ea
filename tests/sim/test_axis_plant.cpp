/* The single axis against closed forms. */
#include "tests/sim/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using namespace omnislip;

extern "C" void setUp() {}
extern "C" void tearDown() {}

static const Axis::Command kIdle = {0.0};

/* M v' = g u - (e + b) v: v = g u / (e + b) (1 - exp(-t / tau)), tau = M / (e + b). */
static void viscous_axis_steps_as_the_closed_form(void) {
    Axis axis(AxisModel()
                  .set("axis.inertia", 2.0)
                  .set("axis.input_gain", 3.0)
                  .set("axis.back_emf", 4.0)
                  .set("axis.viscous_friction", 6.0));
    axis.drive({5.0}, 0.3);
    const double decayed = std::exp(-0.3 / 0.2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, 1.5 * (1.0 - decayed), axis.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, 1.5 * (0.3 - 0.2 * (1.0 - decayed)), axis.x[1]);
}

/* Above the smoothing speed dry friction is constant: v = v0 - T t / M. */
static void dry_friction_decelerates_constantly(void) {
    for (const double direction : {1.0, -1.0}) {
        Axis axis(
            AxisModel().set("axis.inertia", 2.0).effect("coulomb_friction", "torque_nm", 3.0));
        axis.x[0] = direction * 4.0;
        axis.drive(kIdle, 2.0);
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, direction * 1.0, axis.x[0]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, direction * 5.0, axis.x[1]);
    }
}

/* Static friction is smoothed: below T the axis creeps at v = friction_speed atanh(F / T). */
static void pushed_below_its_dry_friction_the_axis_only_creeps(void) {
    Axis axis(AxisModel().effect("coulomb_friction", "torque_nm", 3.0));
    axis.drive({1.5}, 2.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.02 * std::atanh(0.5), axis.x[0]);
}

static void dry_friction_stops_the_axis_without_chatter(void) {
    Axis axis(AxisModel().set("axis.inertia", 0.01).effect("coulomb_friction", "torque_nm", 3.0));
    axis.x[0] = 1.0;
    axis.drive(kIdle, 0.5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, axis.x[0]);
}

/* The motor holds a load, friction grows with its force: F - load = c F tanh(v / friction_speed).
 */
static void axis_that_holds_a_load_creeps(void) {
    Axis axis(AxisModel()
                  .set("axis.inertia", 0.05)
                  .effect("load_dependent_friction", "coefficient", 0.5)
                  .effect("force_offset", "torque_nm", -2.8));
    axis.drive({3.0}, 0.5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.02 * std::atanh(0.2 / 1.5), axis.x[0]);
}

/* Hanging pendulum on a shaft: M q'' = -m g l sin q; small angle: q0 cos(w t), w^2 = m g l / M. */
static void pendulum_swings_with_its_small_angle_period(void) {
    const double inertia = 0.02, rate = std::sqrt(0.5 * 9.81 * 0.2 / inertia);
    Axis axis(AxisModel()
                  .set("axis.inertia", inertia)
                  .set("axis.pendulum_mass_kg", 0.5)
                  .set("axis.pendulum_length_m", 0.2));
    axis.x[1] = 1e-4;
    axis.drive(kIdle, 5.0 * 2.0 * kPi / rate);
    TEST_ASSERT_DOUBLE_WITHIN(1e-11, 1e-4, axis.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, 0.0, axis.x[0]);
}

/* Large swing: energy M v^2 / 2 + m g l (1 - cos q) is kept. */
static void pendulum_keeps_its_energy(void) {
    const double inertia = 0.02, torque = 0.5 * 9.81 * 0.2;
    Axis axis(AxisModel()
                  .set("axis.inertia", inertia)
                  .set("axis.pendulum_mass_kg", 0.5)
                  .set("axis.pendulum_length_m", 0.2));
    axis.x[1] = 2.5;
    axis.drive(kIdle, 3.0);
    const double energy =
        inertia * axis.x[0] * axis.x[0] / 2.0 + torque * (1.0 - std::cos(axis.x[1]));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, torque * (1.0 - std::cos(2.5)), energy);
}

static void constant_offset_force_accelerates(void) {
    Axis axis(AxisModel().set("axis.inertia", 2.0).effect("force_offset", "torque_nm", -1.0));
    axis.drive({3.0}, 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, axis.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, axis.x[1]);
}

static void inertia_and_payload_add_to_the_inertia(void) {
    Axis axis(AxisModel()
                  .set("axis.inertia", 2.0)
                  .effect("inertia_error", "inertia_kg_m2", 1.0)
                  .effect("payload", "mass_kg", 2.0));
    axis.drive({5.0}, 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, axis.x[0]);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(viscous_axis_steps_as_the_closed_form);
    RUN_TEST(dry_friction_decelerates_constantly);
    RUN_TEST(pushed_below_its_dry_friction_the_axis_only_creeps);
    RUN_TEST(dry_friction_stops_the_axis_without_chatter);
    RUN_TEST(axis_that_holds_a_load_creeps);
    RUN_TEST(pendulum_swings_with_its_small_angle_period);
    RUN_TEST(pendulum_keeps_its_energy);
    RUN_TEST(constant_offset_force_accelerates);
    RUN_TEST(inertia_and_payload_add_to_the_inertia);
    return UNITY_END();
}
