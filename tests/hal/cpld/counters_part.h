/* counters_part.h - encoder_counters.v as Verilator compiles it, with a clock and a bus. */
#ifndef TESTS_HAL_CPLD_COUNTERS_PART_H
#define TESTS_HAL_CPLD_COUNTERS_PART_H

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <utility>

#include "Vencoder_counters.h"
#include "board/board.h"
#include "hal/cpld/registers.h"

namespace omnislip {

/* Levels of the inputs, bit i of wheel i + 1. */
struct EncoderPins {
    unsigned a = 0, b = 0;
    bool operator==(const EncoderPins &other) const {
        return a == other.a && b == other.b;
    }
};

/* Encoders of shafts at `counts`, not rounded: (A, B) = 00, 10, 11, 01 as the count goes up. */
inline EncoderPins pins_at(const std::array<double, 4> &counts) {
    EncoderPins pins;
    for (unsigned i = 0; i < 4; ++i) {
        const auto phase = static_cast<unsigned>(static_cast<std::int64_t>(std::floor(counts[i])));
        pins.a |= ((phase + 1) >> 1 & 1U) << i;
        pins.b |= (phase >> 1 & 1U) << i;
    }
    return pins;
}

class CountersPart {
  public:
    using Inputs = std::function<EncoderPins(BoardTime)>;

    /* `inputs` is asked for the levels at every clock. */
    explicit CountersPart(Inputs inputs) : inputs_(std::move(inputs)) {
        model_.ds_n = model_.rd_n = model_.we_n = 1;
        eval(0);
    }

    BoardTime now() const {
        return now_;
    }

    void clock() {
        const EncoderPins pins = inputs_(now_);
        quiet_ = pins == pins_ ? quiet_ + 1 : 0;
        pins_ = pins;
        model_.encoder_a = static_cast<CData>(pins.a);
        model_.encoder_b = static_cast<CData>(pins.b);
        eval(1);
        eval(0);
        ++now_;
    }

    void run(BoardTime clocks) {
        for (const BoardTime end = now_ + clocks; now_ < end;)
            clock();
    }

    /* After that many clocks without a change the part repeats itself every second clock. */
    static constexpr int kSettles = 12;
    bool quiet() const {
        return quiet_ > kSettles;
    }
    /* The clocks pass while nobody touches inputs or bus: only for an even number, and quiet(). */
    void skip(BoardTime clocks) {
        now_ += clocks;
    }

    /* ---- bus cycles, with strobes of that many clocks ---- */

    std::uint16_t read(unsigned address, int clocks = 1 + CPLD_WAIT_STATES) {
        select(address);
        model_.rd_n = 0;
        run(clocks);
        const std::uint16_t data = model_.data;
        drove_ = model_.drive != 0;
        release();
        return data;
    }

    /* Address and select are held for a clock after the strobe. */
    void write(unsigned address, int clocks = 1 + CPLD_WAIT_STATES) {
        select(address);
        model_.we_n = 0;
        run(clocks);
        model_.we_n = 1;
        clock();
        release();
    }

    /* Whether the part took the bus in the last read. */
    bool drove() const {
        return drove_;
    }
    Vencoder_counters &pins() {
        return model_;
    }

  private:
    void eval(CData level) {
        model_.clock = level;
        model_.eval();
    }
    void select(unsigned address) {
        model_.ds_n = 0;
        model_.address = static_cast<CData>(address & 7U);
    }
    void release() {
        model_.ds_n = model_.rd_n = model_.we_n = 1;
        quiet_ = 0;
        eval(0);
    }

    Inputs inputs_;
    Vencoder_counters model_;
    EncoderPins pins_;
    BoardTime now_ = 0;
    int quiet_ = 0;
    bool drove_ = false;
};

}  // namespace omnislip

#endif
