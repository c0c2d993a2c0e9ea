/* A virtual board on the bench: what its pins do is recorded, what it measures is set by hand. */
#ifndef TESTS_SIM_BOARD_BENCH_H
#define TESTS_SIM_BOARD_BENCH_H

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "board/board.h"
#include "board/board_hal.h"
#include "board/counters.h"
#include "board/serial_port.h"
#include "board/spi_port.h"
#include "hal/lf2407a/host_names.h"
/* Names first. */
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"

using namespace omnislip;

struct Bench : BoardSurroundings, EncoderSource {
    struct Drive {
        BoardTime time;
        std::array<double, 4> duty;
    };
    std::vector<Drive> drives;
    std::array<double, 5> volt = {1.65, 1.65, 1.65, 1.65, 2.4};
    std::array<double, 4> counts = {};
    BehaviouralCounters counters{*this};
    Board board{*this, counters, board_vectors()};

    Bench() {
        board.attach();
    }
    void drive(const std::array<double, 4> &duty, BoardTime now) override {
        drives.push_back({now, duty});
    }
    double analog_v(int channel, BoardTime) override {
        return volt[static_cast<std::size_t>(channel)];
    }
    std::array<double, 4> encoder_counts(BoardTime) override {
        return counts;
    }

    /* Drivers up, tick running, protection pins high. */
    Bench &start() {
        board_start();
        board_run();
        return *this;
    }

    /* The loop of main.c for that many milliseconds; returns the ticks in it. */
    int run_ms(
        double ms, const std::function<void()> &tick = [] {}) {
        const BoardTime end = board.now() + static_cast<BoardTime>(ms * kTickOfBoard);
        int ticks = 0;
        board.set_horizon(end);
        while (board.now() < end) {
            if (board_tick_due()) {
                ++ticks;
                tick();
            } else {
                board.wait();
            }
        }
        return ticks;
    }

    std::array<double, 4> duty() const {
        return drives.empty() ? std::array<double, 4>{} : drives.back().duty;
    }
};

/* What the exception of `action` says; "" if there is none. */
inline std::string fault_of(const std::function<void()> &action) {
    try {
        action();
    } catch (const BoardFault &fault) {
        return fault.what();
    }
    return "";
}

inline bool resets(const std::function<void()> &action) {
    try {
        action();
    } catch (const BoardReset &) {
        return true;
    }
    return false;
}

inline bool contains(const std::string &text, const char *part) {
    return text.find(part) != std::string::npos;
}

#endif
