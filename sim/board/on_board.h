/* on_board.h - a robot's body on the virtual board: bridges, encoders, currents, supply.
 *
 * Body needs: run(time_s, duration_s), refresh(time_s), set_duty(duty), hold_duty(time_s),
 * shaft_counts(), current_a(), supply_pin_v(). It is run lazily, to every instant at which the
 * board looks at it or a bridge changes.
 *
 * Scales of currents and supply are those of hal/lf2407a/analog.c.
 */
#ifndef OMNISLIP_SIM_BOARD_ON_BOARD_H
#define OMNISLIP_SIM_BOARD_ON_BOARD_H

#include <array>
#include <cmath>
#include <memory>
#include <random>
#include <stdexcept>

#include "board/board.h"
#include "board/board_hal.h"
#include "board/converter.h"
#include "board/counters.h"
#include "hal/lf2407a/drivers.h"

namespace omnislip {

template <class Body>
class OnBoard : public BoardSurroundings, public EncoderSource {
  public:
    /* The drivers are started; the tick comes with wait_for_tick. Without a maker the counters are
     * BehaviouralCounters. `analog_noise_v`: standard deviation of what the converter is given. */
    explicit OnBoard(Body &body, const CountersMaker &make_counters = {},
                     double analog_noise_v = 0.0)
        : body_(body),
          counters_(make_counters ? make_counters(*this)
                                  : std::make_unique<BehaviouralCounters>(*this)),
          board_(*this, *counters_, board_vectors()),
          analog_noise_v_(analog_noise_v) {
        board_.attach();
        hal_host_attach(&board_hal());
        board_start();
    }

    /* Board time runs to the next tick, and the body to `time_s`, at which that tick is due; before
     * 0 it rests. The first call starts the tick and decides which instant that is. */
    void wait_for_tick(double time_s) {
        const bool first = origin_ == kNever;
        if (first)
            board_run();
        try {
            while (!board_tick_due())
                board_.wait();
        } catch (const BoardReset &) {
            throw std::runtime_error("the watchdog has reset the virtual board");
        }
        if (first)
            origin_ = board_.now() - static_cast<BoardTime>(std::lround(time_s / kBoardTime_s));
        run_to(time_s);
        board_hal().service_watchdog(nullptr);
    }

    Board &board() {
        return board_;
    }

    void drive(const std::array<double, 4> &duty, BoardTime now) override {
        run_to(seconds(now));
        body_.set_duty(duty.data());
        body_.hold_duty(at_s_);
    }

    double analog_v(int channel, BoardTime now) override {
        constexpr double kFullScale_a = 0.064 * 1024, kFullScale_supply_v = 33.0;
        run_to(seconds(now));
        body_.refresh(at_s_);
        const double share = channel < 4 ? 0.5 + body_.current_a()[channel] / kFullScale_a
                                         : body_.supply_pin_v() / kFullScale_supply_v;
        return share * Converter::kFullScale_v + analog_noise_v_ * noise_(random_);
    }

    std::array<double, 4> encoder_counts(BoardTime now) override {
        run_to(seconds(now));
        return body_.shaft_counts();
    }

  private:
    double seconds(BoardTime now) const {
        return origin_ == kNever ? 0.0 : static_cast<double>(now - origin_) * kBoardTime_s;
    }

    void run_to(double time_s) {
        if (time_s <= at_s_)
            return;
        body_.run(at_s_, time_s - at_s_);
        at_s_ = time_s;
        counters_->turn(body_.shaft_counts(),
                        origin_ + static_cast<BoardTime>(std::lround(time_s / kBoardTime_s)));
    }

    Body &body_;
    std::unique_ptr<EncoderCounters> counters_;
    Board board_;
    BoardTime origin_ = kNever;
    double at_s_ = 0.0;
    double analog_noise_v_;
    std::mt19937 random_{1};
    std::normal_distribution<double> noise_;
};

}  // namespace omnislip

#endif
