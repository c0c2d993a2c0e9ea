/* One wheel: speed from counts, motor balance, PID, contact law. */
#include <unity.h>

#include "firmware/contact.h"
#include "firmware/motor.h"
#include "firmware/wheel_pid.h"
#include "firmware/wheel_speed.h"
#include "tests/firmware/reference.h"

static parameters p;

void setUp(void) {
    parameters_set_defaults(&p);
}

void tearDown(void) {}

/* ---- wheel_speed ---- */

static i16 speed_after(u16 start, i16 counts_per_tick, int ticks) {
    wheel_speed state;
    u16 count = start;
    i16 speed = 0;
    wheel_speed_reset(&state, start);
    for (int n = 0; n < ticks; n++) {
        count = (u16)(count + counts_per_tick);
        speed = wheel_speed_step_rad_s_q5(&state, &p, count);
    }
    return speed;
}

static void one_count_per_tick_is_3_1416_rad_s(void) {
    TEST_ASSERT_INT16_WITHIN(1, 101, speed_after(0, 1, 10)); /* 3.1416 * 32 = 100.5 */
    TEST_ASSERT_INT16_WITHIN(1, -101, speed_after(0, -1, 10));
}

static void wrap_of_the_counter_is_invisible_in_both_directions(void) {
    const i16 forward = speed_after(0, 297, 300), backward = speed_after(0, -297, 300);
    TEST_ASSERT_INT16_WITHIN(1, 29858, forward); /* 297 * 2 pi / 2000 * 1000 * 32 */
    TEST_ASSERT_INT16_WITHIN(1, -29858, backward);
    TEST_ASSERT_EQUAL_INT16(forward, speed_after(65530, 297, 4));
}

static void counts_of_a_tick_are_those_since_the_last(void) {
    static const u16 counts[] = {65530, 4, 34, 14, 64, 124, 54, 134, 224}; /* 10, 10, 30, -20 ... */
    wheel_speed state;
    wheel_speed_reset(&state, 65520);
    for (u16 i = 0; i < sizeof counts / sizeof counts[0]; i++) {
        const i16 since = (i16)(counts[i] - (i > 0 ? counts[i - 1] : 65520U));
        TEST_ASSERT_EQUAL_INT16(since, wheel_speed_counts_since(&state, counts[i]));
        wheel_speed_step_rad_s_q5(&state, &p, counts[i]);
    }
}

static void no_speed_follows_from_the_first_counter_value(void) {
    TEST_ASSERT_EQUAL_INT16(0, speed_after(41234, 0, 1));
}

/* The speeds add up to the angle: no count is lost, whatever the order of the counts. */
static void sum_of_speeds_is_the_angle(void) {
    wheel_speed state;
    uint64_t seed = 3;
    int32_t turned = 0, sum_q5 = 0;
    wheel_speed_reset(&state, 0);
    for (int n = 0; n < 5000; n++) {
        turned += n < 4990 ? reference_random_i16(&seed, 60) : 0;
        sum_q5 += wheel_speed_step_rad_s_q5(&state, &p, (u16)turned);
    }
    /* rounding is +-0.5 LSB per tick and unbiased: 5000^0.5 LSB are more than three of its sigmas
     */
    TEST_ASSERT_INT32_WITHIN(71, (int32_t)lround(turned * REFERENCE_PI * 32.0), sum_q5);
}

/* To the last bit: rounding does not prefer a sense of rotation. */
static void opposite_counts_are_opposite_speeds(void) {
    for (i16 counts = 0; counts < 1300; counts++)
        TEST_ASSERT_EQUAL_INT16(-speed_after(0, counts, 1), speed_after(0, (i16)-counts, 1));
}

/* ---- motor ---- */

static void stalled_motor_pushes_with_a_u(void) {
    /* (n/R) k2 / Ra * 1 V = 10.2 N */
    TEST_ASSERT_INT32_WITHIN(600, (int32_t)(10.2 * 524288.0), motor_steady_force_n_q19(&p, 512, 0));
}

static void no_load_speed_is_that_of_the_model(void) {
    /* 24 V: k2 u = (k2 k3 + b0 Ra) W -> W = 928.3 rad/s, rim 3.87 m/s */
    const i16 below = (i16)(927.0 * 32.0), above = (i16)(929.5 * 32.0);
    TEST_ASSERT_GREATER_THAN_INT32(0, motor_steady_force_n_q19(&p, 12288, below));
    TEST_ASSERT_LESS_THAN_INT32(0, motor_steady_force_n_q19(&p, 12288, above));
}

static void voltage_and_force_undo_each_other(void) {
    uint64_t seed = 5;
    parameters_set(&p, PARAMETER_ID_coulomb_force_q8, 700);
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        const i16 force = reference_random_i16(&seed, 20000);
        const i16 shaft = reference_random_i16(&seed, 15000);
        const i16 voltage = motor_voltage_v_q9(&p, force, shaft, 0);
        /* half an LSB of the voltage is 2.6 LSB of the force, and volt_per_force * force_per_volt
         * is 1 within 1.4e-4, which at the largest sum of 200 N makes 7.2 LSB; three truncations */
        TEST_ASSERT_INT_WITHIN(13, force, motor_steady_force_n_q19(&p, voltage, shaft) >> 11);
    }
}

/* ---- wheel_pid ---- */

static wheel_pid_input pid_input(i16 target, i16 shaft, i16 limit) {
    const wheel_pid_input input = {target, shaft, 0, limit};
    return input;
}

static void integral_removes_a_steady_error_of_the_plant(void) {
    /* first-order plant with time constant 50 ms, gain 20 rad/s/V and a disturbance of 3 V */
    wheel_pid pid;
    double speed = 0.0;
    u16 limited = 0;
    wheel_pid_reset(&pid, 0);
    for (int n = 0; n < 3000; n++) {
        const wheel_pid_input input = pid_input(3200, (i16)lround(speed * 32.0), 12288);
        const double voltage = wheel_pid_step_v_q9(&pid, &p, &input, &limited) / 512.0;
        speed += 0.001 / 0.05 * (20.0 * (voltage - 3.0) - speed);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 100.0, speed);
    TEST_ASSERT_EQUAL_UINT(0, limited);
}

static void saturation_does_not_wind_up_the_integral(void) {
    wheel_pid pid;
    wheel_pid_input input = pid_input(20000, 0, 5000);
    u16 limited = 0;
    wheel_pid_reset(&pid, 0);
    for (int n = 0; n < 5000; n++)
        wheel_pid_step_v_q9(&pid, &p, &input, &limited);
    TEST_ASSERT_EQUAL_UINT(1, limited);
    input = pid_input(0, 20, 5000); /* the error turns: the output must follow in one tick */
    TEST_ASSERT_LESS_THAN_INT(1, wheel_pid_step_v_q9(&pid, &p, &input, &limited));
}

/* Beyond either limit by the feed-forward, an error that points back into the range is integrated:
 * 10 rad/s for 1 s take 1000 * 320 * Ki. */
static void an_error_that_leads_out_of_the_limit_is_integrated(void) {
    const double integral_v = 320.0 * 1000.0 * 3673.0 / 134217728.0;
    for (int direction = -1; direction <= 1; direction += 2) {
        const i16 ahead_q5 = (i16)(direction * 320);
        const wheel_pid_input beyond = {0, ahead_q5, direction > 0 ? 20000 : -20000, 5000};
        const wheel_pid_input rest = {0, 0, 0, 12288};
        wheel_pid pid;
        u16 limited = 0;
        wheel_pid_reset(&pid, ahead_q5);
        for (int n = 0; n < 1000; n++)
            wheel_pid_step_v_q9(&pid, &p, &beyond, &limited);
        TEST_ASSERT_EQUAL_UINT(1, limited);
        TEST_ASSERT_DOUBLE_WITHIN(0.1, -direction * integral_v,
                                  wheel_pid_step_v_q9(&pid, &p, &rest, &limited) / 512.0);
    }
}

/* Voltages of a step of the target and then of 1 rad/s more speed in one tick. */
static void kick_and_brake(i16 derivative_q12, i16 voltage_v_q9[2]) {
    wheel_pid pid;
    wheel_pid_input input = pid_input(3200, 0, 12288);
    u16 limited = 0;
    parameters_set(&p, PARAMETER_ID_speed_derivative_q12, derivative_q12);
    wheel_pid_reset(&pid, 0);
    voltage_v_q9[0] = wheel_pid_step_v_q9(&pid, &p, &input, &limited);
    input.shaft_rad_s_q5 = 32;
    voltage_v_q9[1] = wheel_pid_step_v_q9(&pid, &p, &input, &limited);
}

static void derivative_brakes_but_does_not_kick_when_the_target_steps(void) {
    i16 with[2], without[2];
    kick_and_brake(4096, with); /* 1 V per rad/s in one tick */
    kick_and_brake(0, without);
    TEST_ASSERT_EQUAL_INT16(without[0], with[0]);
    TEST_ASSERT_EQUAL_INT16(without[1] - 512, with[1]);
}

/* ---- contact ---- */

static void slip_is_the_inverse_of_the_friction_law(void) {
    parameters_set(&p, PARAMETER_ID_slip_saturation_q15, 31457);
    for (double slip_m_s = -0.3; slip_m_s < 0.3; slip_m_s += 0.001) {
        const double grip_n = 0.6 * 20.0 * 9.81 / 4.0;
        const double force_n = grip_n * 2.0 / REFERENCE_PI * atan(40.0 * slip_m_s);
        const contact_slip found = contact_slip_from_force(&p, (i16)lround(force_n * 256.0));
        /* error of half an LSB of the force and 1e-4 of the grip, as the law magnifies it */
        const double magnified = 1.0 + pow(40.0 * slip_m_s, 2.0);
        TEST_ASSERT_DOUBLE_WITHIN(0.0002 * magnified, slip_m_s, found.slip_m_s_q13 / 8192.0);
        TEST_ASSERT_DOUBLE_WITHIN(0.001, 1.0 / magnified, found.trust_q15 / 32768.0);
    }
}

static void slip_is_bounded_beyond_the_grip(void) {
    const i16 most = contact_slip_from_force(&p, I16_MAX).slip_m_s_q13;
    TEST_ASSERT_DOUBLE_WITHIN(0.01, tan(0.93 * REFERENCE_PI / 2.0) / 40.0, most / 8192.0);
    TEST_ASSERT_INT16_WITHIN(8, -most, contact_slip_from_force(&p, I16_MIN).slip_m_s_q13);
}

static void rollers_brake_against_the_motion(void) {
    /* four rollers at +-30 degrees to x: 4 * 2.4525 N * (2/pi) atan(40 * cos 30 * 1.5) * cos 30 */
    kinematics_force f = contact_roller_force(&p, 12288, 0);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, -8.392, f.x_n_q6 / 64.0);
    TEST_ASSERT_INT16_WITHIN(1, 0, f.y_n_q6);
    /* the same with sin 30 */
    f = contact_roller_force(&p, 0, 12288);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, -4.801, f.y_n_q6 / 64.0);
    TEST_ASSERT_INT16_WITHIN(1, 0, f.x_n_q6);
    TEST_ASSERT_EQUAL_INT16(0, f.torque_n_m_q8); /* they point at the centre */
}

/* 2 N of dry friction act against the shaft, less on the ramp of +-4 rad/s about rest; what is not
 * known to act there is slack. */
static void dry_friction_acts_against_the_shaft_and_is_slack_at_rest(void) {
    static const struct {
        i16 shaft_rad_s_q5;
        i16 friction_n_q8;
        i16 slack_n_q8;
    } cases[] = {{0, 0, 512}, {64, 256, 256}, {640, 512, 0}, {-64, -256, 256}, {-640, -512, 0}};
    for (u16 i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const i16 shaft_q5 = cases[i].shaft_rad_s_q5;
        parameters dry, smooth;
        parameters_set_defaults(&smooth);
        dry = smooth;
        parameters_set(&dry, PARAMETER_ID_coulomb_force_q8, 512);
        TEST_ASSERT_EQUAL_INT32((i32)cases[i].friction_n_q8 * 2048,
                                motor_steady_force_n_q19(&smooth, 500, shaft_q5) -
                                    motor_steady_force_n_q19(&dry, 500, shaft_q5));
        TEST_ASSERT_EQUAL_INT16(cases[i].slack_n_q8, motor_dry_slack_n_q8(&dry, shaft_q5));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(dry_friction_acts_against_the_shaft_and_is_slack_at_rest);
    RUN_TEST(one_count_per_tick_is_3_1416_rad_s);
    RUN_TEST(wrap_of_the_counter_is_invisible_in_both_directions);
    RUN_TEST(counts_of_a_tick_are_those_since_the_last);
    RUN_TEST(no_speed_follows_from_the_first_counter_value);
    RUN_TEST(sum_of_speeds_is_the_angle);
    RUN_TEST(opposite_counts_are_opposite_speeds);
    RUN_TEST(stalled_motor_pushes_with_a_u);
    RUN_TEST(no_load_speed_is_that_of_the_model);
    RUN_TEST(voltage_and_force_undo_each_other);
    RUN_TEST(integral_removes_a_steady_error_of_the_plant);
    RUN_TEST(saturation_does_not_wind_up_the_integral);
    RUN_TEST(an_error_that_leads_out_of_the_limit_is_integrated);
    RUN_TEST(derivative_brakes_but_does_not_kick_when_the_target_steps);
    RUN_TEST(slip_is_the_inverse_of_the_friction_law);
    RUN_TEST(slip_is_bounded_beyond_the_grip);
    RUN_TEST(rollers_brake_against_the_motion);
    return UNITY_END();
}
