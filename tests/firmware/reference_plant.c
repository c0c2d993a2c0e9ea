/* Double precision plant; equations in reference_plant.h. */
#include "tests/firmware/reference_plant.h"

#include <math.h>
#include <string.h>

#include "hal/host/hal_host.h"

static const double pi = 3.14159265358979323846;
static const double bearing_rad[4] = {0.5235987755982988, 2.6179938779914944, 3.6651914291880923,
                                      5.759586531581287};
static const double mass_kg = 20.0, inertia_kg_m2 = 0.55, radius_m = 0.05, distance_m = 0.2;
static const double gear = 12.0, resistance_ohm = 0.6, torque_constant = 0.0255;
static const double shaft_inertia_kg_m2 = 2.5e-5, viscous_nm_s = 1.5e-5;
static const double mu_roller = 0.05, stiffness_s_m = 40.0, counts_per_rev = 2000.0;

static double friction(double mu, double speed_m_s) {
    return mu * mass_kg * 9.81 / 4.0 * 2.0 / pi * atan(stiffness_s_m * speed_m_s);
}

static void derivative(const reference_plant *plant, const double *s, double *d) {
    const double vx = s[PLANT_VX], vy = s[PLANT_VY], w = s[PLANT_W], theta = s[PLANT_THETA];
    double fx = 0.0, fy = 0.0, torque = 0.0;
    int i;
    for (i = 0; i < 4; i++) {
        const double c = cos(bearing_rad[i]), sn = sin(bearing_rad[i]);
        const double slip = radius_m * s[i] / gear - (-sn * vx + c * vy + distance_m * w);
        const double drive_n = friction(plant->mu_drive, slip);
        const double roller_n = -friction(mu_roller, c * vx + sn * vy);
        const double current =
            (plant->supply_v * plant->duty[i] - torque_constant * s[i]) / resistance_ohm;
        d[i] = (torque_constant * current - viscous_nm_s * s[i] - radius_m / gear * drive_n) /
               shaft_inertia_kg_m2;
        d[PLANT_ANGLE + i] = s[i];
        fx += -sn * drive_n + c * roller_n;
        fy += c * drive_n + sn * roller_n;
        torque += distance_m * drive_n;
    }
    d[PLANT_VX] = fx / mass_kg + w * vy;
    d[PLANT_VY] = fy / mass_kg - w * vx;
    d[PLANT_W] = torque / inertia_kg_m2;
    d[PLANT_X] = cos(theta) * vx - sin(theta) * vy;
    d[PLANT_Y] = sin(theta) * vx + cos(theta) * vy;
    d[PLANT_THETA] = w;
}

static void advance(double *out, const double *s, const double *d, double h) {
    int i;
    for (i = 0; i < PLANT_STATES; i++)
        out[i] = s[i] + h * d[i];
}

static void runge_kutta_step(reference_plant *plant, double h) {
    double k1[PLANT_STATES], k2[PLANT_STATES], k3[PLANT_STATES], k4[PLANT_STATES];
    double trial[PLANT_STATES];
    int i;
    derivative(plant, plant->state, k1);
    advance(trial, plant->state, k1, h / 2.0);
    derivative(plant, trial, k2);
    advance(trial, plant->state, k2, h / 2.0);
    derivative(plant, trial, k3);
    advance(trial, plant->state, k3, h);
    derivative(plant, trial, k4);
    for (i = 0; i < PLANT_STATES; i++) {
        plant->state[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    }
}

static void read_counts(void *context, uint16_t counts[4]) {
    const reference_plant *plant = context;
    int i;
    for (i = 0; i < 4; i++) {
        const double count = floor(plant->state[PLANT_ANGLE + i] / (2.0 * pi) * counts_per_rev);
        counts[i] = (uint16_t)(int32_t)count;
    }
}

static void write_duty(void *context, const int16_t duty_q15[4]) {
    reference_plant *plant = context;
    int i;
    for (i = 0; i < 4; i++)
        plant->duty[i] = duty_q15[i] / 32768.0;
}

static uint16_t read_supply(void *context) {
    return (uint16_t)(((const reference_plant *)context)->supply_v * 1000.0);
}

void reference_plant_reset(reference_plant *plant) {
    memset(plant, 0, sizeof *plant);
    plant->supply_v = 24.0;
    plant->mu_drive = 0.6;
}

void reference_plant_attach(reference_plant *plant) {
    hal_host_plant host = {0};
    host.context = plant;
    host.read_encoder_counts = read_counts;
    host.write_duty = write_duty;
    host.read_supply_mv = read_supply;
    hal_host_attach(&host);
}

void reference_plant_tick(reference_plant *plant, control_loop *loop) {
    int i;
    control_loop_tick(loop);
    for (i = 0; i < 4; i++)
        runge_kutta_step(plant, 0.00025);
}
