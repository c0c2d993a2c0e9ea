/* replay_kernel.cpp - the row loops of replay.h for one SIMD instruction set.
 *
 * Compiled once per instruction set with OMNISLIP_ARCH (an xsimd architecture) and
 * OMNISLIP_ARCH_NAME. Only what stands in the namespace of that architecture (lanes.h), templates
 * over it and plain pointers live here, so that no function compiled for a wide instruction set can
 * be linked into code for a narrow one.
 */
#include <algorithm>
#include <new>
#include <type_traits>

#include "axis_plant.h"
#include "integrator.h"
#include "odometry_plant.h"
#include "replay.h"
#include "robot_plant.h"

namespace omnislip {
namespace {

/* Without forces there is nothing stiff: at 3 rad/s an arc of this length is followed to 1e-5 rad.
 */
constexpr double kArc_s = 0.1;

template <class S>
RobotInternals<S> internals_of(const RobotPlant<S> &);
template <class S>
AxisInternals<S> internals_of(const AxisPlant<S> &);
template <class S>
OdometryInternals internals_of(const OdometryPlant<S> &);

/* `kElectric` outputs follow those of the plant: bus voltage and motor currents, where logged. */
template <template <class> class PlantOf, class Arch, int kElectric>
class KernelOf final : public Kernel {
    using S = xsimd::batch<double, Arch>;
    using Plant = PlantOf<S>;
    using Internals = decltype(internals_of(std::declval<Plant>()));
    static constexpr int kLanes = LaneCount<S>::value;
    static constexpr int kStates = Plant::kStates;
    static constexpr int kAll = Plant::kAll;
    static constexpr int kOutputs = Plant::kOutputs + kElectric;
    static constexpr int kMotors = Plant::kMotors;
    /* A robot's shafts and its body are disturbed. */
    static constexpr int kPushed[] = {0, 1, 2, 3, 8, 9, 10};
    static constexpr int kPushes = Plant::kKind == kRobot ? 7 : 0;

    /* A plant whose lanes hold the sets `values[0..count-1]` (the last one repeated). */
    struct Loaded {
        alignas(64) S flat[kMaxParameters];
        Plant plant;
        double rate_1_s;

        Loaded(const double *values, int count, int size, const UserTermList &terms) {
            alignas(64) double spread[kLanes];
            bool active[kEffectCount];
            for (int p = 0; p < size; ++p) {
                for (int i = 0; i < kLanes; ++i) {
                    spread[i] = values[static_cast<long>(i < count ? i : count - 1) * size + p];
                }
                flat[p] = S::load_aligned(spread);
            }
            mark_active<Plant>(values, count, size, active);
            plant.prepare(flat, active, terms);
            rate_1_s = plant.fastest_rate_1_s();
        }
    };

    static void broadcast(const double *from, S *to, int n) {
        for (int i = 0; i < n; ++i)
            to[i] = S(from[i]);
    }

    /* State x [kAll] and disturbances of the filter in row k. */
    static void correct(const Track &track, long k, const S *innovation, S *x, S *disturbance) {
        const double *gain = &track.gain[k * (moved_states(track) + kPushes) * kOutputs];
        const auto by_gain = [&](S &corrected) {
            S change = S(gain[0]) * innovation[0];
            for (int j = 1; j < kOutputs; ++j)
                change = change + S(gain[j]) * innovation[j];
            corrected = corrected + change;
            gain += kOutputs;
        };
        for_moved(track, x, by_gain);
        for (int c = 0; c < kPushes; ++c)
            by_gain(disturbance[c]);
    }

    /* States and filtered memory, in turn; how many. */
    template <class Work>
    static void for_moved(const Track &track, S *x, Work &&work) {
        for (int i = 0; i < kStates; ++i)
            work(x[i]);
        for (const int place : track.memory)
            work(x[place]);
    }
    static int moved_states(const Track &track) {
        return kStates + static_cast<int>(track.memory.size());
    }

    /* What the disturbances add to the state x [kAll] from row k to the next. */
    static void disturb(const Track &track, long k, S *x, S *disturbance) {
        if constexpr (kPushes > 0) {
            const double *push = &track.push[k * moved_states(track) * kPushes];
            const auto by_push = [&](S &pushed) {
                for (int c = 0; c < kPushes; ++c)
                    pushed = pushed + S(push[c]) * disturbance[c];
                push += kPushes;
            };
            for_moved(track, x, by_push);
            for (int c = 0; c < kPushes; ++c)
                disturbance[c] = disturbance[c] * S(track.decay[k]);
        }
    }

    using Commands = LoggedCommands<Plant, true>;

    static Commands logged(const Plant &plant, const Recording &recording, long row) {
        const double *rise = recording.rise.empty() ? nullptr : recording.rise.data();
        return {plant, recording.time_s.data(), recording.command.data(), row, rise};
    }

    static bool shows_late(const Plant &plant) {
        if constexpr (Plant::kKind == kRobot)
            return plant.shows_late();
        return false;
    }

    /* What the body went since the moment that a late camera shows in row k, by the model: what the
     * filter corrects is no way gone. */
    class Way {
      public:
        Way(const Plant &plant, const Recording &recording)
            : plant_(plant),
              recording_(recording),
              gone_(shows_late(plant) ? 3 * static_cast<std::size_t>(recording.rows) : 0, S(0.0)) {}

        /* `move` takes x from row k to the next. */
        template <class Move>
        void follow(long k, const S *x, Move &&move) {
            if constexpr (Plant::kKind == kRobot) {
                if (!gone_.empty()) {
                    S *gone = &gone_[3 * k];
                    for (int c = 0; c < 3; ++c)
                        gone[3 + c] = gone[c] - x[Plant::kPose + c];
                    move();
                    for (int c = 0; c < 3; ++c)
                        gone[3 + c] = gone[3 + c] + x[Plant::kPose + c];
                    return;
                }
            }
            move();
        }

        /* [3]; null for a camera that shows the row's moment. */
        const S *since(long k) {
            if constexpr (Plant::kKind == kRobot) {
                if (!gone_.empty()) {
                    const double *time_s = recording_.time_s.data();
                    way_since(time_s, gone_.data(), k, plant_.late_s(S(time_s[k])), since_);
                    return since_;
                }
            }
            return nullptr;
        }

        void go_as(const Way &other) {
            gone_ = other.gone_;
        }

      private:
        const Plant &plant_;
        const Recording &recording_;
        std::vector<S> gone_;
        S since_[3];
    };

    /* What the sensors show in row k with state and memory x [kAll]. */
    static void observe(const Plant &plant, const Recording &recording, long k, const S *x,
                        const S *way_since, S *y) {
        const double time_s = recording.time_s[k];
        if constexpr (Plant::kKind == kRobot)
            plant.output(x, S(time_s), y, way_since);
        else
            plant.output(x, S(time_s), y);
        if constexpr (kElectric > 0) {
            S command[kMotors], dx[kAll];
            Internals in;
            logged(plant, recording, k)(time_s, time_s, command);
            if (recording.read_before > 0.0 && k > 0) {
                S before[kMotors];
                logged(plant, recording, k - 1)(time_s, time_s, before);
                for (int i = 0; i < kMotors; ++i)
                    command[i] += S(recording.read_before) * (before[i] - command[i]);
            }
            look(plant, x, command, time_s, dx, in);
            S *electric = y + Plant::kOutputs;
            electric[0] = in.bus_v;
            for (int i = 0; i < kMotors; ++i)
                electric[1 + i] = in.current_a[i];
        }
    }

    /* measured - predicted; 0 where nothing was measured. */
    static void innovate(const Plant &plant, const Recording &recording, long k, const S *x,
                         Way &way, S *innovation) {
        const double *measured = &recording.output[k * kOutputs];
        observe(plant, recording, k, x, way.since(k), innovation);
        for (int j = 0; j < kOutputs; ++j) {
            const bool sampled = measured[j] == measured[j];
            innovation[j] = sampled ? S(measured[j]) - innovation[j] : S(0.0);
        }
    }

    /* Lane k of to[i] = from[k][i]; lanes beyond `count` repeat the last row. */
    static void gather(const double *from, int count, int width, S *to) {
        alignas(64) double spread[kLanes];
        for (int i = 0; i < width; ++i) {
            for (int k = 0; k < kLanes; ++k) {
                spread[k] = from[(k < count ? k : count - 1) * width + i];
            }
            to[i] = S::load_aligned(spread);
        }
    }

    /* `row_of` a set is where its row goes. */
    template <class RowOf>
    static void scatter(const S *row, int count, RowOf &&row_of) {
        alignas(64) double spread[kLanes];
        for (int j = 0; j < kOutputs; ++j) {
            row[j].store_aligned(spread);
            for (int s = 0; s < count; ++s)
                row_of(s)[j] = spread[s];
        }
    }

    /* `w` [kOutputs][kOutputs] is lower triangular. */
    static void whiten(const double *w, const S *innovation, S *white) {
        for (int i = 0; i < kOutputs; ++i) {
            white[i] = S(0.0);
            for (int j = 0; j <= i; ++j)
                white[i] = white[i] + S(w[i * kOutputs + j]) * innovation[j];
        }
    }

    static void settle_first(const Loaded &loaded, const Recording &recording, S *x,
                             Internals &in) {
        S command[kMotors];
        broadcast(recording.command.data(), command, kMotors);
        if (recording.begins())
            std::fill_n(command, kMotors, S(0.0));
        omnislip::settle(loaded.plant, x, command, recording.time_s[0], in);
        if constexpr (Plant::kKind == kOdometry)
            loaded.plant.begin_where_shown(x);
        if constexpr (Plant::kKind == kRobot) {
            loaded.plant.warm(recording.past_s.data(), recording.past_current_a2.data(),
                              recording.past_s.size(), x);
        }
    }

    /* x [kAll] from row k to the next. */
    static void advance_row(const Loaded &loaded, const Recording &recording, long k, double step_s,
                            S *x, Internals &in) {
        const double *time_s = recording.time_s.data();
        const double duration_s = time_s[k + 1] - time_s[k];
        if constexpr (Plant::kKind == kOdometry) {
            const ShownCommands<S> commands(loaded.plant, time_s, recording.command.data(), k,
                                            recording.rows);
            advance(loaded.plant, x, commands, time_s[k], duration_s, kArc_s, 0.0, in);
        } else {
            const Commands commands = logged(loaded.plant, recording, k);
            advance(loaded.plant, x, commands, time_s[k], duration_s, commands.step_s(step_s),
                    loaded.rate_1_s, in);
        }
    }

    int total_parameters() const {
        return Plant::kBase + effect_slot_count(kMotors) + terms_.slots();
    }

    UserTermList terms_;

  public:
    explicit KernelOf(const UserTermList &terms) : terms_(terms) {}
    int lanes() const override {
        return kLanes;
    }
    int states() const override {
        return kStates;
    }
    int states_and_memory() const override {
        return kAll;
    }
    int pushes() const override {
        return kPushes;
    }
    int outputs() const override {
        return kOutputs;
    }
    int current_outputs() const override {
        return kElectric > 0 ? kMotors : 0;
    }
    int motors() const override {
        return kMotors;
    }
    int parameters() const override {
        return total_parameters();
    }
    const char *instruction_set() const override {
        return OMNISLIP_ARCH_NAME;
    }

    double fastest_rate_1_s(const double *values, int count) const override {
        return Loaded(values, count, total_parameters(), terms_).rate_1_s;
    }

    std::shared_ptr<const void> load(const double *values) const override {
        return std::make_shared<const Loaded>(values, 1, total_parameters(), terms_);
    }

    void settle(const void *loaded_set, const Recording &recording, double *state) const override {
        S x[kAll];
        Internals in;
        broadcast(state, x, kStates);
        settle_first(*static_cast<const Loaded *>(loaded_set), recording, x, in);
        for (int i = 0; i < kAll; ++i)
            state[i] = lane(x[i], 0);
    }

    std::vector<double> pushed(const void *loaded_set,
                               const std::vector<int> &memory) const override {
        std::vector<double> all((kStates + memory.size()) * kPushes, 0.0);
        for (int c = 0; c < kPushes; ++c)
            all[kPushed[c] * kPushes + c] = 1.0;
        if constexpr (Plant::kKind == kRobot) {
            const Plant &plant = static_cast<const Loaded *>(loaded_set)->plant;
            const double ratio = lane(plant.constants().gear_ratio, 0);
            for (std::size_t k = 0; k < memory.size(); ++k) {
                const int motor = memory[k] - Plant::kSlack;
                if (0 <= motor && motor < kMotors)
                    all[(kStates + k) * kPushes + motor] = -1.0 / ratio;
            }
        }
        return all;
    }

    std::vector<int> filtered_memory(const void *loaded_set) const override {
        const Plant &plant = static_cast<const Loaded *>(loaded_set)->plant;
        std::vector<int> memory;
        if constexpr (Plant::kKind == kRobot) {
            for (int i = 0; plant.has_bristles() && i < kMotors; ++i)
                memory.push_back(Plant::kGrip + i);
            for (int i = 0; plant.has_springs() && i < kMotors; ++i)
                memory.insert(memory.end(), {Plant::kSlack + i, Plant::kTwist + i});
        }
        return memory;
    }

    void linearise(const void *loaded_set, const Recording &recording, int row, double step_s,
                   const std::vector<int> &moved, const double *state, double *next,
                   double *transition) const override {
        const Loaded &loaded = *static_cast<const Loaded *>(loaded_set);
        const int n = static_cast<int>(moved.size());
        Internals in;
        for (int first = 0; first < n; first += kLanes - 1) {
            S x[kAll];
            seed(state, moved, first, x);
            advance_row(loaded, recording, row, step_s, x, in);
            for (int i = 0; i < kAll; ++i)
                next[i] = lane(x[i], 0);
            for (int i = 0; i < n; ++i) {
                for (int j = first; j < n && j < first + kLanes - 1; ++j) {
                    const double there = lane(x[moved[i]], j - first + 1);
                    transition[i * n + j] = (there - next[moved[i]]) / kProbe;
                }
            }
        }
    }

    bool shows_late(const void *loaded_set) const override {
        return shows_late(static_cast<const Loaded *>(loaded_set)->plant);
    }

    void linearise_output(const void *loaded_set, const Recording &recording, int row,
                          const std::vector<int> &moved, const double *gone, const double *state,
                          double *output, double *slope) const override {
        const Loaded &loaded = *static_cast<const Loaded *>(loaded_set);
        const int n = static_cast<int>(moved.size());
        for (int first = 0; first < n; first += kLanes - 1) {
            S x[kAll], y[kOutputs];
            seed(state, moved, first, x);
            observe(loaded.plant, recording, row, x, nullptr, y);
            for (int i = 0; i < kOutputs; ++i) {
                output[i] = lane(y[i], 0);
                for (int j = first; j < n && j < first + kLanes - 1; ++j) {
                    slope[i * n + j] = (lane(y[i], j - first + 1) - output[i]) / kProbe;
                }
            }
        }
        if constexpr (Plant::kKind == kRobot) {
            if (gone != nullptr) {
                S x[kAll], y[kOutputs], since[3];
                const double *time_s = recording.time_s.data();
                broadcast(state, x, kAll);
                way_since(time_s, gone, row, loaded.plant.late_s(S(time_s[row])), since);
                observe(loaded.plant, recording, row, x, since, y);
                for (int i = 0; i < kOutputs; ++i)
                    output[i] = lane(y[i], 0);
            }
        }
    }

    void derivatives(const void *loaded_set, int points, const double *states,
                     const double *commands, double *derivative) const override {
        const Loaded &loaded = *static_cast<const Loaded *>(loaded_set);
        S x[kAll], command[kMotors], dx[kAll];
        Internals in;
        for (int first = 0; first < points; first += kLanes) {
            const int count = points - first < kLanes ? points - first : kLanes;
            gather(states + static_cast<long>(first) * kStates, count, kStates, x);
            gather(commands + static_cast<long>(first) * kMotors, count, kMotors, command);
            omnislip::settle(loaded.plant, x, command, 0.0, in);
            look(loaded.plant, x, command, 0.0, dx, in);
            for (int i = 0; i < kStates; ++i) {
                for (int k = 0; k < count; ++k) {
                    derivative[static_cast<long>(first + k) * kStates + i] = lane(dx[i], k);
                }
            }
        }
    }

    void carry_covariance(const double *transition, int filter_states, double *p) const override {
        by_memory(filter_states - kStates - kPushes,
                  [&](auto memory) { carry_covariance_with<memory.value>(transition, p); });
    }

    double correct_by(const double *innovation, const double *slope, const double *variance,
                      const double *late, double most, int filter_states, double *estimate,
                      double *p, double *gain, double *whitening,
                      double *correction_variance) const override {
        return by_memory(filter_states - kStates - kPushes, [&](auto memory) {
            return correct_with<memory.value>(innovation, slope, variance, late, most, estimate, p,
                                              gain, whitening, correction_variance);
        });
    }

    void innovations(const Recording &recording, const Track &track, const double *values,
                     int count, double step_s, double least_rate_1_s, int first_row,
                     double *const *residuals) const override {
        Loaded loaded(values, count, total_parameters(), terms_);
        loaded.rate_1_s = std::max(loaded.rate_1_s, least_rate_1_s);
        S x[kAll], disturbance[kPushes + 1], innovation[kOutputs], white[kOutputs];
        std::fill_n(disturbance, kPushes, S(0.0));
        Internals in;
        broadcast(recording.initial_state.data(), x, kStates);
        settle_first(loaded, recording, x, in);
        Way way(loaded.plant, recording);
        for (long k = 0; k < recording.rows; ++k) {
            innovate(loaded.plant, recording, k, x, way, innovation);
            correct(track, k, innovation, x, disturbance);
            if (k >= first_row) {
                whiten(&track.whitening[k * kOutputs * kOutputs], innovation, white);
                const long place = (k - first_row) * kOutputs;
                scatter(white, count, [&](int set) { return residuals[set] + place; });
            }
            if (k + 1 == recording.rows)
                break;
            way.follow(k, x, [&] {
                advance_row(loaded, recording, k, step_s, x, in);
                disturb(track, k, x, disturbance);
            });
        }
    }

    void replays(const Recording &recording, const Track &track, const double *values, int count,
                 double step_s, double window_s, double *errors) const override {
        const Loaded loaded(values, count, total_parameters(), terms_);
        const long plane = static_cast<long>(recording.rows) * kOutputs;
        S filtered[kAll], free[kAll], innovation[kOutputs], error[kOutputs];
        S disturbance[kPushes + 1];
        std::fill_n(disturbance, kPushes, S(0.0));
        Internals in;
        broadcast(recording.initial_state.data(), filtered, kStates);
        settle_first(loaded, recording, filtered, in);
        double restart_s = recording.time_s[0] + recording.settle_s;
        std::copy_n(filtered, kAll, free);
        Way filtered_way(loaded.plant, recording), free_way(loaded.plant, recording);
        for (long k = 0; k < recording.rows; ++k) {
            const double t = recording.time_s[k];
            innovate(loaded.plant, recording, k, free, free_way, error);
            scatter(error, count, [&](int set) { return errors + set * plane + k * kOutputs; });
            innovate(loaded.plant, recording, k, filtered, filtered_way, innovation);
            correct(track, k, innovation, filtered, disturbance);
            if (t >= restart_s) {
                std::copy_n(filtered, kAll, free);
                free_way.go_as(filtered_way);
                restart_s += window_s;
            }
            if (k + 1 == recording.rows)
                break;
            filtered_way.follow(k, filtered, [&] {
                advance_row(loaded, recording, k, step_s, filtered, in);
                disturb(track, k, filtered, disturbance);
            });
            free_way.follow(k, free, [&] { advance_row(loaded, recording, k, step_s, free, in); });
        }
    }

    void respond(const Recording &recording, const Track &track, const double *push,
                 const double *shown, int columns, int first, double *response) const override {
        by_memory(static_cast<int>(track.memory.size()), [&](auto memory) {
            respond_with<memory.value>(recording, track, push, shown, columns, first, response);
        });
    }

    void likelihoods(const Recording &recording, const Track &track, const Noise *noises, int count,
                     double *log_likelihood, double *covariance, int width) const override {
        by_memory(static_cast<int>(track.memory.size()), [&](auto memory) {
            likelihoods_with<memory.value>(recording, track, noises, count, log_likelihood,
                                           covariance, width);
        });
    }

    void add_information(const Track &track, int rows, const double *covariance, int width,
                         double *information) const override {
        constexpr int kPairs = kOutputs * (kOutputs + 1) / 2;
        std::vector<double> change(static_cast<std::size_t>(kPairs) *
                                   static_cast<std::size_t>(width));
        for (int k = 0; k < rows; ++k) {
            const Sampled sampled(&track.innovation[static_cast<long>(k) * kOutputs]);
            const int pairs = sampled.count() * (sampled.count() + 1) / 2;
            whiten_changes(sampled.count(), covariance, width, change.data());
            covariance += pairs * width;
            for (int i = 1; i < width; ++i) {
                for (int first = 0; first < width; first += kLanes) {
                    double *told = information + i * width + first;
                    S sum = S::load_unaligned(told);
                    for (int pair = 0; pair < pairs; ++pair) {
                        const double *row = &change[static_cast<std::size_t>(pair * width)];
                        sum += S(row[i]) * S::load_unaligned(row + first);
                    }
                    sum.store_unaligned(told);
                }
            }
        }
    }

  private:
    /* work(memory), with the number of places of memory that the filter corrects as its value:
     * none, of bristles, of springs, or of both. */
    template <class Work>
    static auto by_memory(int corrected, Work &&work) {
        if constexpr (Plant::kKind == kRobot) {
            if (corrected == 3 * kMotors)
                return work(std::integral_constant<int, 3 * kMotors>{});
            if (corrected == 2 * kMotors)
                return work(std::integral_constant<int, 2 * kMotors>{});
            if (corrected == kMotors)
                return work(std::integral_constant<int, kMotors>{});
        }
        return work(std::integral_constant<int, 0>{});
    }

    template <int kMemory>
    static void respond_with(const Recording &recording, const Track &track, const double *push,
                             const double *shown, int columns, int first, double *response) {
        constexpr int kFilter = kStates + kMemory + kPushes;
        const int count = std::min(kLanes, columns - first);
        const auto read = [&](const double *rows, long row) {
            const double *own = rows + row * columns + first;
            return from_lanes<S>([&](int i) { return i < count ? own[i] : 0.0; });
        };
        S error[kFilter], moved[kFilter], pushed[kFilter];
        std::fill_n(error, kFilter, S(0.0));
        for (long k = 0; k < recording.rows; ++k) {
            const Sampled sampled(&track.innovation[k * kOutputs]);
            S seen[kOutputs];
            for (int a = 0; a < sampled.count(); ++a) {
                const double *h = &track.slope[(k * kOutputs + sampled[a]) * kFilter];
                seen[a] = read(shown, k * kOutputs + sampled[a]);
                for (int j = 0; j < kFilter; ++j) {
                    if (h[j] != 0.0)
                        seen[a] -= S(h[j]) * error[j];
                }
                const double *whitening = &track.whitening[(k * kOutputs + sampled[a]) * kOutputs];
                S white(0.0);
                for (int b = 0; b <= a; ++b)
                    white += S(whitening[sampled[b]]) * seen[b];
                for (int i = 0; i < count; ++i)
                    response[(k * kOutputs + sampled[a]) * columns + first + i] = lane(white, i);
            }
            if (k + 1 == recording.rows)
                break;
            const double half_s = 0.5 * (recording.time_s[k + 1] - recording.time_s[k]);
            for (int i = 0; i < kFilter; ++i) {
                pushed[i] = S(half_s) * read(push, k * kFilter + i);
            }
            for_pushed_memory<kMemory>(track, [&](int i, int motor, double share) {
                pushed[i] += S(share) * pushed[motor];
            });
            for (int i = 0; i < kFilter; ++i) {
                moved[i] = error[i] + pushed[i];
                for (int a = 0; a < sampled.count(); ++a)
                    moved[i] += S(track.gain[(k * kFilter + i) * kOutputs + sampled[a]]) * seen[a];
            }
            const double *transition = &track.transition[k * kFilter * kFilter];
            for (int i = 0; i < kFilter; ++i) {
                error[i] = pushed[i];
                for (int l = 0; l < kFilter; ++l) {
                    const double f = transition[i * kFilter + l];
                    if (f != 0.0)
                        error[i] += S(f) * moved[l];
                }
            }
        }
    }

    template <int kMemory>
    void likelihoods_with(const Recording &recording, const Track &track, const Noise *noises,
                          int count, double *log_likelihood, double *covariance, int width) const {
        constexpr int kMoved = kStates + kMemory, kFilter = kMoved + kPushes;
        const auto of_each = [&](auto &&number) {
            return from_lanes<S>([&](int i) { return number(noises[i < count ? i : count - 1]); });
        };
        const S lateness_s = of_each([](const Noise &n) { return std::sqrt(n.timing_s2); });
        const S unresolved = of_each([](const Noise &n) { return n.unresolved; });
        const S unresolved_current = of_each([](const Noise &n) { return n.unresolved_current; });
        const S colour_rate_1_s = of_each([](const Noise &n) { return n.colour_rate_1_s; });
        S process[kStates], output[kOutputs], late[kOutputs], total(0.0);
        S lasting[kPushes + 1][kPushes + 1];
        /* Covariance of the filter, and how far its state is from the track's. */
        S p[kFilter][kFilter], apart[kFilter];
        for (int i = 0; i < kFilter; ++i) {
            std::fill_n(p[i], kFilter, S(0.0));
            apart[i] = S(0.0);
        }
        for (int i = 0; i < kStates; ++i) {
            process[i] = of_each([i](const Noise &n) { return n.process[i]; });
            p[i][i] = recording.begins() ? S(recording.begun_variance[i])
                                         : of_each([i](const Noise &n) { return n.initial[i]; });
        }
        for (int c = 0; c < kPushes; ++c) {
            for (int other = 0; other < kPushes; ++other) {
                const int pair = c * kPushes + other;
                lasting[c][other] = of_each([pair](const Noise &n) { return n.coloured[pair]; });
                p[kMoved + c][kMoved + other] = lasting[c][other];
            }
            if (recording.begins())
                p[kMoved + c][kMoved + c] += S(recording.begun_variance[kStates + c]);
        }
        for (int j = 0; j < kOutputs; ++j) {
            output[j] = of_each([j](const Noise &n) { return n.output[j]; });
            late[j] = S(0.0);
        }
        const auto keep = [&](const S &sum) {
            if (covariance) {
                sum.store_unaligned(covariance);
                covariance += width;
            }
        };
        for (int k = 0; k < recording.rows; ++k) {
            const double *slope = &track.slope[k * kOutputs * kFilter];
            S variance[kOutputs];
            std::copy_n(output, kOutputs, variance);
            for (int i = 0; i < current_outputs(); ++i) {
                const double square = squared_step(recording, kMotors, k, i);
                variance[kOutputs - kMotors + i] += S(0.25 * square) * unresolved_current;
            }
            const S most(recording.most_counted(k));
            update<kFilter>(track, k, slope, variance, late, most, p, apart, total, keep);
            if (k + 1 == recording.rows)
                break;
            const double duration_s = recording.time_s[k + 1] - recording.time_s[k];
            double moved[kMoved];
            moved_by<kFilter>(track, k, moved);
            for (int j = 0; j < kOutputs; ++j) {
                double way = 0.0;
                for (int i = 0; i < kMoved; ++i)
                    way += slope[j * kFilter + i] * moved[i];
                late[j] = S(way / duration_s) * lateness_s;
            }
            const S decay = exp(S(-duration_s) * colour_rate_1_s);
            carry<kFilter>(track, k, decay, p, apart);
            for (int i = 0; i < kStates; ++i)
                p[i][i] += process[i] * S(duration_s);
            if constexpr (kMemory > 0)
                add_kicks<kFilter>(track, duration_s, process, p);
            const S renewed = S(1.0) - decay * decay;
            for (int c = 0; c < kPushes; ++c) {
                for (int other = 0; other < kPushes; ++other)
                    p[kMoved + c][kMoved + other] += renewed * lasting[c][other];
            }
            if constexpr (kPushes > 0)
                add_untold<kFilter>(recording, track, k, unresolved, p);
        }
        for (int i = 0; i < count; ++i)
            log_likelihood[i] += lane(total, i);
    }

    /* What is pushed of the memory along with a motor: entry (i, motor) of Track::pushed. */
    template <int kMemory, class Work>
    static void for_pushed_memory(const Track &track, Work &&work) {
        for (int i = kStates; i < kStates + kMemory; ++i) {
            for (int motor = 0; motor < kMotors; ++motor) {
                const double share = track.pushed[i * kPushes + motor];
                if (share != 0.0)
                    work(i, motor, share);
            }
        }
    }

    /* P grows by kicks of the motors also where these move memory. A place goes with one motor. */
    template <int kFilter>
    static void add_kicks(const Track &track, double duration_s, const S *process,
                          S (&p)[kFilter][kFilter]) {
        for_pushed_memory<kFilter - kStates - kPushes>(track, [&](int i, int motor, double share) {
            const S kick = process[motor] * S(duration_s * share);
            p[i][motor] += kick;
            p[motor][i] += kick;
            p[i][i] += kick * S(share);
        });
    }

    /* P grows from row k to the next by what the row's mean does not tell of the commands. */
    template <int kFilter>
    static void add_untold(const Recording &recording, const Track &track, int k,
                           const S &unresolved, S (&p)[kFilter][kFilter]) {
        constexpr int kMoved = kFilter - kPushes;
        const double duration_s = recording.time_s[k + 1] - recording.time_s[k];
        const double untold = recording.untold_in(static_cast<std::size_t>(k));
        for (int motor = 0; motor < kMotors; ++motor) {
            const double *push = &track.push[k * kMoved * kPushes + motor];
            const double lost = untold * change_into(recording, kMotors, k + 1, motor);
            const S square = unresolved * S(squared_change(recording, kMotors, k, motor));
            double begin[kMoved], end[kMoved], late[kMoved];
            for (int i = 0; i < kMoved; ++i) {
                end[i] = duration_s * track.pushed[i * kPushes + motor];
                begin[i] = 2.0 * push[i * kPushes] - end[i];
                late[i] = (end[i] - begin[i]) / 12.0;
            }
            for (int i = 0; i < kMoved; ++i) {
                for (int j = 0; j <= i; ++j) {
                    const double unknown = begin[i] * begin[j] + end[i] * end[j];
                    const S grown = S(0.5 * lost * lost * unknown) + square * S(late[i] * late[j]);
                    p[i][j] += grown;
                    if (i != j)
                        p[j][i] += grown;
                }
            }
        }
    }

    /* Of a row of `sampled` outputs: what each noise changes of the first one's covariance,
     * whitened by that, A_i = L^-1 (S_i - S_0) L^-T, as [pair][width]. What is on the diagonal is
     * divided by the root of 2: then the products of two changes sum to tr(A_i A_j) / 2. */
    static void whiten_changes(int sampled, const double *covariance, int width, double *change) {
        const auto pair = [](int a, int b) { return a * (a + 1) / 2 + b; };
        double root[kOutputs][kOutputs], per_root[kOutputs];
        for (int a = 0; a < sampled; ++a) {
            for (int b = 0; b <= a; ++b) {
                double sum = covariance[pair(a, b) * width];
                for (int c = 0; c < b; ++c)
                    sum -= root[a][c] * root[b][c];
                root[a][b] = a == b ? std::sqrt(sum) : sum * per_root[b];
            }
            per_root[a] = 1.0 / root[a][a];
        }
        for (int first = 0; first < width; first += kLanes) {
            S left[kOutputs][kOutputs];
            for (int a = 0; a < sampled; ++a) {
                for (int b = 0; b <= a; ++b) {
                    const double *own = covariance + pair(a, b) * width;
                    left[a][b] = S::load_unaligned(own + first) - S(own[0]);
                    left[b][a] = left[a][b];
                }
            }
            for (int a = 0; a < sampled; ++a) {
                for (int b = 0; b < sampled; ++b) {
                    for (int c = 0; c < a; ++c)
                        left[a][b] -= S(root[a][c]) * left[c][b];
                    left[a][b] *= S(per_root[a]);
                }
            }
            for (int a = 0; a < sampled; ++a) {
                for (int b = 0; b <= a; ++b) {
                    for (int c = 0; c < b; ++c)
                        left[a][b] -= left[a][c] * S(root[b][c]);
                    left[a][b] *= S(per_root[b]);
                    const S weighed = a == b ? left[a][b] * S(std::sqrt(0.5)) : left[a][b];
                    weighed.store_unaligned(change + pair(a, b) * width + first);
                }
            }
        }
    }

    /* One row of the filter of `likelihoods`. `keep(S_ab)` of the sampled a, and b up to a. */
    template <int kFilter, class Keep>
    static void update(const Track &track, int k, const double *slope, const S *variance,
                       const S *late, const S &most, S (&p)[kFilter][kFilter], S *apart, S &total,
                       Keep &&keep) {
        const double *shown = &track.innovation[k * kOutputs];
        const Sampled sampled(shown);
        S innovation[kOutputs];
        for (int a = 0; a < sampled.count(); ++a) {
            const double *h = slope + sampled[a] * kFilter;
            innovation[a] = S(shown[sampled[a]]);
            for (int j = 0; j < kFilter; ++j) {
                if (h[j] != 0.0)
                    innovation[a] -= S(h[j]) * apart[j];
            }
        }
        Told<S, kFilter> told;
        total += told.by(sampled, slope, variance, late, innovation, most, p, keep);
        for (int i = 0; i < kFilter; ++i) {
            double corrected = 0.0;
            for (int a = 0; a < sampled.count(); ++a)
                corrected +=
                    track.gain[(k * kFilter + i) * kOutputs + sampled[a]] * shown[sampled[a]];
            apart[i] -= S(corrected);
            for (int a = 0; a < sampled.count(); ++a)
                apart[i] += told.g[a][i] * told.white[a];
        }
    }

    /* The outputs that were sampled in a row: what is no number was not. */
    class Sampled {
      public:
        explicit Sampled(const double *shown) {
            for (int j = 0; j < kOutputs; ++j) {
                if (shown[j] == shown[j])
                    outputs_[found_++] = j;
            }
        }
        int count() const {
            return std::min(found_, kOutputs); /* what the compiler cannot see */
        }
        int operator[](int a) const {
            return outputs_[a];
        }

      private:
        int outputs_[kOutputs], found_ = 0;
    };

    /* What the innovations e of a row tell, of covariance S = H P H' + ... = L L': white = e / L
     * and G = P H' / L'. The state moves by K e = G white, and P falls by G G'. */
    template <class T, int kFilter>
    struct Told {
        T g[kOutputs][kFilter], white[kOutputs], root[kOutputs][kOutputs], per_root[kOutputs];

        /* Fills in these, lets P fall; returns the log likelihood, in which white^2 counts `most`.
         * `keep(S_ab)`, b up to a. */
        template <class Keep>
        T by(const Sampled &sampled, const double *slope, const T *variance, const T *late,
             const T *innovation, const T &most, T (*p)[kFilter], Keep &&keep) {
            using std::log;
            using std::min;
            using std::sqrt;
            T total(0.0), square(0.0);
            for (int a = 0; a < sampled.count(); ++a) {
                const double *h = slope + sampled[a] * kFilter;
                T ph[kFilter], left = innovation[a];
                std::fill_n(ph, kFilter, T(0.0));
                for (int j = 0; j < kFilter; ++j) {
                    if (h[j] == 0.0)
                        continue;
                    for (int i = 0; i < kFilter; ++i)
                        ph[i] += T(h[j]) * p[j][i];
                }
                for (int b = 0; b <= a; ++b) {
                    T sum = late[sampled[a]] * late[sampled[b]];
                    const double *other = slope + sampled[b] * kFilter;
                    for (int i = 0; i < kFilter; ++i) {
                        if (other[i] != 0.0)
                            sum += T(other[i]) * ph[i];
                    }
                    if (a == b)
                        sum += variance[sampled[a]];
                    keep(sum);
                    for (int c = 0; c < b; ++c)
                        sum -= root[a][c] * root[b][c];
                    root[a][b] = a == b ? sqrt(sum) : sum * per_root[b];
                }
                per_root[a] = T(1.0) / root[a][a];
                for (int c = 0; c < a; ++c) {
                    left -= root[a][c] * white[c];
                    for (int i = 0; i < kFilter; ++i)
                        ph[i] -= root[a][c] * g[c][i];
                }
                white[a] = left * per_root[a];
                for (int i = 0; i < kFilter; ++i)
                    g[a][i] = ph[i] * per_root[a];
                total += log(per_root[a]) - T(0.5 * std::log(2.0 * kPi));
                square += white[a] * white[a];
            }
            for (int i = 0; i < kFilter; ++i) {
                for (int a = 0; a < sampled.count(); ++a) {
                    for (int j = 0; j < kFilter; ++j)
                        p[i][j] -= g[a][i] * g[a][j];
                }
            }
            return total - T(0.5) * min(square, most);
        }
    };

    /* One row of the filter of a track. With 1 / L the whitening, K = G / L. */
    template <int kMemory>
    static double correct_with(const double *innovation, const double *slope,
                               const double *variance, const double *late, double most,
                               double *estimate, double *p, double *gain, double *whitening,
                               double *correction_variance) {
        constexpr int kFilter = kStates + kMemory + kPushes;
        const Sampled sampled(innovation);
        double shown[kOutputs];
        for (int a = 0; a < sampled.count(); ++a)
            shown[a] = innovation[sampled[a]];
        Told<double, kFilter> told;
        const double log_likelihood =
            told.by(sampled, slope, variance, late, shown, most,
                    reinterpret_cast<double(*)[kFilter]>(p), [](double) {});
        double inverse[kOutputs][kOutputs];
        for (int a = 0; a < sampled.count(); ++a) {
            inverse[a][a] = told.per_root[a];
            for (int b = 0; b < a; ++b) {
                double sum = 0.0;
                for (int c = b; c < a; ++c)
                    sum -= told.root[a][c] * inverse[c][b];
                inverse[a][b] = sum * told.per_root[a];
            }
            for (int b = 0; b <= a; ++b)
                whitening[sampled[a] * kOutputs + sampled[b]] = inverse[a][b];
            for (int i = 0; i < kFilter; ++i) {
                const double g = told.g[a][i];
                estimate[i] += g * told.white[a];
                correction_variance[i] += g * g;
                for (int b = 0; b <= a; ++b)
                    gain[i * kOutputs + sampled[b]] += g * inverse[a][b];
            }
        }
        return log_likelihood;
    }

    /* What the track's state moved by from row k to the next, before the measurements there. */
    template <int kFilter>
    static void moved_by(const Track &track, int k, double *moved) {
        const double *shown = &track.innovation[(k + 1) * kOutputs];
        for (int i = 0; i < kFilter - kPushes; ++i) {
            moved[i] = track.state[(k + 1) * kFilter + i] - track.state[k * kFilter + i];
            for (int j = 0; j < kOutputs; ++j) {
                if (shown[j] == shown[j])
                    moved[i] -= track.gain[((k + 1) * kFilter + i) * kOutputs + j] * shown[j];
            }
        }
    }

    /* apart -> F apart, P -> F P F'. F of the plant's states is the track's, with many zeros; the
     * disturbances decay, the track's own at another rate. */
    template <int kFilter>
    static void carry(const Track &track, int k, const S &decay, S (&p)[kFilter][kFilter],
                      S *apart) {
        constexpr int kMoved = kFilter - kPushes;
        const double *transition = &track.transition[k * kFilter * kFilter];
        S half[kMoved][kFilter], moved[kMoved];
        for (int i = 0; i < kMoved; ++i) {
            moved[i] = S(0.0);
            std::fill_n(half[i], kFilter, S(0.0));
            for (int l = 0; l < kFilter; ++l) {
                const double f = transition[i * kFilter + l];
                if (f == 0.0)
                    continue;
                moved[i] += S(f) * apart[l];
                for (int j = 0; j < kFilter; ++j)
                    half[i][j] += S(f) * p[l][j];
            }
        }
        std::copy_n(moved, kMoved, apart);
        for (int j = 0; j < kMoved; ++j) {
            S column[kMoved];
            std::fill_n(column, kMoved, S(0.0));
            for (int l = 0; l < kFilter; ++l) {
                const double f = transition[j * kFilter + l];
                if (f == 0.0)
                    continue;
                for (int i = j; i < kMoved; ++i)
                    column[i] += S(f) * half[i][l];
            }
            for (int i = j; i < kMoved; ++i)
                p[i][j] = p[j][i] = column[i];
        }
        for (int c = kMoved; c < kFilter; ++c) {
            const double own = track.state[k * kFilter + c];
            apart[c] = decay * (apart[c] + S(own)) - S(track.decay[k] * own);
            for (int i = 0; i < kMoved; ++i)
                p[i][c] = p[c][i] = half[i][c] * decay;
            for (int j = kMoved; j < kFilter; ++j)
                p[c][j] = p[c][j] * decay * decay;
        }
    }

    /* As P is symmetric, F P F' = F (F P)': row by row, without the many zeros of F. It stays
     * symmetric to the last digit: no measurement takes back what differs, and it may grow. */
    template <int kMemory>
    static void carry_covariance_with(const double *transition, double *p) {
        constexpr int kFilter = kStates + kMemory + kPushes;
        constexpr int kWide = (kFilter + kLanes - 1) / kLanes;
        alignas(64) double from[kFilter][kWide * kLanes] = {}, turned[kFilter][kWide * kLanes] = {};
        const auto times = [transition](int i, const double(&rows)[kFilter][kWide * kLanes],
                                        double *product) {
            S sum[kWide];
            std::fill_n(sum, kWide, S(0.0));
            for (int l = 0; l < kFilter; ++l) {
                const double f = transition[i * kFilter + l];
                if (f == 0.0)
                    continue;
                for (int v = 0; v < kWide; ++v)
                    sum[v] += S(f) * S::load_aligned(rows[l] + v * kLanes);
            }
            for (int v = 0; v < kWide; ++v)
                sum[v].store_aligned(product + v * kLanes);
        };
        alignas(64) double row[kWide * kLanes];
        for (int i = 0; i < kFilter; ++i)
            std::copy_n(p + i * kFilter, kFilter, from[i]);
        for (int i = 0; i < kFilter; ++i) {
            times(i, from, row);
            for (int j = 0; j < kFilter; ++j)
                turned[j][i] = row[j];
        }
        for (int i = 0; i < kFilter; ++i) {
            times(i, turned, row);
            for (int j = i; j < kFilter; ++j)
                p[i * kFilter + j] = p[j * kFilter + i] = row[j];
        }
    }

    static constexpr double kProbe = 1e-5;

    /* Lane 0 of x [kAll] holds the state, lane j + 1 that with component moved[first + j] off by
     * the probe. */
    static void seed(const double *state, const std::vector<int> &moved, int first, S *x) {
        broadcast(state, x, kAll);
        const int n = static_cast<int>(moved.size());
        alignas(64) double spread[kLanes];
        for (int j = 1; j < kLanes && first + j - 1 < n; ++j) {
            const int place = moved[first + j - 1];
            std::fill_n(spread, kLanes, state[place]);
            spread[j] += kProbe;
            x[place] = S::load_aligned(spread);
        }
    }
};

}  // namespace

#define OMNISLIP_JOIN2(a, b) a##b
#define OMNISLIP_JOIN(a, b) OMNISLIP_JOIN2(a, b)

Kernel *OMNISLIP_JOIN(make_kernel_, OMNISLIP_ARCH)(int kind, const UserTermList &terms) {
    using Arch = xsimd::OMNISLIP_ARCH;
    if (kind == kRobotEngine)
        return new KernelOf<RobotPlant, Arch, 0>(terms);
    if (kind == kElectricRobotEngine)
        return new KernelOf<RobotPlant, Arch, 1 + RobotLayout::kMotors>(terms);
    if (kind == kOdometryEngine)
        return new KernelOf<OdometryPlant, Arch, 0>(terms);
    return new KernelOf<AxisPlant, Arch, 0>(terms);
}

}  // namespace omnislip
