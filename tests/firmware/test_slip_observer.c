/* The slip observer, each of its four steps alone against its closed form. */
#include <string.h>
#include <unity.h>

#include "firmware/slip_observer.h"
#include "tests/firmware/reference.h"

static parameters p;
static slip_observer observer;

static const i16 nothing[4] = {0, 0, 0, 0};

/* Neither drag, inertia, rollers nor correction, until a test asks for them. */
void setUp(void) {
    parameters_set_defaults(&p);
    parameters_set(&p, PARAMETER_ID_drag_q14, 0);
    parameters_set(&p, PARAMETER_ID_momentum_per_tick_q10, 0);
    parameters_set(&p, PARAMETER_ID_roller_grip_q8, 0);
    parameters_set(&p, PARAMETER_ID_observer_gain_q15, 0);
    slip_observer_reset(&observer);
}

void tearDown(void) {}

static void run(const i16 voltage_v_q9[4], const i16 rim_m_s_q13[4], int ticks) {
    for (int n = 0; n < ticks; n++) {
        slip_observer_step(&observer, &p, voltage_v_q9, nothing, rim_m_s_q13);
    }
}

static void force_approaches_that_of_the_stalled_motor_as_a_low_pass(void) {
    const i16 one_volt[4] = {512, 0, 0, -512};
    run(one_volt, nothing, 5); /* 10.2 N (1 - 0.75^5) */
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 7.779, observer.force_n_q8[0] / 256.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, -7.779, observer.force_n_q8[3] / 256.0);
    TEST_ASSERT_EQUAL_INT16(0, observer.force_n_q8[1]);
}

/* A shaft that takes up all of the torque by accelerating leaves no force to the rim. */
static void force_that_accelerates_the_shaft_is_not_the_rims(void) {
    const i16 voltage[4] = {512, 512, 512, 512}; /* 10.2 N = 6 N s/rad * 1.7 rad/s per tick */
    i16 shaft_q5[4] = {0, 0, 0, 0};
    parameters_set(&p, PARAMETER_ID_momentum_per_tick_q10, 6144);
    for (int n = 1; n < 200; n++) {
        shaft_q5[0] = (i16)lround(1.7 * 32.0 * n);
        slip_observer_step(&observer, &p, voltage, shaft_q5, nothing);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 0.0, observer.force_n_q8[0] / 256.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 10.2, observer.force_n_q8[1] / 256.0);
}

/* 2 N of dry friction hold against the voltage of a shaft at rest, whichever way: of 10.2 N the
 * floor gets 8.2, and of 1 N nothing. */
static void dry_friction_at_rest_is_not_the_floors(void) {
    const i16 volts[4] = {512, -512, 50, -50};
    parameters_set(&p, PARAMETER_ID_coulomb_force_q8, 512);
    run(volts, nothing, 100);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 8.2, observer.force_n_q8[0] / 256.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, -8.2, observer.force_n_q8[1] / 256.0);
    TEST_ASSERT_EQUAL_INT16(0, observer.force_n_q8[2]);
    TEST_ASSERT_EQUAL_INT16(0, observer.force_n_q8[3]);
}

/* With all its parameters, from a memory that held anything. */
static void a_robot_at_rest_is_believed_at_rest_from_the_first_tick(void) {
    slip_observer rest;
    parameters_set_defaults(&p);
    memset(&observer, 0xA5, sizeof observer);
    memset(&rest, 0, sizeof rest);
    slip_observer_reset(&observer);
    run(nothing, nothing, 1);
    TEST_ASSERT_EQUAL_MEMORY(&rest, &observer, sizeof rest);
}

/* Newton: forward forces of 10.2 N per wheel are 4 * 10.2 / 2 N on 20 kg. */
static void known_forces_accelerate_the_body(void) {
    const i16 forward[4] = {-512, -512, 512, 512};
    kinematics_velocity v;
    run(forward, nothing, 503); /* the low-pass lags by 3 ticks */
    v = slip_observer_velocity(&observer);
    TEST_ASSERT_DOUBLE_WITHIN(0.003, 0.51, v.x_m_s_q13 / 8192.0);
    TEST_ASSERT_INT16_WITHIN(8, 0, v.y_m_s_q13);
    TEST_ASSERT_INT16_WITHIN(8, 0, v.omega_rad_s_q11);
}

/* To the left they are 4 * 10.2 sqrt 3 / 2 N. */
static void known_forces_accelerate_the_body_sideways(void) {
    const i16 left[4] = {512, -512, -512, 512};
    kinematics_velocity v;
    run(left, nothing, 503);
    v = slip_observer_velocity(&observer);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.8833, v.y_m_s_q13 / 8192.0);
    TEST_ASSERT_INT16_WITHIN(8, 0, v.x_m_s_q13);
    TEST_ASSERT_INT16_WITHIN(8, 0, v.omega_rad_s_q11);
}

/* Turning forces of 2 * 10.2 N at 0.2 m per pair: 8.16 N m on 0.55 kg m2. */
static void known_torque_turns_the_body(void) {
    const i16 turning[4] = {512, 512, 512, 512};
    run(turning, nothing, 103);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 1.4836,
                              slip_observer_velocity(&observer).omega_rad_s_q11 / 2048.0);
}

/* Without force the velocity keeps its direction in the world, so it turns against the body: after
 * a quarter turn, forward has become right. */
static void free_body_keeps_its_direction_in_the_world(void) {
    observer.x_m_s_q22 = 4194304;
    observer.omega_rad_s_q22 = 2 * 4194304;
    run(nothing, nothing, 785); /* 2 rad/s for pi/4 s */
    TEST_ASSERT_DOUBLE_WITHIN(0.003, 0.0, observer.x_m_s_q22 / 4194304.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.003, -1.0, observer.y_m_s_q22 / 4194304.0);
}

/* Wheels that roll without force are trusted in full: an error shrinks by 1 - g per tick. */
static void correction_converges_with_the_gain(void) {
    const kinematics_velocity truth = {8192, -4096, 0};
    i16 rim[4];
    kinematics_inverse(&p, &truth, rim);
    parameters_set(&p, PARAMETER_ID_observer_gain_q15, 3277); /* 0.1 */
    run(nothing, rim, 10);                                    /* 1 - 0.9^10 = 0.6513 */
    TEST_ASSERT_DOUBLE_WITHIN(0.003, 0.6513, observer.x_m_s_q22 / 4194304.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.003, -0.3257, observer.y_m_s_q22 / 4194304.0);
    run(nothing, rim, 300);
    TEST_ASSERT_INT16_WITHIN(2, 8192, slip_observer_velocity(&observer).x_m_s_q13);
}

/* A body held at rest: rims turn at the slip that their 20 N need, and all of it is explained as
 * slip. The smallest parameter keeps Newton out, which cannot know who holds the body. */
static void slip_explains_rims_that_turn_while_the_body_stands(void) {
    const double slip_m_s = tan(REFERENCE_PI / 2.0 * 20.0 / 29.43) / 40.0;
    const i16 volts = (i16)lround(20.0 / 10.2 * 512.0), rim = (i16)lround(slip_m_s * 8192.0);
    const i16 forward[4] = {(i16)-volts, (i16)-volts, volts, volts};
    const i16 rims[4] = {(i16)-rim, (i16)-rim, rim, rim};
    parameters_set(&p, PARAMETER_ID_velocity_per_force_q25, 1);
    parameters_set(&p, PARAMETER_ID_observer_gain_q15, 6554);
    run(forward, rims, 500);
    TEST_ASSERT_DOUBLE_WITHIN(0.002, 0.0, observer.x_m_s_q22 / 4194304.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.001, slip_m_s, observer.slip_m_s_q13[3] / 8192.0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(force_approaches_that_of_the_stalled_motor_as_a_low_pass);
    RUN_TEST(force_that_accelerates_the_shaft_is_not_the_rims);
    RUN_TEST(dry_friction_at_rest_is_not_the_floors);
    RUN_TEST(a_robot_at_rest_is_believed_at_rest_from_the_first_tick);
    RUN_TEST(known_forces_accelerate_the_body);
    RUN_TEST(known_forces_accelerate_the_body_sideways);
    RUN_TEST(known_torque_turns_the_body);
    RUN_TEST(free_body_keeps_its_direction_in_the_world);
    RUN_TEST(correction_converges_with_the_gain);
    RUN_TEST(slip_explains_rims_that_turn_while_the_body_stands);
    return UNITY_END();
}
