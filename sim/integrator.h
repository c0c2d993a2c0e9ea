/* integrator.h - one classical Runge-Kutta step (RK4) of a plant under constant command.
 *
 * Error per step O(h^5), stable for h * rate < 2.78 on the negative real axis. `step_count` keeps
 * h * rate <= 1.4 and h <= the wanted step, so a stiff contact is cut finer instead of blowing up.
 */
#ifndef OMNISLIP_SIM_INTEGRATOR_H
#define OMNISLIP_SIM_INTEGRATOR_H

#include <algorithm>
#include <cmath>

namespace omnislip {

inline int step_count(double duration_s, double step_s, double fastest_rate_1_s) {
    const double steps = std::max(duration_s / step_s, duration_s * fastest_rate_1_s / 1.4);
    return std::max(1, static_cast<int>(std::ceil(steps - 1e-9)));
}

template <class Plant, class S, class Internals>
inline void rk4_step(const Plant &plant, S *x, const S *driven, double time_s, double h,
                     Internals &in) {
    constexpr int n = Plant::kStates;
    const S half(0.5 * h), full(h), sixth(h / 6.0), third(h / 3.0);
    const S begin(time_s), middle(time_s + 0.5 * h), end(time_s + h);
    S k[n], sum[n], probe[n];
    plant.derivative(x, driven, begin, k, in);
    for (int i = 0; i < n; ++i) {
        sum[i] = x[i] + sixth * k[i];
        probe[i] = x[i] + half * k[i];
    }
    plant.derivative(probe, driven, middle, k, in);
    for (int i = 0; i < n; ++i) {
        sum[i] = sum[i] + third * k[i];
        probe[i] = x[i] + half * k[i];
    }
    plant.derivative(probe, driven, middle, k, in);
    for (int i = 0; i < n; ++i) {
        sum[i] = sum[i] + third * k[i];
        probe[i] = x[i] + full * k[i];
    }
    plant.derivative(probe, driven, end, k, in);
    for (int i = 0; i < n; ++i)
        x[i] = sum[i] + sixth * k[i];
}

/* Advances x from time_s by duration_s under one command. */
template <class Plant, class S, class Internals>
inline void advance(const Plant &plant, S *x, const S *command, double time_s, double duration_s,
                    double step_s, double fastest_rate_1_s, Internals &in) {
    S driven[Plant::kMotors];
    plant.command(command, driven);
    const int steps = step_count(duration_s, step_s, fastest_rate_1_s);
    const double h = duration_s / steps;
    for (int i = 0; i < steps; ++i)
        rk4_step(plant, x, driven, time_s + i * h, h, in);
}

}  // namespace omnislip

#endif
