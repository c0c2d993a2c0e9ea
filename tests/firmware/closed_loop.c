/* Driving the firmware in closed loop; see closed_loop.h. */
#include "tests/firmware/closed_loop.h"

#include <math.h>

parameters p;
control_loop loop;
reference_plant plant;

void start(i16 slip_compensation) {
    parameters_set_defaults(&p);
    parameters_set(&p, PARAMETER_ID_slip_compensation, slip_compensation);
    reference_plant_reset(&plant);
    reference_plant_start(&plant, &loop, &p);
}

void drive(i16 x_mm_s, i16 y_mm_s, i16 omega_mrad_s, int ticks) {
    for (int n = 0; n < ticks; n++) {
        if (n % 100 == 0)
            control_loop_command_velocity(&loop, x_mm_s, y_mm_s, omega_mrad_s);
        reference_plant_tick(&plant, &loop);
    }
}

double believed_x_mm(void) {
    return loop.telemetry.pose.x_mm_q13 / 8192.0;
}

double believed_y_mm(void) {
    return loop.telemetry.pose.y_mm_q13 / 8192.0;
}

double true_x_mm(void) {
    return plant.state[PLANT_X] * 1000.0;
}

double true_y_mm(void) {
    return plant.state[PLANT_Y] * 1000.0;
}

double largest_duty(void) {
    double largest = 0.0;
    for (int i = 0; i < 4; i++)
        largest = fmax(largest, fabs(plant.duty[i]));
    return largest;
}
