/* rtl_counters.h - the Verilog counters on the virtual board's bus, turned by the plant's shafts.
 *
 * Between the instants at which the plant is known (LATCH, changes of the duty, conversions: at
 * most 0.8 ms apart) shafts turn in straight lines; an edge comes at the clock at which its line
 * passes a count. Clocks in which nothing can change are skipped, an even number at a time.
 */
#ifndef TESTS_HAL_CPLD_RTL_COUNTERS_H
#define TESTS_HAL_CPLD_RTL_COUNTERS_H

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>

#include "board/counters.h"
#include "counters_part.h"

namespace omnislip {

class RtlCounters : public EncoderCounters {
  public:
    struct Tally {
        long latches = 0, counts_read = 0;
        long wrong_counts = 0; /* not where the shaft was at the sample that the LATCH must show */
        long errors = 0;       /* LATCHes with an error flag */
    };

    RtlCounters(EncoderSource &source, bool skipping, Tally &tally)
        : source_(source),
          part_([this](BoardTime now) { return pins_at(shafts(now)); }),
          skipping_(skipping),
          tally_(tally) {}

    int wait_states() const override {
        return CPLD_WAIT_STATES;
    }

    void turn(const std::array<double, 4> &counts, BoardTime now) override {
        if (known_.empty() || now > known_.back().time)
            known_.push_back({now, counts});
    }

    std::uint16_t read(std::uint16_t offset, BoardTime now) override {
        reach(now);
        const std::uint16_t data = part_.read(offset);
        if (offset <= CPLD_COUNT4)
            compare(offset, data);
        else if (offset == CPLD_ERROR)
            tally_.errors += data != 0;
        return data;
    }

    /* Only a write asks for the shafts, as BehaviouralCounters does: each question makes the
     * plant's steps others. */
    void write(std::uint16_t offset, std::uint16_t, BoardTime now) override {
        turn(source_.encoder_counts(now), now);
        reach(now);
        /* A LATCH shows the last sample at least five clocks before the last one of the strobe;
         * samples are at odd clocks. */
        const BoardTime late = now - 1 - 5;
        due_ = shafts(late - (late % 2 == 0 ? 1 : 0));
        part_.write(offset);
        ++tally_.latches;
    }

  private:
    struct Known {
        BoardTime time;
        std::array<double, 4> counts;
    };
    static constexpr int kStrobe = 1 + CPLD_WAIT_STATES;

    /* Clocks up to the strobe of a bus cycle that ends at `now`. */
    void reach(BoardTime now) {
        if (known_.empty())
            turn(source_.encoder_counts(now), 0);
        const BoardTime end = now - kStrobe;
        while (part_.now() < end) {
            const BoardTime still =
                skipping_ && part_.quiet() ? std::min(calm_clocks(), end - part_.now()) : 0;
            if (still >= 2)
                part_.skip(still - still % 2);
            else
                part_.clock();
        }
        while (known_.size() > 2 && known_[1].time < part_.now() - 100)
            known_.pop_front();
    }

    /* The line that holds at `now` begins here. */
    std::size_t line_at(BoardTime now) const {
        std::size_t i = known_.size() - 1;
        while (i > 0 && known_[i].time > now)
            --i;
        return i;
    }

    /* After the last known instant shafts go on as before it. */
    std::array<double, 4> speeds(std::size_t line) const {
        std::array<double, 4> speed = {};
        if (known_.size() > 1) {
            const std::size_t begin = std::min(line, known_.size() - 2);
            const Known &from = known_[begin], &to = known_[begin + 1];
            for (std::size_t i = 0; i < 4; ++i)
                speed[i] =
                    (to.counts[i] - from.counts[i]) / static_cast<double>(to.time - from.time);
        }
        return speed;
    }

    std::array<double, 4> shafts(BoardTime now) const {
        const std::size_t line = line_at(now);
        const std::array<double, 4> speed = speeds(line);
        std::array<double, 4> counts = known_[line].counts;
        for (std::size_t i = 0; i < 4; ++i)
            counts[i] += speed[i] * static_cast<double>(now - known_[line].time);
        return counts;
    }

    /* Clocks after the last one in which no shaft passes a count. */
    BoardTime calm_clocks() const {
        const BoardTime last = part_.now() - 1;
        const std::size_t line = line_at(last);
        const std::array<double, 4> counts = shafts(last), speed = speeds(line);
        double clocks =
            line + 1 < known_.size() ? static_cast<double>(known_[line + 1].time - last) : 1e9;
        for (std::size_t i = 0; i < 4; ++i) {
            const double passed = counts[i] - std::floor(counts[i]);
            if (speed[i] != 0.0)
                clocks =
                    std::min(clocks, (speed[i] > 0.0 ? 1.0 - passed : passed) / std::abs(speed[i]));
        }
        return static_cast<BoardTime>(clocks) - 1;
    }

    /* The counter began at 0, not where the shaft stood: the first LATCH shows the difference. */
    void compare(std::size_t wheel, int data) {
        const auto whole = static_cast<std::int64_t>(std::floor(due_[wheel]));
        const std::int64_t offset = (data - whole) & ((1 << CPLD_COUNT1_BITS) - 1);
        if (tally_.latches == 1)
            offset_[wheel] = offset;
        tally_.wrong_counts += offset != offset_[wheel];
        tally_.counts_read += 1;
    }

    EncoderSource &source_;
    CountersPart part_;
    bool skipping_;
    Tally &tally_;
    std::deque<Known> known_;
    std::array<double, 4> due_ = {};
    std::array<std::int64_t, 4> offset_ = {};
};

}  // namespace omnislip

#endif
