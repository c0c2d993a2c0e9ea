/* memory.h - what a drive remembers: parts that the effects with memory share between the plants.
 *
 * The filtered state of a plant (speeds, angles, velocities, pose) is followed in the same array by
 * its memory: lagging duty, current, heat, bristles, twist of the gear. As long as no effect with
 * memory is switched on, only the state is integrated.
 *
 * A lag m' = rate (target - m) may be far faster than a step h. It is integrated exactly for a
 * target that stays: over the step `gained` of the way is covered, and on average over the step
 * the share `left` of the way lies ahead,
 *
 *   gained = 1 - exp(-rate h),   left = gained / (rate h),   mean m = target + (m0 - target) left
 *
 * Other equations see the mean, so rate to infinity is the plant without the lag. With a target
 * that moves the error is second order in h.
 *
 * A soft gear parts the inertia J of a drive (seen at the wheel) into motor (1 - p) J and wheel
 * p J, p = load_share. Twist t = motor - wheel angle, slack u = wheel - motor speed = -t':
 *
 *   gear torque  k (t -+ play / 2) + c t' outside of the play, 0 inside; teeth do not pull.
 *                k and c are those of the teeth where there is play and no other compliance
 *   (1 - p) J motor' = motor torque - gear,   p J wheel' = gear - road
 */
#ifndef OMNISLIP_SIM_MEMORY_H
#define OMNISLIP_SIM_MEMORY_H

#include <algorithm>
#include <cmath>

#include "effects.h"

namespace omnislip {
inline namespace OMNISLIP_INSTRUCTION_SET {

/* Steps after a jump of the command, beside steps of 1 ms: with them the worst error of a hard
 * drive falls from 0.2 mm to 0.3 um (tests/sim/test_accuracy.py). The error of a rule of order 4
 * grows with the fourth power of the step, but with the second where the rim crosses the kink of
 * the friction law: the two stay alike where the fine step goes with the square of the other. */
constexpr double kJumpSettles_s = 20e-3;
constexpr double kJumpStep_s = 0.125e-3, kBesideJumpStep_s = 1e-3;

/* A command that rises within a row by more than this goes up in steps of that length at most: each
 * step holds its mean, and beside shafts that follow in 3 ms two stairs in a row of 5 ms were 235
 * off in the squares of whitened innovations. After a jump it likely rises, too. */
constexpr double kRising = 0.01, kRisingStep_s = 1.25e-3;

inline double jump_step_s(double wanted_s) {
    const double coarser = std::max(1.0, wanted_s / kBesideJumpStep_s);
    return std::min({wanted_s, kJumpStep_s * coarser * coarser, kRisingStep_s});
}

/* A step so long that every lag reaches its target. */
constexpr double kForever_s = 1e30;

template <class S>
bool any_lane_differs(const S &x, double value) {
    bool differs = false;
    for (int i = 0; i < LaneCount<S>::value; ++i)
        differs = differs || lane(x, i) != value;
    return differs;
}

/* True when one of `n` values differs from `value` in one lane. */
template <class S>
bool any_differs(const S *values, int n, double value) {
    bool differs = false;
    for (int i = 0; i < n; ++i)
        differs = differs || any_lane_differs(values[i], value);
    return differs;
}

template <class S, int N>
void forget(Constants<S, N> &c) {
    c.pose_delay_s = c.clock_fraction = S(0.0);
    for (int i = 0; i < N; ++i) {
        c.delay_s[i] = c.driver_lag_s[i] = c.inductance_h[i] = S(0.0);
        c.heating_1_a2_s[i] = c.bristle_length_m[i] = S(0.0);
        c.bristle_rolling[i] = c.slip_lags[i] = S(0.0);
        c.cooling_time_s[i] = S(kCoolingTime_s);
        c.play_rad[i] = c.ripple_nm[i] = c.ripple_per_rad[i] = S(0.0);
        c.tooth_frequency_rad_s[i] = S(kToothFrequency_rad_s);
        c.tooth_damping_ratio[i] = S(kToothDampingRatio);
        c.stiffness_nm_rad[i] = S(kUnbounded);
        c.damping_nm_s_rad[i] = S(0.0);
        c.load_share[i] = S(kLoadShare);
    }
}

/* Places in a state of the memory that a model uses. */
template <int kMost>
class MemoryPlaces {
  public:
    void add(int first, int count) {
        for (int i = 0; i < count; ++i)
            places_[count_++] = first + i;
    }
    void clear() {
        count_ = 0;
    }
    const int *begin() const {
        return places_;
    }
    const int *end() const {
        return places_ + count_;
    }

  private:
    int places_[kMost], count_ = 0;
};

template <class S>
struct Relaxation {
    S gained, left;

    /* One over a time constant or length, large where there is none. */
    static S per(const S &constant) {
        using std::max;
        return S(1.0) / max(constant, S(kLeast));
    }

    /* Step times one over the constant; an instant without a lag counts as reached. Short steps,
     * most of them, by the series of left = sum (-lengths)^k / (k + 1)!, to the last digit. */
    static Relaxation over(const S &length, const S &per_constant) {
        using std::expm1;
        using std::max;
        using std::min;
        const S lengths = min(length * per_constant, S(1e100));
        const auto lags = per_constant < S(1.0 / kLeast);
        if (!any_above(lengths, 0.5)) {
            S left = S(1.0);
            for (int k = 14; k > 1; --k)
                left = S(1.0) - lengths * S(1.0 / k) * left;
            return {lengths * left, select(lags, left, S(0.0))};
        }
        const S gained = -expm1(-lengths);
        const S left = select(lengths > S(0.0), gained / max(lengths, S(1e-300)), S(1.0));
        return {gained, select(lags, left, S(0.0))};
    }

  private:
    static constexpr double kLeast = 1e-200;
};

template <class S>
class SoftGear {
  public:
    /* The gear of shaft i, with this inertia of its drive. */
    template <int N>
    void prepare(const Constants<S, N> &c, int i, const S &inertia) {
        const S &play = c.play_rad[i], &stiffness = c.stiffness_nm_rad[i];
        const S &load_share = c.load_share[i], &frequency = c.tooth_frequency_rad_s[i];
        const S reduced = load_share * (S(1.0) - load_share) * inertia;
        const S tooth = frequency * frequency * reduced;
        const S tooth_damping = S(2.0) * c.tooth_damping_ratio[i] * frequency * reduced;
        const auto springy = stiffness < S(kUnbounded);
        per_inertia_ = S(1.0) / inertia;
        per_motor_inertia_ = per_inertia_ / (S(1.0) - load_share);
        per_load_inertia_ = per_inertia_ / load_share;
        load_share_ = load_share;
        reduced_ = reduced;
        half_play_ = S(0.5) * play;
        damping_ = select(springy, c.damping_nm_s_rad[i], tooth_damping);
        stiffness_ = select(springy, stiffness, select(play > S(0.0), tooth, S(0.0)));
    }

    /* Acceleration of the motor and rate of the slack; all at the wheel. */
    void accelerate(const S &motor, const S &road, const S &twist, const S &slack,
                    S &motor_acceleration, S &slack_rate) const {
        const S gear = torque(twist, -slack);
        const S motor_side = (motor - gear) * per_motor_inertia_;
        const S wheel_side = (gear - road) * per_load_inertia_;
        const auto soft = stiffness_ > S(0.0);
        motor_acceleration = select(soft, motor_side, (motor - road) * per_inertia_);
        slack_rate = select(soft, wheel_side - motor_side, S(0.0));
    }

    /* Twist at which both sides accelerate alike, and that acceleration. */
    S settled_twist(const S &motor, const S &road, S &acceleration) const {
        acceleration = (motor - road) * per_inertia_;
        const S gear = road + load_share_ * (motor - road);
        const auto soft = stiffness_ > S(0.0);
        const S sprung = gear / select(soft, stiffness_, S(1.0));
        return select(soft, sprung + sign_of(gear) * half_play_, S(0.0));
    }

    /* Fastest rate of a shaft, given those at which what damps its motor and what damps its wheel
     * would slow it down if the gear were stiff. With a soft one they slow down each side alone, m
     * and w = rates over inertia shares, and closed teeth (k and c over the reduced inertia) have
     *
     *   0 = z^3 + a z^2 + b z + q,   a = c + m + w,   b = k + m w + c q / k,
     *                                q = k (p w + (1 - p) m)
     *
     * whose roots lie in the left half plane, a real one between -a and 0. */
    S rate_1_s(const S &motor_1_s, const S &wheel_1_s) const {
        using std::max;
        using std::sqrt;
        const S stiffness = stiffness_ / reduced_, damping = damping_ / reduced_;
        const S motor = motor_1_s / (S(1.0) - load_share_), wheel = wheel_1_s / load_share_;
        const S shared = load_share_ * wheel + (S(1.0) - load_share_) * motor;
        const S a = damping + motor + wheel, b = stiffness + motor * wheel + damping * shared;
        S low = -a, high = S(0.0);
        for (int halving = 0; halving < 40; ++halving) {
            const S z = S(0.5) * (low + high);
            const auto below = ((z + a) * z + b) * z + stiffness * shared < S(0.0);
            low = select(below, z, low);
            high = select(below, high, z);
        }
        /* The other two, z^2 + sum z + product = 0. */
        const S sum = a + low, product = b + low * sum;
        const S square = S(0.25) * sum * sum - product;
        const S others = select(square > S(0.0), S(0.5) * sum + sqrt(max(square, S(0.0))),
                                sqrt(max(product, S(0.0))));
        const S fastest = max(max(-low, others), max(motor, wheel));
        return select(stiffness_ > S(0.0), fastest, motor_1_s + wheel_1_s);
    }

  private:
    S torque(const S &twist, const S &twist_rate) const {
        using std::max;
        using std::min;
        const S closed = twist - max(min(twist, half_play_), -half_play_);
        const S sprung = stiffness_ * closed + damping_ * twist_rate;
        const S pressed = select(closed * sprung > S(0.0), sprung, S(0.0));
        return select(half_play_ > S(0.0), pressed, sprung);
    }

    S per_inertia_, per_motor_inertia_, per_load_inertia_; /* of both sides, motor, load */
    S load_share_, reduced_, half_play_, stiffness_, damping_;
};

/* Whether a command differs much from the one before it in memory. */
template <class Plant>
bool jumps(const double *command) {
    bool found = false;
    for (int i = 0; i < Plant::kMotors; ++i)
        found = found || std::abs(command[i] - command[i - Plant::kMotors]) > Plant::kCommandJump;
    return found;
}

/* The commands of a log up to `row`, from each time to the next, the first also before: what the
 * drivers of a plant see on average from begin to end, at once if they are the same. A command is
 * held or, if it may rise, rises evenly by `rise` around its mean (null: all are held). */
template <class Plant, bool kMayRise = false>
class LoggedCommands {
  public:
    LoggedCommands(const Plant &plant, const double *time_s, const double *command, long row,
                   const double *rise = nullptr)
        : plant_(plant), time_s_(time_s), command_(command), row_(row), rise_(rise) {}

    template <class S>
    void operator()(double begin_s, double end_s, S *command) const {
        constexpr int n = Plant::kMotors;
        for (int i = 0; i < n; ++i) {
            command[i] = S(in_row(i, row_, begin_s, end_s));
            if (plant_.delays()) {
                const S &delay_s = plant_.constants().delay_s[i];
                command[i] = from_lanes<S>([&](int k) {
                    const double late_s = lane(delay_s, k);
                    return mean(i, begin_s - late_s, end_s - late_s);
                });
            }
        }
    }

    /* The step to take in the row. What a jump of the duty (the begin of the log is one) sets off -
     * the rim crosses the steep part of the friction law within a fraction of a millisecond - wants
     * fine steps, and is over when the wheels roll or slide again; the rest of a log does not. It
     * depends on the log alone, not on a delay, so that parameter sets side by side take the same
     * steps. */
    double step_s(double wanted_s) const {
        const double since_s = time_s_[row_] - kJumpSettles_s;
        for (long row = row_; time_s_[row] > since_s; --row) {
            if (row == 0 || jumps<Plant>(command_ + row * Plant::kMotors))
                return jump_step_s(wanted_s);
        }
        return rises() ? std::min(wanted_s, kRisingStep_s) : wanted_s;
    }

  private:
    bool rises() const {
        bool found = false;
        for (int i = 0; kMayRise && rise_ != nullptr && i < Plant::kMotors; ++i)
            found = found || std::abs(rise_[row_ * Plant::kMotors + i]) > kRising;
        return found;
    }

    double mean(int motor, double begin_s, double end_s) const {
        const double length_s = end_s - begin_s;
        double sum = 0.0;
        long row = row_;
        for (; row > 0 && time_s_[row] > begin_s; --row) {
            if (time_s_[row] < end_s) {
                sum += (end_s - time_s_[row]) * in_row(motor, row, time_s_[row], end_s);
                end_s = time_s_[row];
            }
        }
        const double earliest = in_row(motor, row, begin_s, end_s);
        return end_s - begin_s == length_s ? earliest
                                           : (sum + (end_s - begin_s) * earliest) / length_s;
    }

    /* Mean command from begin to end, both within the row. */
    double in_row(int motor, long row, double begin_s, double end_s) const {
        const long at = row * Plant::kMotors + motor;
        if (!kMayRise || rise_ == nullptr || rise_[at] == 0.0)
            return command_[at];
        const double length_s = time_s_[row + 1] - time_s_[row];
        const double middle_s = 0.5 * (begin_s + end_s) - time_s_[row];
        const double passed = std::min(std::max(middle_s / length_s, 0.0), 1.0);
        return command_[at] + rise_[at] * (passed - 0.5);
    }

    const Plant &plant_;
    const double *time_s_, *command_;
    long row_;
    const double *rise_;
};

/* What a late camera does not show yet: the way (x, y, theta) that the body went in the last late_s
 * before row `row`; nothing for a camera that is early. `way` [row][3] holds the way gone until
 * each time, W numbers or lanes of them; in between the body moves evenly, before them it rests. */
template <class S, class W>
void way_since(const double *time_s, const W *way, long row, const S &late_s, S *since) {
    for (int c = 0; c < 3; ++c) {
        since[c] = from_lanes<S>([&](int k) {
            const auto gone = [&](long at) { return lane(way[3 * at + c], k); };
            const double shown_s = time_s[row] - lane(late_s, k);
            long at = row;
            while (at > 0 && time_s[at] > shown_s)
                --at;
            double shown = gone(at);
            if (at < row && time_s[at] < shown_s) {
                const double share = (shown_s - time_s[at]) / (time_s[at + 1] - time_s[at]);
                shown += share * (gone(at + 1) - shown);
            }
            return gone(row) - shown;
        });
    }
}

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
