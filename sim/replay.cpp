#include "replay.h"

#include <Eigen/Dense>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <numeric>
#include <stdexcept>
#include <thread>

#include "robot_plant.h"

namespace omnislip {

double change_into(const Recording &recording, int motors, int k, int motor) {
    const std::size_t place = static_cast<std::size_t>(k) * static_cast<std::size_t>(motors) +
                              static_cast<std::size_t>(motor);
    return k > 0 && k < recording.rows
               ? recording.command[place] -
                     recording.command[place - static_cast<std::size_t>(motors)]
               : 0.0;
}

double squared_change(const Recording &recording, int motors, int k, int motor) {
    const double into = change_into(recording, motors, k, motor);
    const double out = change_into(recording, motors, k + 1, motor);
    return 0.5 * (into * into + out * out);
}

double squared_step(const Recording &recording, int motors, int k, int motor) {
    const double into = change_into(recording, motors, k, motor);
    const double before = into - change_into(recording, motors, k - 1, motor);
    const double behind = change_into(recording, motors, k + 1, motor) - into;
    return 0.5 * (into * into + before * before + behind * behind);
}

namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Vector = Eigen::VectorXd;

/* h P h' of a row h of `slope`, most of which is 0. */
double variance_along(const Matrix &slope, int row, const Matrix &p) {
    double sum = 0.0;
    for (int i = 0; i < p.rows(); ++i) {
        for (int j = 0; slope(row, i) != 0.0 && j < p.cols(); ++j)
            sum += slope(row, i) * p(i, j) * slope(row, j);
    }
    return sum;
}

/* Pairs of outputs that were sampled together, each with itself too, over all rows. */
std::size_t sampled_pairs(const Track &track, int outputs) {
    std::size_t pairs = 0;
    for (auto row = track.innovation.begin(); row != track.innovation.end(); row += outputs) {
        const auto sampled =
            std::count_if(row, row + outputs, [](double shown) { return !std::isnan(shown); });
        pairs += static_cast<std::size_t>(sampled * (sampled + 1) / 2);
    }
    return pairs;
}

std::atomic<int> most_threads{std::max(1, static_cast<int>(std::thread::hardware_concurrency()))};

/* Runs `work(task)` for task = 0..count-1 on all cores; `work` must not throw. */
void in_parallel(int count, const std::function<void(int)> &work) {
    std::atomic<int> next{0};
    const auto worker = [&] {
        for (int task = next++; task < count; task = next++)
            work(task);
    };
    const int threads = std::min<int>(count, most_threads);
    std::vector<std::thread> pool;
    for (int i = 1; i < threads; ++i)
        pool.emplace_back(worker);
    worker();
    for (std::thread &thread : pool)
        thread.join();
}

/* One task = one recording and one lane group of parameter sets. */
template <class Work>
void for_each_group(const Kernel &kernel, int recordings, const ParameterSets &sets, Work &&work) {
    const int groups = (sets.count + kernel.lanes() - 1) / kernel.lanes();
    in_parallel(recordings * groups, [&](int task) {
        const int first = (task % groups) * kernel.lanes();
        const int count = std::min(kernel.lanes(), sets.count - first);
        work(task / groups, first, count, sets.values + static_cast<long>(first) * sets.size);
    });
}

}  // namespace

Track track(const Kernel &kernel, const Recording &recording, const double *values,
            const Noise &noise, double step_s, double floor_window_s, bool keep_linear) {
    const std::size_t rows = static_cast<std::size_t>(recording.rows);
    const std::shared_ptr<const void> loaded = kernel.load(values);
    Track result;
    result.memory = kernel.filtered_memory(loaded.get());
    const int of_plant = kernel.states();
    const int n = of_plant + static_cast<int>(result.memory.size()), m = kernel.outputs(),
              q = kernel.pushes(), all = n + q;
    result.gain.assign(rows * all * m, 0.0);
    result.whitening.assign(rows * m * m, 0.0);
    result.state.assign(rows * all, 0.0);
    result.innovation.assign(rows * m, NAN);
    result.correction_variance.assign(rows * all, 0.0);
    const bool with_floor = floor_window_s > 0.0;
    if (with_floor)
        result.replay_variance.assign(rows * m, 0.0);
    result.push.assign(rows * n * q, 0.0);
    result.decay.assign(rows, 0.0);
    result.pushed = kernel.pushed(loaded.get(), result.memory);
    const Matrix pushed = Eigen::Map<const Matrix>(result.pushed.data(), n, q);
    if (keep_linear) {
        result.transition.assign(rows * all * all, 0.0);
        result.slope.assign(rows * m * all, 0.0);
    }
    Vector process = Vector::Zero(n), initial = Vector::Zero(n);
    std::copy(noise.process.begin(), noise.process.end(), process.data());
    const double *begun = recording.begun_variance.data(); /* of states, then disturbances */
    const double *known = recording.begins() ? begun : noise.initial.data();
    std::copy_n(known, of_plant, initial.data());
    std::vector<int> moved(static_cast<std::size_t>(n)); /* places in x */
    std::iota(moved.begin(), moved.end(), 0);
    std::copy(result.memory.begin(), result.memory.end(), moved.begin() + of_plant);
    Matrix lasting = Matrix::Zero(q, q);
    std::copy(noise.coloured.begin(), noise.coloured.end(), lasting.data());
    const int motors = kernel.motors();
    Vector variance = Eigen::Map<const Vector>(noise.output.data(), m);
    Vector x = Vector::Zero(kernel.states_and_memory()), next(x.size());
    x.head(of_plant) = Eigen::Map<const Vector>(recording.initial_state.data(), of_plant);
    kernel.settle(loaded.get(), recording, x.data());
    Vector estimate = Vector::Zero(all);
    estimate.head(n) = x(moved);
    Matrix p = Matrix::Zero(all, all);
    p.diagonal().head(n) = initial;
    p.bottomRightCorner(q, q) = lasting;
    if (recording.begins())
        p.bottomRightCorner(q, q).diagonal() += Eigen::Map<const Vector>(begun + of_plant, q);
    Matrix free = p; /* covariance of a replay that runs since its last restart */
    double restart_s = recording.time_s[0] + recording.settle_s;
    Matrix moves(n, n), shown(m, n), push(n, q), grown(n, n);
    Matrix transition = Matrix::Zero(all, all), slope = Matrix::Zero(m, all);
    Vector predicted(m), mistiming = Vector::Zero(m);
    std::vector<double> gone(kernel.shows_late(loaded.get()) ? 3 * rows : 0, 0.0);
    for (std::size_t k = 0; k < rows; ++k) {
        const double *measured = &recording.output[k * m];
        kernel.linearise_output(loaded.get(), recording, static_cast<int>(k), moved,
                                gone.empty() ? nullptr : gone.data(), x.data(), predicted.data(),
                                shown.data());
        slope.leftCols(n) = shown;
        if (keep_linear)
            std::copy(slope.data(), slope.data() + m * all, &result.slope[k * m * all]);
        for (int i = m - kernel.current_outputs(), motor = 0; i < m; ++i, ++motor) {
            variance[i] = noise.output[static_cast<std::size_t>(i)] +
                          0.25 * noise.unresolved_current *
                              squared_step(recording, motors, static_cast<int>(k), motor);
        }
        for (int j = 0; j < m; ++j)
            result.innovation[k * m + j] = measured[j] - predicted[j];
        for (int j = 0; with_floor && j < m; ++j) {
            result.replay_variance[k * m + j] = variance[j] + variance_along(slope, j, free);
        }
        result.log_likelihood +=
            kernel.correct_by(&result.innovation[k * m], slope.data(), variance.data(),
                              mistiming.data(), recording.most_counted(static_cast<int>(k)), all,
                              estimate.data(), p.data(), &result.gain[k * all * m],
                              &result.whitening[k * m * m], &result.correction_variance[k * all]);
        std::copy_n(estimate.data(), all, &result.state[k * all]);
        x(moved) = estimate.head(n);
        if (with_floor && recording.time_s[k] >= restart_s) {
            free = p; /* it starts where the filter is, but follows no disturbance */
            free.rightCols(q).setZero();
            free.bottomRows(q).setZero();
            free.bottomRightCorner(q, q) = lasting;
            restart_s += floor_window_s;
        }
        if (k + 1 == rows)
            break;
        const double duration_s = recording.time_s[k + 1] - recording.time_s[k];
        kernel.linearise(loaded.get(), recording, static_cast<int>(k), step_s, moved, x.data(),
                         next.data(), moves.data());
        push = 0.5 * duration_s * (moves * pushed + pushed);
        const double decay = std::exp(-duration_s * noise.colour_rate_1_s);
        transition.topLeftCorner(n, n) = moves;
        transition.topRightCorner(n, q) = push;
        transition.bottomRightCorner(q, q).diagonal().setConstant(decay);
        next(moved) += push * estimate.tail(q);
        mistiming = shown * (next - x)(moved) * (std::sqrt(noise.timing_s2) / duration_s);
        for (std::size_t c = 0; c < 3 && !gone.empty(); ++c) {
            const long place = RobotLayout::kPose + static_cast<long>(c);
            gone[3 * (k + 1) + c] = gone[3 * k + c] + (next[place] - x[place]);
        }
        x = next;
        estimate.head(n) = x(moved);
        estimate.tail(q) *= decay;
        std::copy(push.data(), push.data() + n * q, &result.push[k * n * q]);
        result.decay[k] = decay;
        if (keep_linear)
            std::copy(transition.data(), transition.data() + all * all,
                      &result.transition[k * all * all]);
        grown = (process * duration_s).asDiagonal();
        if (q > 0)
            grown.topLeftCorner(motors, motors).setZero();
        for (int i = 0; q > 0 && i < motors; ++i) {
            const Vector kick = pushed.col(i);
            grown += process[i] * duration_s * (kick * kick.transpose());
            const int row = static_cast<int>(k);
            const double lost = recording.untold_in(k) * change_into(recording, motors, row + 1, i);
            const Vector end = duration_s * pushed.col(i);
            const Vector begin = 2.0 * push.col(i) - end, late = (end - begin) / 12.0;
            grown += 0.5 * lost * lost * (begin * begin.transpose() + end * end.transpose()) +
                     noise.unresolved * squared_change(recording, motors, row, i) * late *
                         late.transpose();
        }
        const auto carry = [&](Matrix &covariance) {
            kernel.carry_covariance(transition.data(), all, covariance.data());
            covariance.topLeftCorner(n, n) += grown;
            covariance.bottomRightCorner(q, q) += (1.0 - decay * decay) * lasting;
        };
        carry(p);
        if (with_floor)
            carry(free);
    }
    return result;
}

void limit_threads(int count) {
    most_threads = count;
}

int thread_limit() {
    return most_threads;
}

std::vector<Track> track_all(const Kernel &kernel, const std::vector<const Recording *> &recordings,
                             const double *values, const Noise &noise, double step_s,
                             double floor_window_s, bool keep_linear) {
    std::vector<Track> tracks(recordings.size());
    in_parallel(static_cast<int>(recordings.size()), [&](int i) {
        const std::size_t r = static_cast<std::size_t>(i);
        tracks[r] =
            track(kernel, *recordings[r], values, noise, step_s, floor_window_s, keep_linear);
    });
    return tracks;
}

void innovations(const Kernel &kernel, const std::vector<const Recording *> &recordings,
                 const std::vector<const Track *> &tracks, const ParameterSets &sets, double step_s,
                 double least_rate_1_s, const std::vector<Residuals> &residuals,
                 const std::vector<int> &place) {
    for_each_group(kernel, static_cast<int>(recordings.size()), sets,
                   [&](int r, int first, int count, const double *values) {
                       const Residuals &own = residuals[r];
                       std::vector<double *> of_set(static_cast<std::size_t>(count));
                       for (int s = 0; s < count; ++s)
                           of_set[s] = own.begin + place[first + s] * own.stride;
                       kernel.innovations(*recordings[r], *tracks[r], values, count, step_s,
                                          least_rate_1_s, own.first_row, of_set.data());
                   });
}

void replays(const Kernel &kernel, const std::vector<const Recording *> &recordings,
             const std::vector<const Track *> &tracks, const ParameterSets &sets, double step_s,
             double window_s, const std::vector<double *> &errors) {
    for_each_group(kernel, static_cast<int>(recordings.size()), sets,
                   [&](int r, int first, int count, const double *values) {
                       const long plane = static_cast<long>(recordings[r]->rows) * kernel.outputs();
                       kernel.replays(*recordings[r], *tracks[r], values, count, step_s, window_s,
                                      errors[r] + first * plane);
                   });
}

void respond(const Kernel &kernel, const Recording &recording, const Track &track,
             const double *push, const double *shown, int columns, double *response) {
    const int lanes = kernel.lanes();
    in_parallel((columns + lanes - 1) / lanes, [&](int group) {
        kernel.respond(recording, track, push, shown, columns, group * lanes, response);
    });
}

void likelihoods(const Kernel &kernel, const std::vector<const Recording *> &recordings,
                 const std::vector<const Track *> &tracks, const std::vector<Noise> &noises,
                 double *log_likelihood, double *information) {
    const int count = static_cast<int>(noises.size()), lanes = kernel.lanes();
    const int groups = (count + lanes - 1) / lanes, all = static_cast<int>(recordings.size());
    const int width = groups * lanes;
    const std::size_t square = static_cast<std::size_t>(width) * static_cast<std::size_t>(width);
    std::vector<double> of_run(recordings.size() * noises.size(), 0.0);
    std::vector<std::unique_ptr<double[]>> covariance(recordings.size());
    std::vector<double> told(information ? recordings.size() * square : 0, 0.0);
    for (std::size_t r = 0; information && r < covariance.size(); ++r) {
        /* Left as it comes: all that is read was written. */
        covariance[r].reset(new double[sampled_pairs(*tracks[r], kernel.outputs()) *
                                       static_cast<std::size_t>(width)]);
    }
    in_parallel(all * groups, [&](int task) {
        const std::size_t r = static_cast<std::size_t>(task / groups);
        const int first = (task % groups) * lanes;
        kernel.likelihoods(*recordings[r], *tracks[r], &noises[static_cast<std::size_t>(first)],
                           std::min(lanes, count - first),
                           &of_run[r * noises.size() + static_cast<std::size_t>(first)],
                           information ? covariance[r].get() + first : nullptr, width);
    });
    for (std::size_t i = 0; i < of_run.size(); ++i)
        log_likelihood[i % noises.size()] += of_run[i];
    if (!information)
        return;
    in_parallel(all, [&](int task) {
        const std::size_t r = static_cast<std::size_t>(task);
        kernel.add_information(*tracks[r], recordings[r]->rows, covariance[r].get(), width,
                               &told[r * square]);
    });
    for (std::size_t i = 0; i < noises.size(); ++i) {
        for (std::size_t j = 0; j < noises.size(); ++j) {
            double &sum = information[i * noises.size() + j];
            sum = 0.0;
            for (std::size_t r = 0; r < recordings.size(); ++r)
                sum += told[r * square + i * static_cast<std::size_t>(width) + j];
        }
    }
}

}  // namespace omnislip
