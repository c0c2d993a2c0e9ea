/* Properties of the fixed-point arithmetic, the parameters and the kinematics that hold exactly or
 * by closed form. The errors of rounding are measured by fixed_point_error.c. */
#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "firmware/fixed_point.h"
#include "firmware/kinematics.h"
#include "firmware/parameters.h"
#include "tests/firmware/reference.h"

static parameters p;
static uint64_t seed;

void setUp(void) {
    parameters_set_defaults(&p);
    seed = 7;
}

void tearDown(void) {}

static void sums_saturate_at_both_ends(void) {
    TEST_ASSERT_EQUAL_INT(I16_MAX, fixed_add_i16(I16_MAX, 1));
    TEST_ASSERT_EQUAL_INT(I16_MIN, fixed_subtract_i16(I16_MIN, 1));
    TEST_ASSERT_EQUAL_INT32(I32_MAX, fixed_add_i32((i32)I32_MAX, 1));
    TEST_ASSERT_EQUAL_INT32(I32_MIN, fixed_add_i32((i32)I32_MIN, -1));
    TEST_ASSERT_EQUAL_INT32(I32_MAX, fixed_subtract_i32(0, (i32)I32_MIN));
    TEST_ASSERT_EQUAL_INT32(I32_MIN, fixed_subtract_i32((i32)I32_MIN, 1));
}

static void shifts_round_and_saturate(void) {
    TEST_ASSERT_EQUAL_INT32(2, fixed_shift_right(3, 1));
    TEST_ASSERT_EQUAL_INT32(-1, fixed_shift_right(-3, 1));
    TEST_ASSERT_EQUAL_INT32(1L << 30, fixed_shift_right((i32)I32_MAX, 1));
    TEST_ASSERT_EQUAL_INT32(I32_MAX, fixed_shift_left(1L << 20, 11));
    TEST_ASSERT_EQUAL_INT32(I32_MIN, fixed_shift_left(-(1L << 20) - 1, 11));
    TEST_ASSERT_EQUAL_INT32(-(1L << 20) * 1024, fixed_shift_left(-(1L << 20), 10));
}

static void odd_shifts_round_halves_away_from_zero(void) {
    TEST_ASSERT_EQUAL_INT32(-1, fixed_shift_right_odd(-1, 1));
    TEST_ASSERT_EQUAL_INT32(-2, fixed_shift_right_odd(-3, 1));
    TEST_ASSERT_EQUAL_INT32(-(1L << 30), fixed_shift_right_odd((i32)I32_MIN, 1));
    for (i32 value = 0; value < 64; value++) {
        TEST_ASSERT_EQUAL_INT32(fixed_shift_right(value, 3), fixed_shift_right_odd(value, 3));
        TEST_ASSERT_EQUAL_INT32(-fixed_shift_right(value, 3), fixed_shift_right_odd(-value, 3));
    }
}

/* However many values: what the results lack of their sum is the rest. */
static void carrying_shifts_lose_nothing(void) {
    i32 sum = 0, results = 0;
    u16 rest = 0;
    for (int n = 0; n < 1000; n++) {
        const i32 value = reference_random_i16(&seed, 3000);
        sum += value;
        results += fixed_shift_right_carrying(value, 11, &rest);
        TEST_ASSERT_EQUAL_INT32(sum, results * 2048 + rest);
        TEST_ASSERT_TRUE(rest < 2048);
    }
}

static void products_saturate_at_minus_one_squared(void) {
    TEST_ASSERT_EQUAL_INT(I16_MAX, fixed_multiply_q15(I16_MIN, I16_MIN));
    TEST_ASSERT_EQUAL_INT32(I32_MAX, fixed_multiply_i32_q15((i32)I32_MIN, I16_MIN));
}

static void division_by_zero_saturates_with_the_sign(void) {
    TEST_ASSERT_EQUAL_INT32(I32_MAX, fixed_divide(1, 0, 4));
    TEST_ASSERT_EQUAL_INT32(I32_MIN, fixed_divide(-1, 0, 4));
    TEST_ASSERT_EQUAL_INT32(I32_MAX, fixed_divide((i32)I32_MAX, 1, 1));
}

static void sine_has_exact_quarters_and_symmetry(void) {
    TEST_ASSERT_EQUAL_INT(0, fixed_sine_q15(0));
    TEST_ASSERT_EQUAL_INT(I16_MAX, fixed_sine_q15(16384));
    TEST_ASSERT_EQUAL_INT(-I16_MAX, fixed_sine_q15(49152));
    for (u32 angle = 0; angle < 65536; angle++) {
        TEST_ASSERT_EQUAL_INT(fixed_sine_q15((u16)angle), -fixed_sine_q15((u16)(65536 - angle)));
    }
}

static void tangent_saturates_at_the_quarter_turn(void) {
    i16 cosine_q15;
    TEST_ASSERT_EQUAL_INT(I16_MAX, fixed_tangent_quarter_q10(I16_MAX, &cosine_q15));
    TEST_ASSERT_EQUAL_INT(-I16_MAX, fixed_tangent_quarter_q10(I16_MIN, &cosine_q15));
    TEST_ASSERT_EQUAL_INT(0, cosine_q15);
    TEST_ASSERT_EQUAL_INT(1024, fixed_tangent_quarter_q10(16384, &cosine_q15));
    TEST_ASSERT_EQUAL_INT(fixed_cosine_q15(8192), cosine_q15);
}

static void arc_tangent_knows_the_quadrants(void) {
    TEST_ASSERT_EQUAL_INT(0, fixed_atan2(0, 0));
    TEST_ASSERT_EQUAL_INT(8192, fixed_atan2(5, 5));
    TEST_ASSERT_EQUAL_INT(16384, fixed_atan2((i32)I32_MAX, 0));
    TEST_ASSERT_EQUAL_INT(24576, fixed_atan2(5, -5));
    TEST_ASSERT_EQUAL_INT(-24576, fixed_atan2(-5, -5));
    TEST_ASSERT_EQUAL_INT(I16_MIN, fixed_atan2(0, -5));
    TEST_ASSERT_EQUAL_INT(I16_MIN, fixed_atan2(0, -1));
    TEST_ASSERT_EQUAL_INT(-8192, fixed_atan2((i32)I32_MIN, (i32)I32_MAX));
}

static void square_root_is_the_floor(void) {
    TEST_ASSERT_EQUAL_UINT(65535, fixed_sqrt((u32)-1));
    TEST_ASSERT_EQUAL_UINT(65534, fixed_sqrt(65535UL * 65535UL - 1UL));
    TEST_ASSERT_EQUAL_UINT(5, fixed_hypot(3, -4));
    TEST_ASSERT_EQUAL_UINT(46340, fixed_hypot(I16_MIN, I16_MIN));
}

static void longer_is_what_has_the_longer_root(void) {
    TEST_ASSERT_FALSE(fixed_is_longer(0, 0, 0));
    TEST_ASSERT_FALSE(fixed_is_longer(3, -4, 5));
    TEST_ASSERT_TRUE(fixed_is_longer(3, -4, 4));
    TEST_ASSERT_FALSE(fixed_is_longer(0, I16_MAX, I16_MAX));
    TEST_ASSERT_TRUE(fixed_is_longer(0, I16_MIN, I16_MAX));
    TEST_ASSERT_TRUE(fixed_is_longer(I16_MIN, I16_MIN, I16_MAX));
    for (i16 b = 0; b < 200; b++)
        TEST_ASSERT_EQUAL(fixed_hypot(150, b) > 180, fixed_is_longer(150, b, 180));
}

static void parameters_refuse_what_is_out_of_range_and_keep_the_old_value(void) {
    i32 value = 0;
    TEST_ASSERT_EQUAL(PARAMETERS_OUT_OF_RANGE,
                      parameters_set(&p, PARAMETER_ID_slip_compensation, 2));
    TEST_ASSERT_EQUAL(PARAMETERS_UNKNOWN_ID, parameters_set(&p, PARAMETER_COUNT, 0));
    TEST_ASSERT_EQUAL(PARAMETERS_UNKNOWN_ID, parameters_get(&p, PARAMETER_COUNT, &value));
    TEST_ASSERT_EQUAL(PARAMETERS_OK, parameters_get(&p, PARAMETER_ID_slip_compensation, &value));
    TEST_ASSERT_EQUAL_INT32(1, value);
    TEST_ASSERT_EQUAL(PARAMETERS_OK, parameters_set(&p, PARAMETER_ID_slip_compensation, 0));
    TEST_ASSERT_EQUAL_INT(0, PARAMETER_GET(&p, slip_compensation));
}

static void every_default_lies_within_its_own_limits(void) {
    for (u16 id = 0; id < PARAMETER_COUNT; id++) {
        TEST_ASSERT_EQUAL(PARAMETERS_OK, parameters_set(&p, id, p.value[id]));
    }
}

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) \
    TEST_ASSERT_EQUAL(q_bits, name_q_bits(#name));
static int name_q_bits(const char *name) {
    const char *suffix = strrchr(name, '_');
    return suffix[1] == 'q' ? atoi(suffix + 2) : 0;
}

static void names_state_their_q_format(void) {
#include "firmware/parameters.def"
}
#undef PARAMETER

/* J+ J = I: the first line of the errata table. */
static void forward_undoes_inverse(void) {
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        const kinematics_velocity v = {reference_random_i16(&seed, 12000),
                                       reference_random_i16(&seed, 12000),
                                       reference_random_i16(&seed, 12000)};
        kinematics_velocity back;
        i16 rim[4];
        kinematics_inverse(&p, &v, rim);
        kinematics_forward(&p, rim, &back);
        TEST_ASSERT_INT_WITHIN(2, v.x_m_s_q13, back.x_m_s_q13);
        TEST_ASSERT_INT_WITHIN(2, v.y_m_s_q13, back.y_m_s_q13);
        TEST_ASSERT_INT_WITHIN(2, v.omega_rad_s_q11, back.omega_rad_s_q11);
        TEST_ASSERT_INT_WITHIN(2, 0, kinematics_null_slip_m_s_q13(&p, rim));
    }
}

static void rows_of_the_kinematic_matrix_are_those_of_the_paper(void) {
    const kinematics_velocity forward = {8192, 0, 0}, left = {0, 8192, 0}, turn = {0, 0, 2048};
    i16 rim[4];
    kinematics_inverse(&p, &forward, rim); /* -1/2 -1/2 1/2 1/2 */
    TEST_ASSERT_EQUAL_INT16(-4096, rim[0]);
    TEST_ASSERT_EQUAL_INT16(-4096, rim[1]);
    TEST_ASSERT_EQUAL_INT16(4096, rim[2]);
    TEST_ASSERT_EQUAL_INT16(4096, rim[3]);
    kinematics_inverse(&p, &left, rim); /* s -s -s s */
    TEST_ASSERT_INT16_WITHIN(1, 7094, rim[0]);
    TEST_ASSERT_INT16_WITHIN(1, -7094, rim[1]);
    TEST_ASSERT_INT16_WITHIN(1, -7094, rim[2]);
    TEST_ASSERT_INT16_WITHIN(1, 7094, rim[3]);
    kinematics_inverse(&p, &turn, rim); /* L L L L */
    TEST_ASSERT_INT16_WITHIN(1, 1638, rim[0]);
    TEST_ASSERT_INT16_WITHIN(1, 1638, rim[2]);
}

/* To the last bit: rounding does not prefer a sense of rotation. */
static void opposite_motions_turn_the_wheels_oppositely(void) {
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        const kinematics_velocity there = {reference_random_i16(&seed, 12000),
                                           reference_random_i16(&seed, 12000),
                                           reference_random_i16(&seed, 2)};
        const kinematics_velocity back = {(i16)-there.x_m_s_q13, (i16)-there.y_m_s_q13,
                                          (i16)-there.omega_rad_s_q11};
        i16 rim_there[4], rim_back[4];
        kinematics_inverse(&p, &there, rim_there);
        kinematics_inverse(&p, &back, rim_back);
        for (int i = 0; i < 4; i++)
            TEST_ASSERT_EQUAL_INT(-rim_there[i], rim_back[i]);
    }
}

/* One wheel that spins shows in full, four wheels that roll do not. */
static void null_slip_sees_a_single_spinning_wheel(void) {
    const i16 spinning[4] = {0, 0, 1000, 0};
    TEST_ASSERT_EQUAL_INT(1000, kinematics_null_slip_m_s_q13(&p, spinning));
}

/* (J+)' and J' undo each other: wheel forces made for a body force add up to it. */
static void wheel_forces_add_up_to_the_body_force(void) {
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        const kinematics_force wanted = {reference_random_i16(&seed, 2000),
                                         reference_random_i16(&seed, 2000),
                                         reference_random_i16(&seed, 1000)};
        kinematics_force sum;
        i16 wheel[4];
        kinematics_wheel_forces(&p, &wanted, wheel);
        kinematics_body_force(&p, wheel, &sum);
        TEST_ASSERT_INT_WITHIN(2, wanted.x_n_q6, sum.x_n_q6);
        TEST_ASSERT_INT_WITHIN(2, wanted.y_n_q6, sum.y_n_q6);
        TEST_ASSERT_INT_WITHIN(2, wanted.torque_n_m_q8, sum.torque_n_m_q8);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(sums_saturate_at_both_ends);
    RUN_TEST(shifts_round_and_saturate);
    RUN_TEST(odd_shifts_round_halves_away_from_zero);
    RUN_TEST(carrying_shifts_lose_nothing);
    RUN_TEST(products_saturate_at_minus_one_squared);
    RUN_TEST(division_by_zero_saturates_with_the_sign);
    RUN_TEST(sine_has_exact_quarters_and_symmetry);
    RUN_TEST(tangent_saturates_at_the_quarter_turn);
    RUN_TEST(arc_tangent_knows_the_quadrants);
    RUN_TEST(square_root_is_the_floor);
    RUN_TEST(longer_is_what_has_the_longer_root);
    RUN_TEST(parameters_refuse_what_is_out_of_range_and_keep_the_old_value);
    RUN_TEST(every_default_lies_within_its_own_limits);
    RUN_TEST(names_state_their_q_format);
    RUN_TEST(forward_undoes_inverse);
    RUN_TEST(rows_of_the_kinematic_matrix_are_those_of_the_paper);
    RUN_TEST(opposite_motions_turn_the_wheels_oppositely);
    RUN_TEST(null_slip_sees_a_single_spinning_wheel);
    RUN_TEST(wheel_forces_add_up_to_the_body_force);
    return UNITY_END();
}
