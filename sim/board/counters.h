/* counters.h - the encoder counters of the CPLD by their register map (hal/cpld/registers.def).
 *
 * BehaviouralCounters is what the Verilog must do, without its timing: a LATCH copies the counts of
 * that instant and the error flags, reads show the copies. A copy read twice, or before any LATCH,
 * is refused: the reader would take an old position for a new one.
 */
#ifndef OMNISLIP_SIM_BOARD_COUNTERS_H
#define OMNISLIP_SIM_BOARD_COUNTERS_H

#include <array>
#include <cmath>
#include <functional>
#include <memory>

#include "board/board.h"
#include "hal/cpld/registers.h"

namespace omnislip {

/* The shafts as the encoders see them. */
class EncoderSource {
  public:
    virtual ~EncoderSource() = default;
    /* Angles in counts, not rounded, counting up as hal.h says. Times never run backwards. */
    virtual std::array<double, 4> encoder_counts(BoardTime now) = 0;
};

class EncoderCounters : public BusDevice {
  public:
    /* Where the shafts are at `now`; told whenever the plant has run to another instant. */
    virtual void turn(const std::array<double, 4> &, BoardTime) {}
};

using CountersMaker = std::function<std::unique_ptr<EncoderCounters>(EncoderSource &)>;

class BehaviouralCounters : public EncoderCounters {
  public:
    explicit BehaviouralCounters(EncoderSource &source) : source_(source) {}

    int wait_states() const override {
        return CPLD_WAIT_STATES;
    }

    std::uint16_t read(std::uint16_t offset, BoardTime) override {
        if (offset == CPLD_IDENTITY)
            return CPLD_VERSION;
        if (offset > CPLD_ERROR)
            throw BoardFault("the CPLD has no register to read here");
        if (!fresh_[offset])
            throw BoardFault("counter read without LATCH since the last read");
        fresh_[offset] = false;
        return copies_[offset];
    }

    void write(std::uint16_t offset, std::uint16_t, BoardTime now) override {
        if (offset != CPLD_LATCH)
            throw BoardFault("the CPLD has no register to write here");
        const std::array<double, 4> counts = source_.encoder_counts(now);
        for (std::size_t i = 0; i < 4; ++i) {
            const auto whole = static_cast<std::int64_t>(std::floor(counts[i]));
            copies_[i] = static_cast<std::uint16_t>(whole & ((1 << CPLD_COUNT1_BITS) - 1));
        }
        copies_[CPLD_ERROR] = errors_;
        errors_ = 0;
        fresh_.fill(true);
    }

    /* The inputs of a wheel changed both at once. */
    void inject_error(int wheel) {
        errors_ = static_cast<std::uint16_t>(errors_ | 1U << wheel);
    }

  private:
    EncoderSource &source_;
    std::array<std::uint16_t, 5> copies_ = {};
    std::array<bool, 5> fresh_ = {};
    std::uint16_t errors_ = 0;
};

}  // namespace omnislip

#endif
