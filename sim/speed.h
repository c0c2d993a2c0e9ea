/* speed.h - what a step of each model and a tick of the firmware cost on this machine, for the
 * benchmark. Each is the least of many short measurements: what it costs when nothing disturbs.
 */
#ifndef OMNISLIP_SIM_SPEED_H
#define OMNISLIP_SIM_SPEED_H

#include <cstdint>
#include <vector>

namespace omnislip {

/* Nanoseconds per RK4 step of 0.5 ms under a constant command; `values` as for run_closed_loop. */
double rigid_step_ns(const std::vector<double> &values);
double slip_step_ns(const std::vector<double> &values);
/* The nominal axis, and a robot of four wheels followed by its encoders. */
double axis_step_ns();
double odometry_step_ns();
/* Nanoseconds per control tick that follows a velocity command with simple shafts; throws
 * std::runtime_error when the firmware stops. */
double firmware_tick_ns(const std::vector<std::int32_t> &firmware);

}  // namespace omnislip

#endif
