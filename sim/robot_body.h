/* robot_body.h - the plant as the board sees it: counters, supply, currents, bridges.
 *
 * For each tick at time_s: measure_supply, the firmware's tick, hold_duty(time_s),
 * run(time_s, kTick_s). */
#ifndef OMNISLIP_SIM_ROBOT_BODY_H
#define OMNISLIP_SIM_ROBOT_BODY_H

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "closed_loop.h"
#include "memory.h"
#include "robot_motion.h"

namespace omnislip {

class RobotBody {
  public:
    RobotBody(const std::vector<double> &values, const UserTermList &terms,
              const std::vector<Impulse> &impulses, double step_s, const BoardSensors &sensors)
        : values_(values),
          pending_(impulses),
          sensors_(sensors),
          step_s_(step_s),
          motion_(make_robot_motion(values_.data(), static_cast<int>(values_.size()), terms)),
          lags_(motion_->remembers() || motion_->delays()) {
        if (lags_)
            step_s_ = std::min(step_s_, kLagStep_s);
        rad_per_count_ = 2.0 * kPi / values_[RobotLayout::kBase - 1];
        hold_duty(-kTick_s);
        motion_->settle(x_, duty_.data(), in_);
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

    void currents_ma(std::int16_t *out) const {
        for (int i = 0; i < 4; ++i) {
            const long current_ma = std::lrint(in_.current_a[i] * 1e3);
            out[i] = static_cast<std::int16_t>(std::clamp(current_ma, -32768L, 32767L));
        }
    }

    void set_duty(const std::int16_t *duty_q15) {
        for (int i = 0; i < 4; ++i)
            duty_[static_cast<std::size_t>(i)] = duty_q15[i] / 32768.0;
    }

    void set_duty(const double *duty) {
        std::copy_n(duty, 4, duty_.begin());
    }

    /* The duty holds from now on; those before are kept because a late driver still acts on them,
     * for longer than any driver is late. */
    void hold_duty(double time_s) {
        if (times_s_.size() == static_cast<std::size_t>(kDutiesKept)) {
            times_s_.erase(times_s_.begin(), times_s_.end() - kDutiesKept / 2);
            duties_.erase(duties_.begin(), duties_.end() - kDutiesKept / 2);
        }
        times_s_.push_back(time_s);
        duties_.push_back(duty_);
        looked_ = false;
        if (times_s_.size() > 2 && jumps<RobotLayout>(duties_.back().data()))
            jump_s_ = time_s;
    }

    /* An impulse that falls into the time acts at its own instant: acting at a tick, it would come
     * a whole tick later if the robot were a hair late. */
    void run(double time_s, double duration_s) {
        double done_s = 0.0;
        while (!pending_.empty()) {
            double before[RobotLayout::kAll];
            std::copy_n(x_, RobotLayout::kAll, before);
            integrate(time_s + done_s, duration_s - done_s);
            double instant_s = kUnbounded;
            std::size_t next = 0;
            for (std::size_t i = 0; i < pending_.size(); ++i) {
                const double own_s =
                    instant(pending_[i], time_s, done_s, duration_s, before[RobotLayout::kPose]);
                if (own_s < instant_s) {
                    instant_s = own_s;
                    next = i;
                }
            }
            if (instant_s == kUnbounded)
                return;
            std::copy_n(before, RobotLayout::kAll, x_);
            integrate(time_s + done_s, instant_s - done_s);
            const Impulse &impulse = pending_[next];
            motion_->push(x_, impulse.x_n_s, impulse.y_n_s, impulse.theta_n_m_s);
            pending_.erase(pending_.begin() + static_cast<long>(next));
            done_s = instant_s;
        }
        integrate(time_s + done_s, duration_s - done_s);
    }

    /* Currents, slip and forces at the present state and duty. */
    void refresh(double time_s) {
        motion_->look(x_, duties(), time_s, in_);
        looked_ = !lags_;
        if (motion_->shows_late() || pose_times_s_.empty()) {
            pose_times_s_.push_back(time_s);
            poses_.insert(poses_.end(), x_ + RobotLayout::kPose, x_ + RobotLayout::kPose + 3);
        }
        const long last = static_cast<long>(pose_times_s_.size()) - 1;
        motion_->output(x_, time_s, {pose_times_s_.data(), poses_.data(), last}, sensed_);
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
    static constexpr std::ptrdiff_t kDutiesKept = 1 << 16;
    /* Lags are of second order in the step, whatever the rule, and the jump of a duty that acts
     * late falls into steps that are not fine. */
    static constexpr double kLagStep_s = 5e-4;

    void integrate(double time_s, double duration_s) {
        /* LoggedCommands::step_s without looking back, so that a replay takes the same steps */
        const bool jumped = jump_s_ > times_s_.back() - kJumpSettles_s;
        const double step_s = jumped ? jump_step_s(step_s_) : step_s_;
        /* With a memory as in a replay: teeth that meet are of no order. */
        const Rule rule = motion_->remembers() ? Rule::kRk4 : Rule::kMerson;
        motion_->advance(x_, duties(), time_s, duration_s, step_s, rule, looked_, in_);
        looked_ = false;
    }

    /* Time after `time_s` at which the impulse is due, without bound if it is not; x ran from
     * x_begin at done_s to what it is at the end of the duration. */
    double instant(const Impulse &impulse, double time_s, double done_s, double duration_s,
                   double x_begin) const {
        const double x_end = x_[RobotLayout::kPose];
        if (!impulse.at_x) {
            const double after_s = std::max(impulse.trigger - time_s, done_s);
            return after_s < duration_s ? after_s : kUnbounded;
        }
        if ((x_begin < impulse.trigger) == (x_end < impulse.trigger))
            return kUnbounded;
        const double share = (impulse.trigger - x_begin) / (x_end - x_begin);
        return done_s + share * (duration_s - done_s);
    }

    DutyHistory duties() const {
        return {times_s_.data(), duties_.front().data(), static_cast<long>(times_s_.size()) - 1};
    }

    std::vector<double> values_, times_s_;
    std::vector<std::array<double, 4>> duties_;
    std::vector<double> pose_times_s_, poses_; /* kept for a late camera */
    std::vector<Impulse> pending_;
    const BoardSensors &sensors_;
    double supply_error_v_ = 0.0;
    std::uint16_t supply_mv_ = 0;
    double step_s_;
    std::unique_ptr<RobotMotion> motion_;
    bool lags_; /* a duty acts late or for long */
    double x_[RobotLayout::kAll] = {};
    bool looked_ = false; /* at the instant and the duty with which the next step begins */
    double jump_s_ = 0.0; /* time of the last jump of the duty; the begin is one */
    std::array<double, 4> duty_ = {};
    double sensed_[RobotLayout::kOutputs] = {};
    RobotInternals<double> in_ = {};
    double rad_per_count_ = 0.0;
};

}  // namespace omnislip

#endif
