/* integrator.h - Runge-Kutta steps of a plant under constant command.
 *
 * The plant's memory rides along (memory.h): its derivative is (value at the end of the step -
 * value at its begin) / h, so the weighted sum of the stages gives that end value.
 *
 * Error per step O(h^5), stable for h * rate < 2.78 on the negative real axis. `step_count` keeps
 * h <= the wanted step, and h * rate <= 1.4 down to steps of half a millisecond, so a stiff contact
 * is cut finer instead of blowing up. Shorter steps need no more than to be stable, h * rate
 * <= 2.0: what is faster (teeth that meet, a light rim on a soft shaft) follows the rest.
 * `require_rate` refuses a rate so high that this would take for ever.
 */
#ifndef OMNISLIP_SIM_INTEGRATOR_H
#define OMNISLIP_SIM_INTEGRATOR_H

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <type_traits>

#include "memory.h"

namespace omnislip {
inline namespace OMNISLIP_INSTRUCTION_SET {

/* 500 steps per millisecond: some seven times slower than real time. */
constexpr double kFastestRate_1_s = 1e6;

/* Throws std::invalid_argument for a rate beyond that, or one that is no number. */
inline void require_rate(double rate_1_s) {
    if (rate_1_s <= kFastestRate_1_s)
        return;
    char message[200];
    std::snprintf(message, sizeof message,
                  "the model is too stiff to simulate: its fastest rate is %.1e 1/s, at most %.0e; "
                  "check masses, inertias, slip_stiffness_s_m and mu_drive",
                  rate_1_s, kFastestRate_1_s);
    throw std::invalid_argument(message);
}

inline int step_count(double duration_s, double step_s, double fastest_rate_1_s) {
    constexpr double fine_s = 0.5e-3;
    const double exact_s = 1.4 / fastest_rate_1_s, stable_s = 2.0 / fastest_rate_1_s;
    const double most_s = std::max(exact_s, std::min(stable_s, fine_s));
    const double steps = std::max(duration_s / step_s, duration_s / most_s);
    return std::max(1, static_cast<int>(std::ceil(steps - 1e-9)));
}

/* The states in front that a plant reads and writes in lots of wheels (lanes.h), if it has any. */
template <class Plant, class = void>
constexpr int kStatesInLots = 0;
template <class Plant>
constexpr int kStatesInLots<Plant, std::void_t<decltype(Plant::kStatesInLots)>> =
    Plant::kStatesInLots;

/* Calls `update` for the first n states and, `kMemory`, for what of its memory the plant uses: for
 * states that the plant reads and writes in lots of wheels with such a lot, for each other one by
 * itself. A register that is read right after it was written in parts would have to wait until
 * these have left for the cache. */
template <class S, int n, bool kMemory, class Plant, class Update>
void for_each_state(const Plant &plant, Update &&update) {
    constexpr int in_lots = std::min(n, kStatesInLots<Plant>);
    for (int i = 0; i < in_lots; i += LotOf<S>::kWheels)
        update(LotAt<S>{i});
    for (int i = in_lots; i < n; ++i)
        update(OneAt<S>{i});
    if constexpr (kMemory) {
        for (const int place : plant.memory())
            update(OneAt<S>{place});
    }
}

/* A rule finishes a step of the first n states, and of the memory in use if `kMemory`, whose first
 * derivative k is known; k is used up. `room`: states that the plant could touch if it had a memory
 * in use, for compilers that check bounds. */

/* Kutta's classical rule: order 4, four derivatives. */
struct Rk4 {
    template <int n, int room, bool kMemory, class Plant, class S, class Step, class Internals>
    static void finish(S *k, const Plant &plant, S *x, const Step &step, double time_s, double h,
                       Internals &in) {
        const S half(0.5 * h), full(h), sixth(h / 6.0), third(h / 3.0);
        const S middle(time_s + 0.5 * h), end(time_s + h);
        S sum[room], probe[room] = {};
        for_each_state<S, n, kMemory>(plant, [&](auto at) {
            at.put(at(x) + sixth * at(k), sum);
            at.put(at(x) + half * at(k), probe);
        });
        plant.derivative(probe, step, middle, k, in);
        for_each_state<S, n, kMemory>(plant, [&](auto at) {
            at.put(at(sum) + third * at(k), sum);
            at.put(at(x) + half * at(k), probe);
        });
        plant.derivative(probe, step, middle, k, in);
        for_each_state<S, n, kMemory>(plant, [&](auto at) {
            at.put(at(sum) + third * at(k), sum);
            at.put(at(x) + full * at(k), probe);
        });
        plant.derivative(probe, step, end, k, in);
        for_each_state<S, n, kMemory>(plant, [&](auto at) { at.put(at(sum) + sixth * at(k), x); });
    }
};

/* Merson's rule (1957): order 4, five derivatives. Of a linear plant with eigenvalue z / h it
 * leaves out z^5 / 120 - z^5 / 144, a sixth of what Rk4 leaves: about as exact as two steps of Rk4
 * of half the length, with five derivatives in place of eight. */
struct Merson {
    template <int n, int room, bool kMemory, class Plant, class S, class Step, class Internals>
    static void finish(S *k, const Plant &plant, S *x, const Step &step, double time_s, double h,
                       Internals &in) {
        const S third(time_s + h / 3.0), middle(time_s + 0.5 * h), end(time_s + h);
        const S full(h), to_third(h / 3.0), sixth(h / 6.0);
        S first[room], early[room], probe[room] = {};
        for_each_state<S, n, kMemory>(plant, [&](auto at) {
            at.put(at(k), first);
            at.put(at(x) + to_third * at(k), probe);
        });
        plant.derivative(probe, step, third, k, in);
        for_each_state<S, n, kMemory>(
            plant, [&](auto at) { at.put(at(x) + sixth * (at(first) + at(k)), probe); });
        plant.derivative(probe, step, third, k, in);
        for_each_state<S, n, kMemory>(plant, [&](auto at) {
            at.put(at(k), early);
            at.put(at(x) + S(0.125) * full * at(first) + S(0.375) * full * at(k), probe);
        });
        plant.derivative(probe, step, middle, k, in);
        for_each_state<S, n, kMemory>(plant, [&](auto at) {
            at.put(at(x) + S(0.5) * full * at(first) - S(1.5) * full * at(early) +
                       S(2.0) * full * at(k),
                   probe);
            at.put(at(x) + sixth * at(first) + S(4.0) * sixth * at(k), x);
        });
        plant.derivative(probe, step, end, k, in);
        for_each_state<S, n, kMemory>(plant, [&](auto at) { at.put(at(x) + sixth * at(k), x); });
    }
};

/* One step of the first n states, and of the memory in use if `kMemory`. */
template <class Rule, int n, int room = n, bool kMemory = false, class Plant, class S, class Step,
          class Internals>
inline void take_step(const Plant &plant, S *x, const Step &step, double time_s, double h,
                      Internals &in) {
    S k[room];
    plant.derivative(x, step, S(time_s), k, in);
    Rule::template finish<n, room, kMemory>(k, plant, x, step, time_s, h, in);
}

/* What a step begins with, of a plant without memory or delay: it is the same for any length. */
template <class Plant, class S>
struct Begin {
    typename Plant::Step step;
    S derivative[Plant::kAll];
};

/* Advances x [Plant::kAll] from time_s by duration_s; `commands(begin_s, end_s, command)` gives
 * the mean command over a step. `begun`: the begin of the first step, from a caller who has it; its
 * derivative is used up. */
template <class Rule = Rk4, class Plant, class S, class Commands, class Internals>
inline void advance(const Plant &plant, S *x, const Commands &commands, double time_s,
                    double duration_s, double step_s, double fastest_rate_1_s, Internals &in,
                    Begin<Plant, S> *begun = nullptr) {
    const int steps = step_count(duration_s, step_s, fastest_rate_1_s);
    const double h = duration_s / steps;
    S command[Plant::kMotors];
    typename Plant::Step step;
    for (int i = 0; i < steps; ++i) {
        const double begin_s = time_s + i * h;
        if (i == 0 && begun != nullptr) {
            Rule::template finish<Plant::kStates, Plant::kAll, false>(begun->derivative, plant, x,
                                                                      begun->step, begin_s, h, in);
            continue;
        }
        commands(begin_s, begin_s + h, command);
        plant.begin_step(x, command, h, step);
        if constexpr (Plant::kAll > Plant::kStates) {
            if (plant.remembers()) {
                take_step<Rule, Plant::kStates, Plant::kAll, true>(plant, x, step, begin_s, h, in);
                continue;
            }
        }
        take_step<Rule, Plant::kStates, Plant::kAll>(plant, x, step, begin_s, h, in);
    }
}

/* The same of a plant without memory under one command. */
template <class Plant, class S, class Internals>
inline void advance(const Plant &plant, S *x, const S *command, double time_s, double duration_s,
                    double step_s, double fastest_rate_1_s, Internals &in) {
    S driven[Plant::kMotors];
    plant.command(command, driven);
    const int steps = step_count(duration_s, step_s, fastest_rate_1_s);
    const double h = duration_s / steps;
    for (int i = 0; i < steps; ++i)
        take_step<Rk4, Plant::kStates>(plant, x, driven, time_s + i * h, h, in);
}

/* What the plant does in an instant: derivative dx [Plant::kAll] and internals. */
template <class Plant, class S, class Internals>
inline void look(const Plant &plant, const S *x, const S *command, double time_s, S *dx,
                 Internals &in) {
    typename Plant::Step step;
    plant.begin_step(x, command, 0.0, step);
    plant.derivative(x, step, S(time_s), dx, in);
}

/* Fills the memory behind the states of x: all as if this had lasted for long, windings cold. */
template <class Plant, class S, class Internals>
inline void settle(const Plant &plant, S *x, const S *command, double time_s, Internals &in) {
    for (int i = Plant::kStates; i < Plant::kAll; ++i)
        x[i] = S(0.0);
    if constexpr (Plant::kAll > Plant::kStates) {
        if (!plant.remembers())
            return;
        typename Plant::Step step;
        S dx[Plant::kAll];
        plant.begin_step(x, command, kForever_s, step);
        plant.derivative(x, step, S(time_s), dx, in);
        for (const int place : plant.memory())
            x[place] = dx[place] * S(kForever_s);
    }
}

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
