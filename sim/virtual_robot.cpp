#include "virtual_robot.h"

#include <stdexcept>

#include "hal/hal.h"

namespace omnislip {
namespace {

HeldCommand command_of(const control_loop &loop, long tick) {
    HeldCommand held;
    held.tick = tick;
    held.mode = loop.telemetry.mode;
    const kinematics_velocity &v = loop.command_velocity;
    const kinematics_velocity &arrival = loop.command_arrival;
    const odometry_pose &pose = loop.command_pose;
    const i16 *duty = loop.command_duty_q15;
    if (held.mode == CONTROL_MODE_VELOCITY) {
        held.value = {v.x_m_s_q13, v.y_m_s_q13, v.omega_rad_s_q11};
    } else if (held.mode == CONTROL_MODE_POSE) {
        held.value = {pose.x_mm_q13,     pose.y_mm_q13,     pose.theta_mrad_q13,
                      arrival.x_m_s_q13, arrival.y_m_s_q13, arrival.omega_rad_s_q11};
    } else if (held.mode == CONTROL_MODE_DUTY) {
        held.value = {duty[0], duty[1], duty[2], duty[3]};
    }
    return held;
}

std::unique_ptr<RobotCarrier> carry(Carrier carrier, RobotBody &body,
                                    const std::vector<std::uint16_t> &store) {
    if (!store.empty() && store.size() != HAL_STORE_WORDS)
        throw std::invalid_argument("the store has the wrong number of words");
    return carrier == Carrier::kBoard ? carry_on_board(body, store) : carry_on_stub(body, store);
}

}  // namespace

VirtualRobot::VirtualRobot(const std::vector<double> &values, const std::vector<UserTerm> &terms,
                           const std::vector<std::uint16_t> &store, double step_s, Carrier carrier)
    : terms_(terms),
      body_(values, {terms_.data(), static_cast<int>(terms_.size())}, {}, step_s, sensors_),
      carrier_(carry(carrier, body_, store)) {
    carrier_->with_hal([this] {
        robot_init(&robot_);
        carrier_->start_tick();
    });
}

void VirtualRobot::note_command() {
    const HeldCommand now = command_of(robot_.loop, tick_);
    if (!now.same_as(held_))
        commands_.push_back(now);
    held_ = now;
}

std::vector<std::uint8_t> VirtualRobot::advance(long ticks, const std::vector<std::uint8_t> &sent) {
    commands_.clear();
    carrier_->send(sent);
    carrier_->with_hal([&] {
        for (long k = 0; k < ticks; ++k) {
            robot_tick(&robot_);
            note_command();
            carrier_->run_to_tick(++tick_);
        }
    });
    return carrier_->take_received();
}

}  // namespace omnislip
