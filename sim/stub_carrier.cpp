/* The stub HAL as the carrier of a virtual robot. */
#include <algorithm>
#include <cmath>
#include <deque>
#include <random>
#include <utility>

#include "firmware/integers.h"
#include "hal/hal.h"
#include "hal/host/hal_host.h"
#include "hal/host/hal_host_store.h"
#include "motion_hal.h"
#include "robot_carrier.h"

namespace omnislip {
namespace {

constexpr double kBytesPerTick = 115200.0 / 10.0 * kTick_s;
constexpr std::size_t kReceiveBuffer = 64, kSendBuffer = 128;
constexpr double kSupplyStep_v = 33.0 / 1024, kCurrentStep_a = 0.064;
constexpr std::uint16_t kWriteTicks = 5; /* of a word of the EEPROM */

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

class StubCarrier : public RobotCarrier {
  public:
    StubCarrier(RobotBody &body, const std::vector<std::uint16_t> &store) : body_(body) {
        hal_host_store_blank(&store_, kWriteTicks);
        std::copy(store.begin(), store.end(), store_.word);
    }

    void with_hal(const std::function<void()> &work) override {
        const AttachedHal attached(hal());
        work();
    }

    void start_tick() override {
        measure();
    }

    void run_to_tick(long next) override {
        const double time_s = static_cast<double>(next - 1) * kTick_s;
        body_.hold_duty(time_s);
        body_.run(time_s, kTick_s);
        pass_line();
        body_.refresh(static_cast<double>(next) * kTick_s);
        measure();
    }

    void send(const std::vector<std::uint8_t> &bytes) override {
        to_robot_.insert(to_robot_.end(), bytes.begin(), bytes.end());
    }

    std::vector<std::uint8_t> take_received() override {
        return std::exchange(delivered_, {});
    }

    std::vector<std::uint16_t> store() const override {
        return std::vector<std::uint16_t>(store_.word, store_.word + HAL_STORE_WORDS);
    }

    long store_writes() const override {
        return static_cast<long>(store_.writes);
    }

  private:
    static StubCarrier &of(void *context) {
        return *static_cast<StubCarrier *>(context);
    }

    hal_host_plant hal();
    void measure();
    std::uint16_t read_byte(std::uint16_t *byte);
    void pass_line();

    RobotBody &body_;
    hal_host_store store_ = {};
    std::uint16_t bridges_on_ = 0;
    std::mt19937 random_{1};
    std::normal_distribution<double> noise_;
    std::uint16_t supply_mv_ = 0;
    std::int16_t current_ma_[4] = {};
    std::deque<std::uint8_t> to_robot_, received_, waiting_;
    std::vector<std::uint8_t> delivered_;
    double credit_to_robot_ = 0.0, credit_from_robot_ = 0.0; /* bytes that the line may pass now */
    std::uint16_t lost_ = 0;
};

hal_host_plant StubCarrier::hal() {
    hal_host_plant hal = {};
    hal.context = this;
    hal.read_encoder_counts = [](void *context, std::uint16_t counts[4]) {
        of(context).body_.counts(counts);
    };
    hal.read_supply_mv = [](void *context) { return of(context).supply_mv_; };
    hal.read_currents_ma = [](void *context, std::int16_t current_ma[4]) {
        std::copy_n(of(context).current_ma_, 4, current_ma);
    };
    hal.write_duty = [](void *context, const std::int16_t duty_q15[4]) {
        constexpr std::int16_t safe[4] = {};
        StubCarrier &self = of(context);
        self.body_.set_duty(self.bridges_on_ ? duty_q15 : safe);
    };
    hal.enable_bridges = [](void *context, std::uint16_t on) { of(context).bridges_on_ = on; };
    hal.serial_read = [](void *context, std::uint16_t *byte) {
        return of(context).read_byte(byte);
    };
    hal.serial_space = [](void *context) {
        return static_cast<std::uint16_t>(kSendBuffer - of(context).waiting_.size());
    };
    hal.serial_write = [](void *context, std::uint16_t byte) {
        of(context).waiting_.push_back(static_cast<std::uint8_t>(byte));
    };
    hal.serial_lost = [](void *context) {
        return std::exchange(of(context).lost_, std::uint16_t{0});
    };
    hal.store_busy = [](void *context) { return hal_host_store_busy(&of(context).store_); };
    hal.store_read = [](void *context, std::uint16_t address) {
        return hal_host_store_read(&of(context).store_, address);
    };
    hal.store_write = [](void *context, std::uint16_t address, std::uint16_t word) {
        hal_host_store_write(&of(context).store_, address, word);
    };
    return hal;
}

void StubCarrier::measure() {
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

std::uint16_t StubCarrier::read_byte(std::uint16_t *byte) {
    if (received_.empty())
        return 0;
    *byte = received_.front();
    received_.pop_front();
    return 1;
}

/* A byte that finds the buffer full is lost and counted. */
void StubCarrier::pass_line() {
    pass(to_robot_, credit_to_robot_, [this](std::uint8_t byte) {
        if (received_.size() < kReceiveBuffer) {
            received_.push_back(byte);
        } else if (lost_ < U16_MAX) {
            ++lost_;
        }
    });
    pass(waiting_, credit_from_robot_, [this](std::uint8_t byte) { delivered_.push_back(byte); });
}

}  // namespace

std::unique_ptr<RobotCarrier> carry_on_stub(RobotBody &body,
                                            const std::vector<std::uint16_t> &store) {
    return std::make_unique<StubCarrier>(body, store);
}

}  // namespace omnislip
