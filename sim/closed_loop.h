/* closed_loop.h - the firmware drives the plant: the same C sources as on the board, tick by tick.
 *
 * At t = k ms the firmware reads the counters and the supply and writes four duties; the plant runs
 * 1 ms under them (the computing time of the tick is not modelled). Commands are repeated every
 * tick, as a host does that keeps the command timeout away. An impulse is a jump of the body's
 * momentum, given in the world frame at the centre of gravity, at a time or where the body passes
 * an x, between two ticks where that is so: the row of a tick does not yet show an impulse at it.
 */
#ifndef OMNISLIP_SIM_CLOSED_LOOP_H
#define OMNISLIP_SIM_CLOSED_LOOP_H

#include <cstdint>
#include <vector>

#include "board/counters.h"
#include "firmware/parameters.h"
#include "user_terms.h"

namespace omnislip {

constexpr double kTick_s = 1e-3;

struct Command {
    enum Kind { kStop, kVelocity, kPose, kDuty };
    double time_s = 0.0;
    Kind kind = kStop;
    double value[6] = {}; /* velocity: vx vy w; pose: x y theta vx vy w; duty: four */
};

struct Impulse {
    bool at_x = false;
    double trigger = 0.0; /* time [s] or world x [m] */
    double x_n_s = 0.0, y_n_s = 0.0, theta_n_m_s = 0.0;
};

/* What carries the firmware: the plant itself, exactly on time; or the drivers on the virtual
 * LF2407A (board/board.h) with the plant at its pins. On the board the recorded robot is that of
 * the tick's begin, under the duty of before. */
enum class Carrier { kPlant, kBoard };

/* Errors of the sensors that the firmware reads. */
struct BoardSensors {
    double encoder_start_counts[4] =
        {}; /* counters at t = 0; the fraction is the phase in a count */
    std::vector<double> supply_error_v; /* one per tick, or empty for none */
    double supply_resolution_v = 1e-3;  /* the firmware's word holds whole mV; not on the board,
                                        whose converter has its own */
};

/* One entry per tick; vectors of several columns are row major. */
struct ClosedLoopLog {
    std::vector<double> time_s, duty, pose, velocity, wheel_speed_rad_s, current_a, slip_m_s;
    std::vector<double> drive_force_n, supply_v, gyro_rad_s, camera_pose, odometry;
    std::vector<std::uint16_t> encoder_counts;
    std::vector<std::int32_t> limited, limit_wheel, fault, fault_wheel; /* control_loop.h */
};

/* Control ticks of a run. */
long closed_loop_ticks(double duration_s);

/* `values`: parameter set of RobotPlant with the user's `terms`; `firmware`: raw value per
 * parameter id, PARAMETER_COUNT of them. Throws std::invalid_argument when the firmware refuses a
 * parameter or a command. `make_counters`: other encoder counters on the board's bus. */
ClosedLoopLog run_closed_loop(const std::vector<double> &values,
                              const std::vector<std::int32_t> &firmware,
                              const std::vector<Command> &commands,
                              const std::vector<Impulse> &impulses, double duration_s,
                              double step_s, const BoardSensors &sensors = {},
                              Carrier carrier = Carrier::kPlant, const UserTermList &terms = {},
                              const CountersMaker &make_counters = {});

/* Parameters of the firmware from the raw value per id; throws as run_closed_loop does. */
parameters to_settings(const std::vector<std::int32_t> &firmware);

/* Name of the firmware parameter `id`. */
const char *firmware_parameter_name(int id);
int firmware_parameter_count();

}  // namespace omnislip

#endif
