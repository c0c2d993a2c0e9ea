#include "closed_loop.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>

#include "board/on_board.h"
#include "firmware/control_loop.h"
#include "motion_hal.h"
#include "robot_body.h"

namespace omnislip {
namespace {

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) #name,
const char *const kParameterNames[] = {
#include "firmware/parameters.def"
};
#undef PARAMETER

i16 to_i16(double value, const char *what) {
    const double rounded = std::round(value);
    if (!(rounded >= -32768.0 && rounded <= 32767.0)) {
        throw std::invalid_argument(std::string(what) + " is out of the firmware's range");
    }
    return static_cast<i16>(rounded);
}

odometry_pose to_pose(const double *value) {
    odometry_pose pose;
    const double q13 = 8192.0 * 1e3; /* mm Q13, mrad Q13 */
    for (int i = 0; i < 2; ++i) {
        if (!(std::abs(value[i]) < 250.0)) {
            throw std::invalid_argument("a commanded place is farther than 250 m");
        }
    }
    pose.x_mm_q13 = static_cast<i32>(std::lround(value[0] * q13));
    pose.y_mm_q13 = static_cast<i32>(std::lround(value[1] * q13));
    pose.theta_mrad_q13 = static_cast<i32>(std::lround(std::remainder(value[2], 2 * kPi) * q13));
    return pose;
}

kinematics_velocity to_velocity(const double *value) {
    kinematics_velocity velocity;
    velocity.x_m_s_q13 = to_i16(value[0] * 8192.0, "an arrival velocity");
    velocity.y_m_s_q13 = to_i16(value[1] * 8192.0, "an arrival velocity");
    velocity.omega_rad_s_q11 = to_i16(value[2] * 2048.0, "an arrival velocity");
    return velocity;
}

/* A command in the formats of the firmware. */
struct FirmwareCommand {
    Command::Kind kind = Command::kStop;
    i16 velocity[3]; /* mm/s, mm/s, mrad/s */
    odometry_pose goal;
    kinematics_velocity arrival;
    i16 duty_q15[4];
};

FirmwareCommand to_firmware(const Command &command) {
    const double *v = command.value;
    FirmwareCommand result;
    result.kind = command.kind;
    if (command.kind == Command::kVelocity) {
        for (int i = 0; i < 3; ++i)
            result.velocity[i] = to_i16(v[i] * 1e3, i < 2 ? "a velocity" : "an angular velocity");
    } else if (command.kind == Command::kPose) {
        result.goal = to_pose(v);
        result.arrival = to_velocity(v + 3);
    } else if (command.kind == Command::kDuty) {
        for (int i = 0; i < 4; ++i)
            result.duty_q15[i] = to_i16(std::min(v[i] * 32768.0, 32767.0), "a duty");
    }
    return result;
}

void give(control_loop *loop, const FirmwareCommand &command) {
    const i16 *v = command.velocity;
    if (command.kind == Command::kVelocity) {
        control_loop_command_velocity(loop, v[0], v[1], v[2]);
    } else if (command.kind == Command::kPose) {
        if (control_loop_command_pose(loop, &command.goal, &command.arrival) ==
            TRAJECTORY_TOO_FAR) {
            throw std::invalid_argument("a commanded pose cannot be reached within 60 s");
        }
    } else if (command.kind == Command::kDuty) {
        control_loop_command_duty(loop, command.duty_q15);
    } else {
        control_loop_stop(loop);
    }
}

void allocate(ClosedLoopLog &log, std::size_t ticks) {
    for (std::vector<double> *one : {&log.time_s, &log.supply_v, &log.gyro_rad_s})
        one->resize(ticks);
    for (std::vector<double> *three : {&log.pose, &log.velocity, &log.camera_pose, &log.odometry})
        three->resize(3 * ticks);
    for (std::vector<double> *four :
         {&log.duty, &log.wheel_speed_rad_s, &log.current_a, &log.slip_m_s, &log.drive_force_n})
        four->resize(4 * ticks);
    log.encoder_counts.resize(4 * ticks);
    for (std::vector<std::int32_t> *one :
         {&log.limited, &log.limit_wheel, &log.fault, &log.fault_wheel})
        one->resize(ticks);
}

/* Row `tick` of a table with `kColumns` columns: known when compiled, it takes no call. */
template <int kColumns, class T>
void put_row(std::vector<T> &table, std::size_t tick, const T *row) {
    T *place = table.data() + tick * kColumns;
    for (int i = 0; i < kColumns; ++i)
        place[i] = row[i];
}

void record_robot(ClosedLoopLog &log, std::size_t tick, const RobotBody &robot) {
    const double *x = robot.state();
    const RobotInternals<double> &in = robot.internals();
    log.time_s[tick] = static_cast<double>(tick) * kTick_s;
    log.supply_v[tick] = in.bus_v;
    log.gyro_rad_s[tick] = robot.sensed()[4];
    put_row<3>(log.pose, tick, x + RobotLayout::kPose);
    put_row<3>(log.velocity, tick, x + RobotLayout::kVelocity);
    put_row<4>(log.wheel_speed_rad_s, tick, x + RobotLayout::kSpeed);
    put_row<4>(log.current_a, tick, in.current_a);
    put_row<4>(log.slip_m_s, tick, in.slip_m_s);
    put_row<4>(log.drive_force_n, tick, in.drive_force_n);
    put_row<3>(log.camera_pose, tick, robot.sensed() + 5);
}

void record_firmware(ClosedLoopLog &log, std::size_t tick,
                     const control_loop_telemetry &telemetry) {
    const double mm_q13 = 1e-3 / 8192.0;
    const double believed[3] = {telemetry.pose.x_mm_q13 * mm_q13, telemetry.pose.y_mm_q13 * mm_q13,
                                telemetry.pose.theta_mrad_q13 * mm_q13};
    for (std::size_t i = 0; i < 4; ++i)
        log.duty[4 * tick + i] = telemetry.duty_q15[i] / 32768.0;
    put_row<4>(log.encoder_counts, tick, telemetry.encoder_counts);
    put_row<3>(log.odometry, tick, believed);
    log.limited[tick] = static_cast<std::int32_t>(telemetry.limit);
    log.limit_wheel[tick] = telemetry.limit_wheel;
    log.fault[tick] = static_cast<std::int32_t>(telemetry.fault);
    log.fault_wheel[tick] = telemetry.fault_wheel;
}

}  // namespace

long closed_loop_ticks(double duration_s) {
    return std::lround(duration_s / kTick_s);
}

const char *firmware_parameter_name(int id) {
    return kParameterNames[id];
}
int firmware_parameter_count() {
    return PARAMETER_COUNT;
}

parameters to_settings(const std::vector<std::int32_t> &firmware) {
    parameters settings;
    parameters_set_defaults(&settings);
    for (int id = 0; id < PARAMETER_COUNT; ++id) {
        if (parameters_set(&settings, static_cast<u16>(id),
                           firmware[static_cast<std::size_t>(id)]) != PARAMETERS_OK) {
            throw std::invalid_argument(std::string("firmware parameter ") + kParameterNames[id] +
                                        " is out of its range");
        }
    }
    return settings;
}

ClosedLoopLog run_closed_loop(const std::vector<double> &values,
                              const std::vector<std::int32_t> &firmware,
                              const std::vector<Command> &commands,
                              const std::vector<Impulse> &impulses, double duration_s,
                              double step_s, const BoardSensors &sensors, Carrier carrier,
                              const UserTermList &terms, const CountersMaker &make_counters) {
    const parameters settings = to_settings(firmware);
    RobotBody robot(values, terms, impulses, step_s, sensors);
    const MotionHal<RobotBody> hal(robot);
    std::unique_ptr<OnBoard<RobotBody>> board;
    if (carrier == Carrier::kBoard) {
        board = std::make_unique<OnBoard<RobotBody>>(robot, make_counters);
        board->wait_for_tick(-kTick_s);
    }
    control_loop loop;
    control_loop_init(&loop, &settings);
    control_loop_tick(&loop); /* BOOT -> IDLE */
    control_loop_arm(&loop);

    ClosedLoopLog log;
    FirmwareCommand given;
    std::size_t next = 0;
    const std::size_t ticks = static_cast<std::size_t>(closed_loop_ticks(duration_s));
    allocate(log, ticks);
    for (std::size_t k = 0; k < ticks; ++k) {
        const double time_s = static_cast<double>(k) * kTick_s;
        robot.measure_supply(k);
        if (board)
            board->wait_for_tick(time_s);
        while (next < commands.size() && commands[next].time_s <= time_s + 1e-9)
            given = to_firmware(commands[next++]);
        if (next > 0)
            give(&loop, given);
        if (board) {
            robot.refresh(time_s);
            record_robot(log, k, robot);
            control_loop_tick(&loop);
        } else {
            control_loop_tick(&loop);
            robot.hold_duty(time_s);
            robot.refresh(time_s);
            record_robot(log, k, robot);
            robot.run(time_s, kTick_s);
        }
        record_firmware(log, k, loop.telemetry);
    }
    return log;
}

}  // namespace omnislip
