/* Double precision plant; equations in reference_plant.h. */
#include "tests/firmware/reference_plant.h"

#include <math.h>
#include <string.h>

#include "hal/host/hal_host.h"

/* The fastest motion, a wheel against its floor, has a time constant of 1.9 ms. In a tick it decays
 * to 0.591; four steps of the midpoint rule make that 0.592, one makes it 0.612. */
#if INT_MAX == 32767 /* a simulated processor, for which this plant is much of the work */
#define STEPS_PER_TICK 1
#else
#define STEPS_PER_TICK 4
#endif

static const double pi = 3.14159265358979323846;
static const double bearing_cosine[4] = {0.8660254037844386, -0.8660254037844386,
                                         -0.8660254037844386, 0.8660254037844386};
static const double bearing_sine[4] = {0.5, 0.5, -0.5, -0.5};
static const double mass_kg = 20.0, inertia_kg_m2 = 0.55, radius_m = 0.05, distance_m = 0.2;
static const double gear = 12.0, resistance_ohm = 0.6, torque_constant = 0.0255;
static const double shaft_inertia_kg_m2 = 2.5e-5, viscous_nm_s = 1.5e-5;
static const double mu_roller = 0.05, stiffness_s_m = 40.0, counts_per_rev = 2000.0;

static double friction(double mu, double speed_m_s) {
    return mu * mass_kg * 9.81 / 4.0 * 2.0 / pi * atan(stiffness_s_m * speed_m_s);
}

static double current_a(const reference_plant *plant, const double *s, int wheel) {
    const double voltage_v = plant->bridges_on ? plant->supply_v * plant->duty[wheel] : 0.0;
    return plant->torque_gain[wheel] * (voltage_v - torque_constant * s[wheel]) / resistance_ohm;
}

static void derivative(const reference_plant *plant, const double *s, double *d) {
    const double vx = s[PLANT_VX], vy = s[PLANT_VY], w = s[PLANT_W];
    const double cosine = cos(s[PLANT_THETA]), sine = sin(s[PLANT_THETA]);
    double fx = 0.0, fy = 0.0, torque = 0.0;
    int i;
    for (i = 0; i < 4; i++) {
        const double c = bearing_cosine[i], sn = bearing_sine[i];
        const double slip = radius_m * s[i] / gear - (-sn * vx + c * vy + distance_m * w);
        const double drive_n = friction(plant->mu_drive, slip);
        const double roller_n = -friction(mu_roller, c * vx + sn * vy);
        const double dry_nm = plant->coulomb_nm > 0.0 ? plant->coulomb_nm * tanh(s[i] / 0.5) : 0.0;
        const double torque_nm = torque_constant * current_a(plant, s, i) - dry_nm;
        d[i] = (torque_nm - viscous_nm_s * s[i] - radius_m / gear * drive_n) / shaft_inertia_kg_m2;
        if (plant->shaft_blocked[i])
            d[i] = 0.0;
        d[PLANT_ANGLE + i] = s[i];
        fx += -sn * drive_n + c * roller_n;
        fy += c * drive_n + sn * roller_n;
        torque += distance_m * drive_n;
    }
    d[PLANT_VX] = fx / mass_kg + w * vy;
    d[PLANT_VY] = fy / mass_kg - w * vx;
    d[PLANT_W] = torque / inertia_kg_m2;
    d[PLANT_X] = cosine * vx - sine * vy;
    d[PLANT_Y] = sine * vx + cosine * vy;
    d[PLANT_THETA] = w;
}

static void advance(double *out, const double *s, const double *d, double h) {
    int i;
    for (i = 0; i < PLANT_STATES; i++)
        out[i] = s[i] + h * d[i];
}

static void midpoint_step(reference_plant *plant, double h) {
    double slope[PLANT_STATES], middle[PLANT_STATES];
    derivative(plant, plant->state, slope);
    advance(middle, plant->state, slope, h / 2.0);
    derivative(plant, middle, slope);
    advance(plant->state, plant->state, slope, h);
}

static void read_counts(void *context, uint16_t counts[4]) {
    reference_plant *plant = context;
    int i;
    for (i = 0; i < 4; i++) {
        const double angle_rad = plant->state[PLANT_ANGLE + i];
        plant->seen_angle_rad[i] +=
            plant->encoder_gain[i] * (angle_rad - plant->angle_before_rad[i]);
        plant->angle_before_rad[i] = angle_rad;
        counts[i] =
            (uint16_t)(int32_t)floor(plant->seen_angle_rad[i] / (2.0 * pi) * counts_per_rev);
    }
}

static uint16_t read_errors(void *context) {
    reference_plant *plant = context;
    const uint16_t errors = plant->encoder_errors;
    plant->encoder_errors = 0;
    return errors;
}

static void read_currents(void *context, int16_t current_ma[4]) {
    const reference_plant *plant = context;
    int i;
    for (i = 0; i < 4; i++) {
        const double ma = 1000.0 * (current_a(plant, plant->state, i) + plant->extra_current_a[i]);
        current_ma[i] = (int16_t)fmax(fmin(ma, 32767.0), -32768.0);
    }
}

static void enable_bridges(void *context, uint16_t on) {
    ((reference_plant *)context)->bridges_on = on;
}

static uint16_t read_bridge_faults(void *context) {
    return ((const reference_plant *)context)->bridge_faults;
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
    for (int i = 0; i < 4; i++)
        plant->encoder_gain[i] = plant->torque_gain[i] = 1.0;
}

void reference_plant_start(reference_plant *plant, control_loop *loop, const parameters *p) {
    reference_plant_attach(plant);
    control_loop_init(loop, p);
    control_loop_tick(loop);
    control_loop_arm(loop);
}

void reference_plant_attach(reference_plant *plant) {
    hal_host_plant host = {0};
    host.context = plant;
    host.read_encoder_counts = read_counts;
    host.write_duty = write_duty;
    host.read_supply_mv = read_supply;
    host.read_encoder_errors = read_errors;
    host.read_currents_ma = read_currents;
    host.enable_bridges = enable_bridges;
    host.read_bridge_faults = read_bridge_faults;
    hal_host_attach(&host);
}

void reference_plant_tick(reference_plant *plant, control_loop *loop) {
    int i;
    control_loop_tick(loop);
    for (i = 0; i < STEPS_PER_TICK; i++)
        midpoint_step(plant, 0.001 / STEPS_PER_TICK);
}
