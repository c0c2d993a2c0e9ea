#include "virtual_robot.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace omnislip {
namespace {

constexpr double kBytesPerTick = 115200.0 / 10.0 * kTick_s;
constexpr std::size_t kReceiveBuffer = 64, kSendBuffer = 128;
constexpr double kSupplyStep_v = 33.0 / 1024, kCurrentStep_a = 0.064;
constexpr std::uint16_t kWriteTicks = 5; /* of a word of the EEPROM */

VirtualRobot *robot_of(void *context) {
    return static_cast<VirtualRobot *>(context);
}

/* Moves what the line passes in one tick; an idle line saves nothing up. */
template <class Pass>
void pass(std::deque<std::uint8_t> &from, double &credit, Pass &&pass_one) {
    credit += kBytesPerTick;
    for (; credit >= 1.0 && !from.empty(); credit -= 1.0) {
        pass_one(from.front());
        from.pop_front();
    }
    if (from.empty())
        credit = std::min(credit, 1.0);
}

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

}  // namespace

VirtualRobot::VirtualRobot(const std::vector<double> &values, const std::vector<UserTerm> &terms,
                           const std::vector<std::uint16_t> &store, double step_s)
    : terms_(terms),
      body_(values, {terms_.data(), static_cast<int>(terms_.size())}, {}, step_s, sensors_) {
    hal_host_store_blank(&store_, kWriteTicks);
    if (!store.empty() && store.size() != HAL_STORE_WORDS)
        throw std::invalid_argument("the store has the wrong number of words");
    std::copy(store.begin(), store.end(), store_.word);
    const hal_host_plant plant = hal(*this);
    hal_host_attach(&plant);
    robot_init(&robot_);
    hal_host_attach(nullptr);
}

hal_host_plant VirtualRobot::hal(VirtualRobot &self) {
    hal_host_plant hal = {};
    hal.context = &self;
    hal.read_encoder_counts = [](void *context, std::uint16_t counts[4]) {
        robot_of(context)->body_.counts(counts);
    };
    hal.read_supply_mv = [](void *context) { return robot_of(context)->supply_mv_; };
    hal.read_currents_ma = [](void *context, std::int16_t current_ma[4]) {
        std::copy_n(robot_of(context)->current_ma_, 4, current_ma);
    };
    hal.write_duty = [](void *context, const std::int16_t duty_q15[4]) {
        constexpr std::int16_t safe[4] = {};
        VirtualRobot *self = robot_of(context);
        self->body_.set_duty(self->bridges_on_ ? duty_q15 : safe);
    };
    hal.enable_bridges = [](void *context, std::uint16_t on) {
        robot_of(context)->bridges_on_ = on;
    };
    hal.serial_read = [](void *context, std::uint16_t *byte) {
        return robot_of(context)->read_byte(byte);
    };
    hal.serial_space = [](void *context) {
        return static_cast<std::uint16_t>(kSendBuffer - robot_of(context)->waiting_.size());
    };
    hal.serial_write = [](void *context, std::uint16_t byte) {
        robot_of(context)->waiting_.push_back(static_cast<std::uint8_t>(byte));
    };
    hal.serial_lost = [](void *context) {
        return std::exchange(robot_of(context)->lost_, std::uint16_t{0});
    };
    hal.store_busy = [](void *context) { return hal_host_store_busy(&robot_of(context)->store_); };
    hal.store_read = [](void *context, std::uint16_t address) {
        return hal_host_store_read(&robot_of(context)->store_, address);
    };
    hal.store_write = [](void *context, std::uint16_t address, std::uint16_t word) {
        hal_host_store_write(&robot_of(context)->store_, address, word);
    };
    return hal;
}

void VirtualRobot::measure() {
    const auto shown = [this](double value, double step) {
        return std::round(value / step + noise_(random_)) * step * 1e3;
    };
    supply_mv_ = static_cast<std::uint16_t>(
        std::clamp(shown(body_.supply_pin_v(), kSupplyStep_v), 0.0, 65535.0));
    for (std::size_t i = 0; i < 4; ++i) {
        current_ma_[i] = static_cast<std::int16_t>(
            std::clamp(shown(body_.current_a()[i], kCurrentStep_a), -32768.0, 32767.0));
    }
}

std::uint16_t VirtualRobot::read_byte(std::uint16_t *byte) {
    if (received_.empty())
        return 0;
    *byte = received_.front();
    received_.pop_front();
    return 1;
}

void VirtualRobot::deliver(std::vector<std::uint8_t> &delivered) {
    pass(to_robot_, credit_to_robot_, [&](std::uint8_t byte) {
        if (received_.size() < kReceiveBuffer) {
            received_.push_back(byte);
        } else if (lost_ < U16_MAX) {
            ++lost_;
        }
    });
    pass(waiting_, credit_from_robot_, [&](std::uint8_t byte) { delivered.push_back(byte); });
}

void VirtualRobot::note_command() {
    const HeldCommand now = command_of(robot_.loop, tick_);
    if (!now.same_as(held_))
        commands_.push_back(now);
    held_ = now;
}

std::vector<std::uint8_t> VirtualRobot::advance(long ticks, const std::vector<std::uint8_t> &sent) {
    std::vector<std::uint8_t> delivered;
    to_robot_.insert(to_robot_.end(), sent.begin(), sent.end());
    commands_.clear();
    const hal_host_plant plant = hal(*this);
    hal_host_attach(&plant);
    for (long k = 0; k < ticks; ++k) {
        const double time_s = static_cast<double>(tick_) * kTick_s;
        body_.refresh(time_s);
        measure();
        robot_tick(&robot_);
        note_command();
        body_.hold_duty(time_s);
        body_.run(time_s, kTick_s);
        deliver(delivered);
        ++tick_;
    }
    hal_host_attach(nullptr);
    return delivered;
}

std::vector<std::uint16_t> VirtualRobot::store() const {
    return std::vector<std::uint16_t>(store_.word, store_.word + HAL_STORE_WORDS);
}

}  // namespace omnislip
