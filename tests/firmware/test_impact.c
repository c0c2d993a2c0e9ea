/* Slip in closed loop: a blow from the side, a slippery spot. */
#include <stdlib.h>
#include <unity.h>

#include "tests/firmware/closed_loop.h"
#include "tests/firmware/reference.h"

void setUp(void) {
    start(1);
}

void tearDown(void) {}

/* The robot after 1.4 s at 1.5 m/s, where every blow finds it. */
static void roll(i16 slip_compensation, double mu) {
    start(slip_compensation);
    plant.mu_drive = mu;
    drive(1500, 0, 0, 1400);
}

static void be_hit(double impulse_y_n_s) {
    plant.state[PLANT_VY] += impulse_y_n_s / 20.0;
    drive(1500, 0, 0, 1000);
}

/* |y| of the plant 1 s after a blow, mm; the robot is then set back to the time before it. */
static double remaining_after_blow_mm(double impulse_y_n_s) {
    const control_loop loop_before = loop;
    const reference_plant plant_before = plant;
    double remaining_mm;
    be_hit(impulse_y_n_s);
    remaining_mm = fabs(true_y_mm());
    loop = loop_before;
    plant = plant_before;
    return remaining_mm;
}

static void impact_is_seen_and_corrected(void) {
    double plain_mm;
    roll(0, 0.6);
    plain_mm = remaining_after_blow_mm(10.0);
    /* sliding with 0.6 * 9.81 * 2 sqrt 3 / 4 m/s2 from 0.5 m/s takes 25 mm */
    TEST_ASSERT_DOUBLE_WITHIN(5.0, 24.0, plain_mm);
    roll(1, 0.6);
    be_hit(10.0);
    TEST_ASSERT_TRUE(fabs(true_y_mm()) < 0.4 * plain_mm);
    TEST_ASSERT_DOUBLE_WITHIN(fabs(true_y_mm()) + 1.0, 0.0, believed_y_mm());
}

/* The firmware believes a grip of 0.6. */
static void correction_of_impacts_does_not_need_exact_grip(void) {
    static const double grips[] = {0.5, 0.57, 0.63, 0.7};
    static const double impulses_n_s[] = {6.0, 10.0, 15.0};
    for (int g = 0; g < 4; g += REFERENCE_STRIDE(3)) {
        double plain_mm[3];
        roll(0, grips[g]);
        for (int k = 0; k < 3; k += REFERENCE_STRIDE(2))
            plain_mm[k] = remaining_after_blow_mm(impulses_n_s[k]);
        roll(1, grips[g]);
        for (int k = 0; k < 3; k += REFERENCE_STRIDE(2))
            TEST_ASSERT_TRUE(remaining_after_blow_mm(impulses_n_s[k]) < plain_mm[k]);
    }
}

/* Grip believed a third too low: slip is seen where there is none, but its limit, 0.23 m/s, bounds
 * the harm. */
static void grip_believed_too_low_does_bounded_harm(void) {
    double plain_mm, compensated_mm;
    roll(0, 0.9);
    plain_mm = remaining_after_blow_mm(6.0);
    roll(1, 0.9);
    compensated_mm = remaining_after_blow_mm(6.0);
    TEST_ASSERT_TRUE(compensated_mm > plain_mm && compensated_mm < 2.0 * plain_mm);
}

static void null_slip_shows_a_wheel_on_a_slippery_spot(void) {
    int largest = 0;
    static const i16 duty_q15[4] = {6000, 0, 0, 0};
    for (int n = 0; n < 100; n++) {
        control_loop_command_duty(&loop, duty_q15);
        reference_plant_tick(&plant, &loop);
        largest = abs(loop.telemetry.null_slip_m_s_q13) > largest
                      ? abs(loop.telemetry.null_slip_m_s_q13)
                      : largest;
    }
    TEST_ASSERT_TRUE(largest > 400); /* 50 mm/s */
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(impact_is_seen_and_corrected);
    RUN_TEST(correction_of_impacts_does_not_need_exact_grip);
    RUN_TEST(grip_believed_too_low_does_bounded_harm);
    RUN_TEST(null_slip_shows_a_wheel_on_a_slippery_spot);
    return UNITY_END();
}
