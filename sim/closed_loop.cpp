#include "closed_loop.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>

#include "board/on_board.h"
#include "firmware/control_loop.h"
#include "hal/host/hal_host.h"
#include "integrator.h"
#include "robot_plant.h"

namespace omnislip {
namespace {

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) #name,
const char *const kParameterNames[] = {
#include "firmware/parameters.def"
};
#undef PARAMETER

/* The plant as the board sees it: counters, supply, bridges. */
class Robot {
  public:
    Robot(const std::vector<double> &values, const UserTermList &terms, double step_s,
          const BoardSensors &sensors)
        : values_(values), sensors_(sensors), step_s_(step_s) {
        bool active[kEffectCount] = {};
        for_each_effect(RobotLayout::kMotors, [&](auto effect, int index, int slot) {
            using E = decltype(effect);
            const int stride = effect_stride(E::info, RobotLayout::kMotors);
            for (int k = 0; k < E::info.parameter_count * stride; ++k) {
                const double value =
                    values_[static_cast<std::size_t>(RobotLayout::kBase + slot + k)];
                active[index] = active[index] || value != E::info.parameters[k / stride].neutral;
            }
        });
        plant_.prepare(values_.data(), active, terms);
        rate_1_s_ = plant_.fastest_rate_1_s();
        rad_per_count_ = 2.0 * kPi / values_[RobotLayout::kBase - 1];
        hold_duty(-kTick_s);
        settle(plant_, x_, duty_, 0.0, in_);
        refresh(0.0);
        measure_supply(0);
    }

    void counts(std::uint16_t *out) const {
        const std::array<double, 4> shaft = shaft_counts();
        for (std::size_t i = 0; i < 4; ++i)
            out[i] = static_cast<std::uint16_t>(static_cast<std::int64_t>(std::floor(shaft[i])));
    }

    std::array<double, 4> shaft_counts() const {
        std::array<double, 4> shaft;
        for (int i = 0; i < 4; ++i)
            shaft[static_cast<std::size_t>(i)] =
                x_[RobotLayout::kAngle + i] / rad_per_count_ + sensors_.encoder_start_counts[i];
        return shaft;
    }

    /* What the converter shows in this tick. */
    void measure_supply(std::size_t tick) {
        supply_error_v_ = sensors_.supply_error_v.empty() ? 0.0 : sensors_.supply_error_v[tick];
        const double step_v = sensors_.supply_resolution_v;
        const double shown_v = std::round(supply_pin_v() / step_v) * step_v;
        supply_mv_ = static_cast<std::uint16_t>(std::clamp(std::lround(shown_v * 1e3), 0L, 65535L));
    }
    std::uint16_t supply_mv() const {
        return supply_mv_;
    }

    void set_duty(const std::int16_t *duty_q15) {
        for (int i = 0; i < 4; ++i)
            duty_[i] = duty_q15[i] / 32768.0;
    }

    void set_duty(const double *duty) {
        std::copy_n(duty, 4, duty_);
    }

    /* The duty holds from now on; all of them are kept because a late driver still acts on them. */
    void hold_duty(double time_s) {
        times_s_.push_back(time_s);
        duties_.insert(duties_.end(), duty_, duty_ + 4);
    }

    void push(const Impulse &impulse) {
        const auto &c = plant_.constants();
        const double theta = x_[RobotLayout::kPose + 2];
        const double cos_theta = std::cos(theta), sin_theta = std::sin(theta);
        const double jx = cos_theta * impulse.x_n_s + sin_theta * impulse.y_n_s;
        const double jy = cos_theta * impulse.y_n_s - sin_theta * impulse.x_n_s;
        const double turn = impulse.theta_n_m_s / c.inertia_kg_m2;
        double *v = x_ + RobotLayout::kVelocity;
        v[0] += jx / c.mass_kg + turn * c.cog_y_m;
        v[1] += jy / c.mass_kg - turn * c.cog_x_m;
        v[2] += turn;
    }

    void run(double time_s, double duration_s) {
        advance(plant_, x_, commands(), time_s, duration_s, step_s_, rate_1_s_, in_);
    }

    /* Currents, slip and forces at the present state and duty. */
    void refresh(double time_s) {
        double command[4], dx[RobotLayout::kAll];
        commands()(time_s, time_s, command);
        look(plant_, x_, command, time_s, dx, in_);
        plant_.output(x_, time_s, sensed_);
    }

    const double *state() const {
        return x_;
    }
    const double *current_a() const {
        return in_.current_a;
    }
    /* What the board's converter is given. */
    double supply_pin_v() const {
        return in_.bus_v + supply_error_v_;
    }
    const double *sensed() const {
        return sensed_;
    }
    const RobotInternals<double> &internals() const {
        return in_;
    }

  private:
    LoggedCommands<RobotPlant<double>> commands() const {
        return {plant_, times_s_.data(), duties_.data(), static_cast<long>(times_s_.size()) - 1};
    }

    std::vector<double> values_, times_s_, duties_;
    const BoardSensors &sensors_;
    double supply_error_v_ = 0.0;
    std::uint16_t supply_mv_ = 0;
    double step_s_;
    RobotPlant<double> plant_;
    double x_[RobotLayout::kAll] = {};
    double duty_[4] = {};
    double sensed_[RobotLayout::kOutputs] = {};
    RobotInternals<double> in_ = {};
    double rate_1_s_ = 0.0, rad_per_count_ = 0.0;
};

void read_counts(void *context, std::uint16_t counts[4]) {
    static_cast<const Robot *>(context)->counts(counts);
}
void write_duty(void *context, const std::int16_t duty_q15[4]) {
    static_cast<Robot *>(context)->set_duty(duty_q15);
}
std::uint16_t read_supply(void *context) {
    return static_cast<const Robot *>(context)->supply_mv();
}

void read_currents(void *context, std::int16_t current_ma[4]) {
    const double *current_a = static_cast<const Robot *>(context)->internals().current_a;
    for (int i = 0; i < 4; ++i) {
        current_ma[i] =
            static_cast<std::int16_t>(std::clamp(std::lround(current_a[i] * 1e3), -32768L, 32767L));
    }
}

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

void give(control_loop *loop, const Command &command) {
    const double *v = command.value;
    if (command.kind == Command::kVelocity) {
        control_loop_command_velocity(loop, to_i16(v[0] * 1e3, "a velocity"),
                                      to_i16(v[1] * 1e3, "a velocity"),
                                      to_i16(v[2] * 1e3, "an angular velocity"));
    } else if (command.kind == Command::kPose) {
        const odometry_pose goal = to_pose(v);
        const kinematics_velocity arrival = to_velocity(v + 3);
        if (control_loop_command_pose(loop, &goal, &arrival) == TRAJECTORY_TOO_FAR) {
            throw std::invalid_argument("a commanded pose cannot be reached within 60 s");
        }
    } else if (command.kind == Command::kDuty) {
        i16 duty_q15[4];
        for (int i = 0; i < 4; ++i) {
            duty_q15[i] = to_i16(std::min(v[i] * 32768.0, 32767.0), "a duty");
        }
        control_loop_command_duty(loop, duty_q15);
    } else {
        control_loop_stop(loop);
    }
}

void append(std::vector<double> &to, const double *from, int count) {
    to.insert(to.end(), from, from + count);
}

void record_robot(ClosedLoopLog &log, double time_s, const Robot &robot) {
    const double *x = robot.state();
    const RobotInternals<double> &in = robot.internals();
    log.time_s.push_back(time_s);
    append(log.pose, x + RobotLayout::kPose, 3);
    append(log.velocity, x + RobotLayout::kVelocity, 3);
    append(log.wheel_speed_rad_s, x + RobotLayout::kSpeed, 4);
    append(log.current_a, in.current_a, 4);
    append(log.slip_m_s, in.slip_m_s, 4);
    append(log.drive_force_n, in.drive_force_n, 4);
    log.supply_v.push_back(in.bus_v);
    log.gyro_rad_s.push_back(robot.sensed()[4]);
    append(log.camera_pose, robot.sensed() + 5, 3);
}

void record_firmware(ClosedLoopLog &log, const control_loop_telemetry &telemetry) {
    for (const i16 duty_q15 : telemetry.duty_q15)
        log.duty.push_back(duty_q15 / 32768.0);
    log.encoder_counts.insert(log.encoder_counts.end(), telemetry.encoder_counts,
                              telemetry.encoder_counts + 4);
    const double mm_q13 = 1e-3 / 8192.0;
    const double believed[3] = {telemetry.pose.x_mm_q13 * mm_q13, telemetry.pose.y_mm_q13 * mm_q13,
                                telemetry.pose.theta_mrad_q13 * mm_q13};
    append(log.odometry, believed, 3);
    log.limited.push_back(static_cast<std::int32_t>(telemetry.limit));
    log.limit_wheel.push_back(telemetry.limit_wheel);
    log.fault.push_back(static_cast<std::int32_t>(telemetry.fault));
    log.fault_wheel.push_back(telemetry.fault_wheel);
}

bool due(const Impulse &impulse, double time_s, double x_before, double x_now) {
    if (!impulse.at_x)
        return time_s >= impulse.trigger;
    return (x_before < impulse.trigger) != (x_now < impulse.trigger);
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

ClosedLoopLog run_closed_loop(const std::vector<double> &values,
                              const std::vector<std::int32_t> &firmware,
                              const std::vector<Command> &commands,
                              const std::vector<Impulse> &impulses, double duration_s,
                              double step_s, const BoardSensors &sensors, Carrier carrier,
                              const UserTermList &terms) {
    parameters settings;
    parameters_set_defaults(&settings);
    for (int id = 0; id < PARAMETER_COUNT; ++id) {
        if (parameters_set(&settings, static_cast<u16>(id),
                           firmware[static_cast<std::size_t>(id)]) != PARAMETERS_OK) {
            throw std::invalid_argument(std::string("firmware parameter ") + kParameterNames[id] +
                                        " is out of its range");
        }
    }
    Robot robot(values, terms, step_s, sensors);
    hal_host_plant hal = {};
    hal.context = &robot;
    hal.read_encoder_counts = read_counts;
    hal.write_duty = write_duty;
    hal.read_supply_mv = read_supply;
    hal.read_currents_ma = read_currents;
    hal_host_attach(&hal);
    std::unique_ptr<OnBoard<Robot>> board;
    if (carrier == Carrier::kBoard) {
        board = std::make_unique<OnBoard<Robot>>(robot);
        board->wait_for_tick(-kTick_s);
    }
    control_loop loop;
    control_loop_init(&loop, &settings);
    control_loop_tick(&loop); /* BOOT -> IDLE */
    control_loop_arm(&loop);

    ClosedLoopLog log;
    std::vector<bool> given(impulses.size(), false);
    std::size_t next = 0;
    double x_before = 0.0;
    const long ticks = closed_loop_ticks(duration_s);
    for (long k = 0; k < ticks; ++k) {
        const double time_s = static_cast<double>(k) * kTick_s;
        robot.measure_supply(static_cast<std::size_t>(k));
        if (board)
            board->wait_for_tick(time_s);
        while (next < commands.size() && commands[next].time_s <= time_s + 1e-9)
            ++next;
        if (next > 0)
            give(&loop, commands[next - 1]);
        const double x_now = robot.state()[RobotLayout::kPose];
        for (std::size_t i = 0; i < impulses.size(); ++i) {
            if (given[i] || !due(impulses[i], time_s, x_before, x_now))
                continue;
            robot.push(impulses[i]);
            given[i] = true;
        }
        x_before = x_now;
        if (board) {
            robot.refresh(time_s);
            record_robot(log, time_s, robot);
            control_loop_tick(&loop);
        } else {
            control_loop_tick(&loop);
            robot.hold_duty(time_s);
            robot.refresh(time_s);
            record_robot(log, time_s, robot);
            robot.run(time_s, kTick_s);
        }
        record_firmware(log, loop.telemetry);
    }
    hal_host_attach(nullptr);
    return log;
}

}  // namespace omnislip
