/* Largest error of the firmware's arithmetic against double references, in LSB of each result.
 *
 * Prints one line per function: largest error found, number of inputs, bound. Exit status 1 when a
 * bound is exceeded. "all" means every possible input; else inputs are drawn uniformly over the
 * whole stated range.
 */
#include <stdio.h>

#include "firmware/contact.h"
#include "firmware/fixed_point.h"
#include "firmware/kinematics.h"
#include "firmware/motor.h"
#include "firmware/odometry.h"
#include "firmware/parameters.h"
#include "firmware/wheel_pid.h"
#include "tests/firmware/reference.h"

enum { DRAWS = 500000 };

static parameters p;
static uint64_t seed = 1;
static int failures = 0;

static void keep_largest(double *largest, double fixed, double exact) {
    const double error = fabs(fixed - exact);
    if (error > *largest)
        *largest = error;
}

static void report(const char *name, const char *inputs, double largest, double bound) {
    const int ok = largest <= bound;
    printf("%-38s %9.3f  %9.3f  %-s%s\n", name, largest, bound, inputs, ok ? "" : "  EXCEEDED");
    if (!ok)
        failures++;
}

static double raw(parameter_id id) {
    return p.value[id];
}
static double real(parameter_id id, int q_bits) {
    return ldexp(raw(id), -q_bits);
}
static i16 draw(i16 magnitude) {
    return reference_random_i16(&seed, magnitude);
}

static void multiply(void) {
    double largest = 0.0, largest_32 = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const i16 a = draw(I16_MAX), b = draw(I16_MAX);
        const i32 wide = (i32)reference_random(&seed);
        keep_largest(&largest, fixed_multiply_q15(a, b), (double)a * b / 32768.0);
        keep_largest(&largest_32, fixed_multiply_i32_q15(wide, b), (double)wide * b / 32768.0);
    }
    report("fixed_multiply_q15", "drawn, full range", largest, 0.5);
    report("fixed_multiply_i32_q15", "drawn, full range", largest_32, 1.5);
}

static void divide(void) {
    double largest = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const i32 numerator = (i32)reference_random(&seed) / 65536;
        const u16 denominator = (u16)(reference_random(&seed) % 65535u + 1u);
        keep_largest(&largest, fixed_divide(numerator, denominator, 15),
                     (double)numerator * 32768.0 / denominator);
    }
    report("fixed_divide", "drawn, |numerator| < 2^15", largest, 1.0);
}

static void trigonometry(void) {
    double sine = 0.0, cosine = 0.0, tangent = 0.0, arc = 0.0, octant = 0.0;
    for (long angle = 0; angle < 65536; angle++) {
        const double angle_rad = (double)angle * REFERENCE_PI / 32768.0;
        keep_largest(&sine, fixed_sine_q15((u16)angle), reference_i16(sin(angle_rad) * 32768.0));
        keep_largest(&cosine, fixed_cosine_q15((u16)angle),
                     reference_i16(cos(angle_rad) * 32768.0));
        keep_largest(&arc,
                     remainder(fixed_atan2((i32)lround(sin(angle_rad) * 1e9),
                                           (i32)lround(cos(angle_rad) * 1e9)) -
                                   (double)angle,
                               65536.0),
                     0.0);
    }
    for (i32 ratio = 0; ratio <= I16_MAX; ratio++)
        keep_largest(&octant, fixed_atan2(ratio, I16_MAX),
                     atan((double)ratio / I16_MAX) * 32768.0 / REFERENCE_PI);
    for (long x = -31457; x <= 31457; x++) {
        const double exact = tan(REFERENCE_PI / 2.0 * (double)x / 32768.0) * 1024.0;
        i16 cosine_q15;
        keep_largest(&tangent,
                     fixed_tangent_quarter_q10((i16)x, &cosine_q15) / (1.0 + fabs(exact) / 1024.0),
                     exact / (1.0 + fabs(exact) / 1024.0));
    }
    report("fixed_sine_q15", "all", sine, 2.0);
    report("fixed_cosine_q15", "all", cosine, 2.0);
    report("fixed_tangent_quarter_q10 / (1 + tan)", "all to 0.96", tangent, 1.5);
    report("fixed_atan2 (full turn 65536)", "65536 directions", arc, 1.5);
    report("fixed_atan2 of ratios up to 1", "all", octant, 1.0);
}

static void square_root(void) {
    double largest = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const u32 value = reference_random(&seed);
        keep_largest(&largest, fixed_sqrt(value), floor(sqrt((double)value)));
    }
    report("fixed_sqrt against floor(sqrt)", "drawn, full range", largest, 0.0);
}

static double wheels_dot(parameter_id first, int q_bits, const double v[4]) {
    double sum = 0.0;
    for (int i = 0; i < 4; i++)
        sum += real((parameter_id)(first + i), q_bits) * v[i];
    return sum;
}

static void inverse_kinematics(void) {
    double largest = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const kinematics_velocity v = {draw(I16_MAX), draw(I16_MAX), draw(I16_MAX)};
        i16 rim[4];
        kinematics_inverse(&p, &v, rim);
        for (int i = 0; i < 4; i++) {
            const double exact =
                real((parameter_id)(PARAMETER_ID_drive_x_1_q15 + i), 15) * v.x_m_s_q13 +
                real((parameter_id)(PARAMETER_ID_drive_y_1_q15 + i), 15) * v.y_m_s_q13 +
                real(PARAMETER_ID_wheel_distance_q15, 15) * v.omega_rad_s_q11 * 4.0;
            keep_largest(&largest, rim[i], reference_i16(exact));
        }
    }
    report("kinematics_inverse, m/s Q13", "drawn, full range", largest, 1.0);
}

static void forward_kinematics(void) {
    double linear = 0.0, angular = 0.0, null_slip = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const i16 rim[4] = {draw(I16_MAX), draw(I16_MAX), draw(I16_MAX), draw(I16_MAX)};
        const double v[4] = {rim[0], rim[1], rim[2], rim[3]};
        kinematics_velocity body;
        kinematics_forward(&p, rim, &body);
        keep_largest(&linear, body.x_m_s_q13,
                     reference_i16(wheels_dot(PARAMETER_ID_forward_x_1_q13, 13, v)));
        keep_largest(&linear, body.y_m_s_q13,
                     reference_i16(wheels_dot(PARAMETER_ID_forward_y_1_q13, 13, v)));
        keep_largest(&angular, body.omega_rad_s_q11,
                     reference_i16(wheels_dot(PARAMETER_ID_forward_omega_1_q13, 13, v) / 4.0));
        keep_largest(&null_slip, kinematics_null_slip_m_s_q13(&p, rim),
                     reference_i16(wheels_dot(PARAMETER_ID_null_1_q13, 13, v)));
    }
    report("kinematics_forward x y, m/s Q13", "drawn, full range", linear, 0.5);
    report("kinematics_forward omega, rad/s Q11", "drawn, full range", angular, 0.5);
    report("kinematics_null_slip, m/s Q13", "drawn, full range", null_slip, 0.5);
}

static void forces(void) {
    double body = 0.0, torque = 0.0, wheel = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const i16 f[4] = {draw(I16_MAX), draw(I16_MAX), draw(I16_MAX), draw(I16_MAX)};
        const double v[4] = {f[0], f[1], f[2], f[3]};
        kinematics_force sum;
        i16 shared[4];
        kinematics_body_force(&p, f, &sum);
        keep_largest(&body, sum.x_n_q6,
                     reference_i16(wheels_dot(PARAMETER_ID_drive_x_1_q15, 17, v)));
        keep_largest(&body, sum.y_n_q6,
                     reference_i16(wheels_dot(PARAMETER_ID_drive_y_1_q15, 17, v)));
        keep_largest(
            &torque, sum.torque_n_m_q8,
            reference_i16(real(PARAMETER_ID_wheel_distance_q15, 15) * (v[0] + v[1] + v[2] + v[3])));
        kinematics_wheel_forces(&p, &sum, shared);
        for (int i = 0; i < 4; i++) {
            const double exact =
                real((parameter_id)(PARAMETER_ID_forward_x_1_q13 + i), 11) * sum.x_n_q6 +
                real((parameter_id)(PARAMETER_ID_forward_y_1_q13 + i), 11) * sum.y_n_q6 +
                real((parameter_id)(PARAMETER_ID_forward_omega_1_q13 + i), 13) * sum.torque_n_m_q8;
            keep_largest(&wheel, shared[i], reference_i16(exact));
        }
    }
    report("kinematics_body_force, N Q6", "drawn, full range", body, 0.52);
    report("kinematics_body_force torque, N m Q8", "drawn, full range", torque, 1.5);
    report("kinematics_wheel_forces, N Q8", "drawn, full range", wheel, 0.52);
}

static double exact_voltage(i16 force_q8, i16 shaft_q5, i16 change_q5) {
    const double sign = reference_clamp(shaft_q5, -128, 128) / 128.0;
    const double force_n = force_q8 / 256.0 + real(PARAMETER_ID_drag_q14, 14) * shaft_q5 / 32.0 +
                           real(PARAMETER_ID_coulomb_force_q8, 8) * sign +
                           real(PARAMETER_ID_momentum_per_tick_q10, 10) * change_q5 / 32.0;
    return reference_clamp(force_n, -512.0, 511.98) * real(PARAMETER_ID_volt_per_force_q13, 13) *
           512.0;
}

static void motor(void) {
    double voltage = 0.0;
    parameters_set(&p, PARAMETER_ID_coulomb_force_q8, 500);
    for (long n = 0; n < DRAWS; n++) {
        const i16 force = draw(I16_MAX), shaft = draw(I16_MAX), change = draw(1000);
        keep_largest(&voltage, motor_voltage_v_q9(&p, force, shaft, change),
                     reference_i16(exact_voltage(force, shaft, change)));
    }
    parameters_set_defaults(&p);
    report("motor_voltage, V Q9", "drawn, full range", voltage, 1.5);
}

static void contact(void) {
    const double grip_n = 1.0 / real(PARAMETER_ID_grip_inverse_q15, 15);
    const double per_tangent = real(PARAMETER_ID_slip_per_tangent_q18, 18);
    double slip = 0.0, roller = 0.0;
    parameters_set(&p, PARAMETER_ID_slip_saturation_q15, 31457); /* 0.96 */
    for (i16 force = -7232; force <= 7232; force++) {
        const double exact =
            tan(REFERENCE_PI / 2.0 * force / 256.0 / grip_n) * per_tangent * 8192.0;
        const double slope = 1.0 + pow(exact / 8192.0 / per_tangent, 2.0);
        keep_largest(&slip, contact_slip_from_force(&p, force).slip_m_s_q13 / slope, exact / slope);
    }
    for (long n = 0; n < DRAWS; n++) {
        const i16 vx = draw(20000);
        const i16 vy = draw(20000);
        const kinematics_force f = contact_roller_force(&p, vx, vy);
        double x = 0.0;
        for (int i = 0; i < 4; i++) {
            const double dx = real((parameter_id)(PARAMETER_ID_drive_x_1_q15 + i), 15);
            const double dy = real((parameter_id)(PARAMETER_ID_drive_y_1_q15 + i), 15);
            const double hub_m_s = (dy * vx - dx * vy) / 8192.0;
            x -= dy * real(PARAMETER_ID_roller_grip_q8, 8) * 2.0 / REFERENCE_PI *
                 atan(hub_m_s / per_tangent) * 64.0;
        }
        keep_largest(&roller, f.x_n_q6, x);
    }
    report("contact_slip / (1 + (k s)^2), m/s Q13", "all to 0.96 of the grip", slip, 1.0);
    report("contact_roller_force, N Q6", "drawn, to 2.4 m/s", roller, 1.0);
}

static void rotation(void) {
    double largest = 0.0;
    for (long n = 0; n < DRAWS; n++) {
        const u16 angle = (u16)reference_random(&seed);
        const double angle_rad = angle * REFERENCE_PI / 32768.0;
        const i16 x0 = draw(23000), y0 = draw(23000);
        i16 x = x0, y = y0;
        odometry_rotate(angle, &x, &y);
        keep_largest(&largest, x, cos(angle_rad) * x0 - sin(angle_rad) * y0);
        keep_largest(&largest, y, sin(angle_rad) * x0 + cos(angle_rad) * y0);
    }
    report("odometry_rotate, m/s Q13", "drawn, to 2.8 m/s", largest, 2.5);
}

/* 200 runs of 500 ticks; the reference integrates in double and freezes under the same condition.
 */
static void pid(void) {
    double largest = 0.0;
    parameters_set(&p, PARAMETER_ID_speed_derivative_q12, 1000);
    for (int run = 0; run < 200; run++) {
        wheel_pid state;
        double integral = 0.0;
        i16 before = draw(I16_MAX / 2);
        wheel_pid_reset(&state, before);
        for (int n = 0; n < 500; n++) {
            const i16 target = draw(I16_MAX / 2), shaft = draw(I16_MAX / 2);
            const wheel_pid_input input = {target, shaft, draw(6000), 12288};
            const double error = target - shaft;
            const double step = error * raw(PARAMETER_ID_speed_integral_q22) / 262144.0;
            const double sum = input.feed_forward_v_q9 +
                               error * raw(PARAMETER_ID_speed_gain_q15) / 2048.0 -
                               (shaft - before) * 1000.0 / 256.0 + integral + step;
            u16 limited = 0;
            const i16 output = wheel_pid_step_v_q9(&state, &p, &input, &limited);
            keep_largest(&largest, output, reference_clamp(sum, -12288.0, 12288.0));
            /* An excess within the rounding may freeze one integral and not the other: follow. */
            integral = ldexp(state.integral_v_q21, -12);
            before = shaft;
        }
    }
    parameters_set_defaults(&p);
    report("wheel_pid_step, V Q9", "100000 ticks drawn, full range", largest, 2.0);
}

int main(void) {
    parameters_set_defaults(&p);
    printf("%-38s %9s  %9s  %s\n", "function, unit of result", "error/LSB", "bound", "inputs");
    multiply();
    divide();
    trigonometry();
    square_root();
    inverse_kinematics();
    forward_kinematics();
    forces();
    motor();
    contact();
    rotation();
    pid();
    return failures ? 1 : 0;
}
