/* The Verilog counters, pin by pin. Times are clocks of 25 ns; inputs are sampled every second. */
#include <algorithm>
#include <cstdio>
#include <random>
#include <vector>

#include "counters_part.h"
#include "unity.h"

using namespace omnislip;

void setUp(void) {}
void tearDown(void) {}

namespace {

constexpr int kBits = CPLD_COUNT1_BITS, kCounts = 1 << kBits;
constexpr double kSample = 2.0;
/* From a change at the pins until the counter shows it, at most. */
constexpr int kLatency = 10;

int wrapped(double count) {
    return static_cast<int>(static_cast<std::int64_t>(std::floor(count)) & (kCounts - 1));
}

std::array<int, 4> read_counts(CountersPart &part) {
    std::array<int, 4> counts;
    for (unsigned i = 0; i < 4; ++i)
        counts[i] = part.read(CPLD_COUNT1 + i);
    return counts;
}

std::array<int, 4> latched_counts(CountersPart &part) {
    part.write(CPLD_LATCH);
    return read_counts(part);
}

/* Shafts that take one count at each of their instants; counts go `up` or down. */
struct Walk {
    std::vector<double> instants;
    std::vector<int> positions = {0};
    std::size_t place = 0;

    void step(double instant, bool up) {
        instants.push_back(instant);
        positions.push_back(positions.back() + (up ? 1 : -1));
    }
    double at(BoardTime now) {
        while (place < instants.size() && instants[place] <= static_cast<double>(now))
            ++place;
        return positions[place];
    }
};

EncoderPins pins_of(std::array<Walk, 4> &walks, BoardTime now) {
    return pins_at({walks[0].at(now), walks[1].at(now), walks[2].at(now), walks[3].at(now)});
}

/* Steady turning of all wheels with `interval` clocks a count: whether all counts arrived. */
bool follows(double interval, double phase) {
    const int kSteps = 3000;
    const auto position = [&](BoardTime now) {
        const double steps = (static_cast<double>(now) - 20.0 - phase) / interval;
        return std::clamp(std::floor(steps), 0.0, static_cast<double>(kSteps));
    };
    CountersPart part([&](BoardTime now) {
        const double up = position(now);
        return pins_at({up, -up, up, -up});
    });
    part.run(static_cast<BoardTime>(kSteps * interval) + 40 + kLatency);
    const std::array<int, 4> counts = latched_counts(part);
    const int errors = part.read(CPLD_ERROR) & 0xF;
    const std::array<int, 4> right = {wrapped(kSteps), wrapped(-kSteps), wrapped(kSteps),
                                      wrapped(-kSteps)};
    return counts == right && errors == 0;
}

}  // namespace

static void every_rate_below_the_sampling_rate_is_followed(void) {
    for (const double interval : {2.001, 2.01, 2.1, 2.5, 3.0, 3.7, 4.0, 8.0, 40.0}) {
        for (double phase = 0.0; phase < 2.0; phase += 0.19)
            TEST_ASSERT_TRUE(follows(interval, phase));
    }
    for (double phase = 0.0; phase < 2.0; phase += 0.19)
        TEST_ASSERT_FALSE(follows(1.99, phase));
    const double fastest_1_s = 1.0 / (kSample * kBoardTime_s);
    const double counted_1_s = kCounts / 2 / 1e-3;
    std::printf(
        "decoder: %.1f million counts/s; counter read at 1 kHz: below %.3f million, "
        "%.0f rad/s at 2000 counts/rev\n",
        fastest_1_s / 1e6, counted_1_s / 1e6, counted_1_s * 2 * M_PI / 2000);
}

/* Any walk whose edges are more than a sample apart, with reversals, on all four at once. A
 * reversal turns back on the same input, which must stay for two samples to be seen. */
static void random_walks_are_counted_exactly(void) {
    std::minstd_rand random(1);
    std::uniform_real_distribution<double> pause(kSample + 0.001, 12.0);
    for (int run = 0; run < 20; ++run) {
        std::array<Walk, 4> walks;
        for (Walk &walk : walks) {
            bool up = true;
            double instant = 20.0;
            for (int i = 0; i < 2000; ++i) {
                const bool turns = random() % 5 == 0;
                up = up != turns;
                instant += pause(random) + (turns ? kSample : 0.0);
                walk.step(instant, up);
            }
        }
        CountersPart part([&](BoardTime now) { return pins_of(walks, now); });
        for (const BoardTime end : {5000, 12000, 30000}) {
            part.run(end - part.now());
            part.write(CPLD_LATCH);
            part.read(CPLD_ERROR);
            read_counts(part);
        }
        const std::array<int, 4> counts = latched_counts(part);
        for (std::size_t i = 0; i < 4; ++i)
            TEST_ASSERT_EQUAL_INT(wrapped(walks[i].positions.back()), counts[i]);
        TEST_ASSERT_EQUAL_HEX16(0, part.read(CPLD_ERROR) & 0xF);
    }
}

/* Up to each phase and back, with every fraction of a sample between the two edges. A turn too
 * short to be seen is not counted at all, never by half. */
static void reversal_at_every_phase_loses_nothing(void) {
    for (int phase = 1; phase <= 8; ++phase) {
        for (double stay = 0.1; stay < 6.0; stay += 0.1) {
            for (const int direction : {1, -1}) {
                Walk walk;
                double instant = 20.0 + 0.37 * phase;
                for (int i = 0; i < phase; ++i)
                    walk.step(instant += 5.0, direction > 0);
                instant += stay;
                for (int i = 0; i < phase + 3; ++i) {
                    walk.step(instant, direction < 0);
                    instant += 5.0;
                }
                CountersPart part([&](BoardTime now) {
                    const double at = walk.at(now);
                    return pins_at({at, at, at, at});
                });
                part.run(200);
                for (const int count : latched_counts(part))
                    TEST_ASSERT_EQUAL_INT(wrapped(-3 * direction), count);
                TEST_ASSERT_EQUAL_HEX16(0, part.read(CPLD_ERROR) & 0xF);
            }
        }
    }
}

/* A pulse shorter than a sample, on either input or both, at any phase and from any state. */
static void glitches_shorter_than_a_sample_are_ignored(void) {
    for (int state = 0; state < 4; ++state) {
        for (unsigned which = 1; which <= 3; ++which) {
            for (double begin = 40.0; begin < 42.0; begin += 0.19) {
                for (int probe = 0; probe < 40; ++probe) {
                    const double length = 0.1 + 1.89 * (probe % 2);
                    bool counting = false;
                    CountersPart part([&](BoardTime now) {
                        const double time = static_cast<double>(now);
                        const double at = std::clamp(time / 5.0, 0.0, static_cast<double>(state));
                        EncoderPins pins = pins_at({at, at, at, at});
                        if (time >= begin && time < begin + length) {
                            pins.a ^= which & 1 ? 0xFU : 0U;
                            pins.b ^= which & 2 ? 0xFU : 0U;
                        }
                        return pins;
                    });
                    part.run(30 + probe);
                    /* Not in between either. */
                    for (int i = 0; i < 2; ++i) {
                        for (const int count : latched_counts(part))
                            counting = counting || count != state;
                        counting = counting || (part.read(CPLD_ERROR) & 0xF) != 0;
                    }
                    TEST_ASSERT_FALSE(counting);
                }
            }
        }
    }
}

/* Both inputs of one wheel at once: flagged for this wheel, not counted, counting goes on. */
static void a_double_transition_is_flagged_and_not_counted(void) {
    for (unsigned wheel = 0; wheel < 4; ++wheel) {
        for (int state = 0; state < 4; ++state) {
            CountersPart part([&](BoardTime now) {
                std::array<double, 4> at = {};
                at[wheel] = std::min(static_cast<int>(now) / 8, state) + (now >= 60 ? 2 : 0) +
                            (now >= 120 ? 1 : 0);
                return pins_at(at);
            });
            part.run(100);
            std::array<int, 4> right = {};
            right[wheel] = state;
            TEST_ASSERT_TRUE(latched_counts(part) == right);
            TEST_ASSERT_EQUAL_HEX16(1U << wheel, part.read(CPLD_ERROR));
            part.run(100);
            right[wheel] = state + 1;
            TEST_ASSERT_TRUE(latched_counts(part) == right);
            TEST_ASSERT_EQUAL_HEX16(0, part.read(CPLD_ERROR));
        }
    }
}

/* Whatever its distance from a LATCH, an error is seen by exactly one of them. */
static void an_error_beside_a_latch_is_seen_once(void) {
    for (int offset = 0; offset < 24; ++offset) {
        CountersPart part([&](BoardTime now) {
            const double at = now >= 100 + offset ? 2.0 : 0.0;
            return pins_at({at, 0.0, 0.0, at});
        });
        part.run(110);
        int seen = 0;
        for (int i = 0; i < 4; ++i) {
            part.write(CPLD_LATCH);
            const int flags = part.read(CPLD_ERROR);
            TEST_ASSERT_TRUE(flags == 0 || flags == 9);
            seen += flags != 0;
        }
        TEST_ASSERT_EQUAL_INT(1, seen);
    }
}

/* Four shafts at different speeds, some near the decoder's limit: what a LATCH copies is where all
 * of them stood at one sample, the last one five clocks before the last clock of the strobe; it
 * stays while the counters go on. */
static void a_latch_is_one_instant(void) {
    const auto shafts = [](BoardTime now) -> std::array<double, 4> {
        const double time = std::max(static_cast<double>(now) - 20.0, 0.0);
        return {time / 2.1, -time / 2.7, time / 3.3, -time / 50.0};
    };
    for (int start = 0; start < 100; ++start) {
        CountersPart part([&](BoardTime now) { return pins_at(shafts(now)); });
        part.run(100 + start);
        part.write(CPLD_LATCH, 1 + start % 7);
        /* The write has ended with one clock after the strobe. */
        const BoardTime late = part.now() - 2 - 5;
        part.run(300);
        const std::array<int, 4> counts = read_counts(part);
        const std::array<double, 4> right = shafts(late - (late % 2 == 0 ? 1 : 0));
        for (std::size_t i = 0; i < 4; ++i)
            TEST_ASSERT_EQUAL_INT(wrapped(right[i]), counts[i]);
    }
}

static void counters_wrap_both_ways(void) {
    CountersPart part([](BoardTime now) {
        const double at = std::min(static_cast<double>(now) / 4.0, kCounts + 5.0);
        return pins_at({at, -at, 0.0, at});
    });
    part.run(4 * (kCounts + 5) + kLatency);
    const std::array<int, 4> counts = latched_counts(part);
    TEST_ASSERT_EQUAL_INT(5, counts[0]);
    TEST_ASSERT_EQUAL_INT(kCounts - 5, counts[1]);
    TEST_ASSERT_EQUAL_INT(0, counts[2]);
    TEST_ASSERT_EQUAL_INT(5, counts[3]);
}

static void the_bus_is_taken_only_when_this_part_is_read(void) {
    CountersPart part([](BoardTime) { return EncoderPins{}; });
    for (unsigned pins = 0; pins < 8; ++pins) {
        part.pins().ds_n = pins & 1;
        part.pins().rd_n = pins >> 1 & 1;
        part.pins().we_n = pins >> 2 & 1;
        part.pins().eval();
        TEST_ASSERT_EQUAL_INT((pins & 3) == 0, part.pins().drive);
    }
    TEST_ASSERT_EQUAL_HEX16(CPLD_VERSION, part.read(CPLD_IDENTITY));
    TEST_ASSERT_TRUE(part.drove());
}

static void only_a_write_of_latch_latches(void) {
    CountersPart part([](BoardTime now) {
        return pins_at({now >= 200 ? 1.0 : 0.0, 0.0, 0.0, 0.0});
    });
    part.run(100);
    latched_counts(part);
    part.run(200);
    for (unsigned address = 0; address < 8; ++address) {
        if (address != CPLD_LATCH)
            part.write(address);
        part.read(address);
    }
    /* Another part's cycle. */
    part.pins().address = CPLD_LATCH;
    part.pins().we_n = 0;
    part.run(5);
    part.pins().we_n = 1;
    part.run(5);
    TEST_ASSERT_EQUAL_INT(0, part.read(CPLD_COUNT1));
    TEST_ASSERT_EQUAL_INT(1, latched_counts(part)[0]);
}

/* A strobe of any length is one LATCH, at its end, and the next cycle reads it. */
static void a_long_strobe_is_one_latch(void) {
    for (int clocks = 1; clocks <= 10; ++clocks) {
        const BoardTime begin = 100;
        CountersPart part([&](BoardTime now) {
            const double at = now >= begin ? 2.0 : 0.0; /* an error: one LATCH clears it */
            return pins_at({at, 0.0, 0.0, 0.0});
        });
        part.run(begin + 20);
        part.write(CPLD_LATCH, clocks);
        TEST_ASSERT_EQUAL_HEX16(1, part.read(CPLD_ERROR));
        TEST_ASSERT_EQUAL_HEX16(1, part.read(CPLD_ERROR));
    }
}

/* Inputs need not be low when the power comes: flagged once, and gone after the first LATCH. */
static void power_up_in_any_state_ends_with_the_first_latch(void) {
    for (int state = 0; state < 4; ++state) {
        CountersPart part([&](BoardTime) {
            const double at = state;
            return pins_at({at, at, at, at});
        });
        part.run(50);
        latched_counts(part);
        TEST_ASSERT_EQUAL_HEX16(state == 2 ? 0xF : 0, part.read(CPLD_ERROR));
        latched_counts(part);
        TEST_ASSERT_EQUAL_HEX16(0, part.read(CPLD_ERROR));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(every_rate_below_the_sampling_rate_is_followed);
    RUN_TEST(random_walks_are_counted_exactly);
    RUN_TEST(reversal_at_every_phase_loses_nothing);
    RUN_TEST(glitches_shorter_than_a_sample_are_ignored);
    RUN_TEST(a_double_transition_is_flagged_and_not_counted);
    RUN_TEST(an_error_beside_a_latch_is_seen_once);
    RUN_TEST(a_latch_is_one_instant);
    RUN_TEST(counters_wrap_both_ways);
    RUN_TEST(the_bus_is_taken_only_when_this_part_is_read);
    RUN_TEST(only_a_write_of_latch_latches);
    RUN_TEST(a_long_strobe_is_one_latch);
    RUN_TEST(power_up_in_any_state_ends_with_the_first_latch);
    return UNITY_END();
}
