/* replay.h - recorded commands driven through the model: predictor, innovations, replays.
 *
 * A recording is one run: times, the command from each row to the next, and what the sensors showed
 * (NaN = not sampled in that row). Five computations over it:
 *
 *   track        an extended Kalman filter of one model. It gives, row by row, the gain K_k and the
 *                factor W_k with W_k S_k W_k' = I, S_k the covariance of the innovation; also the
 *                variance that the noise alone gives to a replay: its noise floor.
 *   likelihoods  the filter with other noises, linear along the path of a track that kept its
 *                matrices: exact in the variances, to first order in how they move the path. Serves
 *                to fit the noise, at a tenth of the cost of a track.
 *   innovations  the filter for many parameter sets with K_k and W_k frozen: prediction errors
 *                whitened by W_k. Frozen gains make the residual a smooth function of the
 *                parameters and lose no information: for any gain the innovations are an
 *                invertible function of the measurements.
 *   respond      what pushes that are known as functions of time change of these innovations.
 *   replays      free-running simulation, restarted from the filtered state every `window_s`:
 *                measured minus simulated, the error a user of the simulator sees.
 *
 * What pushes a robot at random - seams, chatter of rollers - lasts for some milliseconds, longer
 * than a row. A controller answers it in the rows that follow, so that the command goes along with
 * the disturbance; a filter that takes every row's push for a new one then sees commands work late
 * and feigns lags. The state of the filter therefore holds, after the states of the plant, the
 * disturbance d_i of each pushed state's rate, of first order: d_(k+1) = exp(-rate T) d_k + noise.
 * Over a row it moves the state by push_k d_k, push_k = T / 2 (pushed + transition_k pushed).
 *
 * A model with memory (memory.h) carries it from row to row. What bristles hold pulls at wheels and
 * body for longer than a row and depends on how they moved, and so does the twist of a shaft that
 * is a spring: there the filter corrects the memory as well, else its corrections of speeds shake
 * what it does not see. (Those of a motor then moved its wheel, too. A shaft of damping ratio 0.12
 * swung without end beside its own logs and passed for one of twice the damping; with its twist
 * corrected these were likelier by exp(17,600).) Not beside play, whose kinks no slope describes.
 * The state of the filter is the plant's, such memory, and the disturbances. What pushes a motor on
 * a spring leaves its wheel as fast as it was: pushed = speed - slack / n.
 *
 * Parameter sets (noises) run in SIMD lanes and on all cores. Layouts are row major:
 * command [row][motor], output [row][output], gain [row][filter state][output],
 * whitening [row][output][output], residuals [set][row][output].
 */
#ifndef OMNISLIP_SIM_REPLAY_H
#define OMNISLIP_SIM_REPLAY_H

#include <limits>
#include <memory>
#include <vector>

#include "user_terms.h"

namespace omnislip {

/* Replays start this long after the first row unless a recording says otherwise: until then the
 * filter finds the initial state. */
constexpr double kSettleTime_s = 0.25;
/* What a row's squared whitened innovations count at most in a likelihood before that: what nothing
 * tells of the beginning, as where in its play a gear is, is no noise (some 10 are chance's). */
constexpr double kMostOfUnsettled = 100.0;
/* Room for a parameter set, terms of the user included. */
constexpr int kMaxParameters = 800;

struct Recording {
    int rows = 0;
    std::vector<double> time_s, command, output;
    std::vector<double> initial_state;
    double settle_s = kSettleTime_s;
    std::vector<double> rise{}; /* of the command within the row, around its mean; empty: held */
    /* Share of the command of the row before in what electric sensors show: 0 if they are read when
     * that of their own row has begun, 1 if before, and between where nothing tells. */
    double read_before = 0.0;
    /* Of a robot that stood until the first command began: variances of the initial state, then
     * what those of the disturbances have more [filter state without memory]. Empty: as the noise
     * says, behind a first command that has lasted for long. */
    std::vector<double> begun_variance{};
    /* What warmed the motors before the first row: lengths of rows, and squares of the currents
     * that cold windings would have let through [row][motor]. */
    std::vector<double> past_s{}, past_current_a2{};
    /* [row] Of rows behind which others are missing: a motor's rate per command, times the share of
     * the row of which nothing tells the command. It may be the mean's or the next row's, of which
     * it is c off. A motor pushed early in the row passes it on to what it drives, F e with F the
     * transition, later keeps it, e: both are free, each with a variance of (untold c T)^2 / 2,
     * no less than that of what lasts for the row. Empty: none is missing. */
    std::vector<double> untold{};

    /* Of the squared whitened innovations of a row, in a likelihood. */
    double most_counted(int row) const {
        const std::size_t k = static_cast<std::size_t>(row);
        const bool settled = time_s[k] >= time_s[0] + settle_s;
        return settled ? std::numeric_limits<double>::infinity() : kMostOfUnsettled;
    }
    bool begins() const {
        return !begun_variance.empty();
    }
    double untold_in(std::size_t row) const {
        return untold.empty() ? 0.0 : untold[row];
    }
};

/* Noise of the filter: variances per second added to each state, variances of the outputs, the
 * lasting covariance of the disturbances (empty: none) and the rate at which they decay, the
 * variance of the rows' times [s^2]: a row taken d late shows every output d times its rate off,
 * and what a row's mean command does not tell. A controller that is faster than the log moves the
 * command within a row. Going evenly from the one neighbour's command to the other's, with a change
 * c it moves the state at the end of a row of length T by a c T (e - F e) / 12 (Simpson's rule), a
 * the motor's acceleration per command, e its own state, F the transition: a motor that nothing
 * holds is as fast as by the mean, but a c T^2 / 12 less far; one that a contact holds within the
 * row ends where its command does. Variance unresolved c^2 along that, unresolved = a^2 if the
 * whole change happens so, 0 if the command is held. Likewise the current at the row's begin is b c
 * / 2 off, b the current per command at rest, where the command makes a step of c: variance
 * unresolved_current c^2 / 4 of a logged current. Of a command that moves evenly less is open than
 * of one that steps and is as even before and behind (ten sets of logs with currents are likelier
 * by 66 to 5,700 than with the mean square of the changes of the rows beside). */
struct Noise {
    std::vector<double> process, output, initial;
    double timing_s2 = 0.0;
    double unresolved = 0.0;
    double unresolved_current = 0.0;
    std::vector<double> coloured{}; /* [disturbance][disturbance], of rates of pushed states */
    double colour_rate_1_s = 100.0;
};

struct Track {
    std::vector<int> memory; /* that the filter corrects: its places behind the states */
    std::vector<double> gain, whitening;
    std::vector<double> state;               /* [row][filter state] after the measurements */
    std::vector<double> innovation;          /* [row][output], NaN where not sampled */
    std::vector<double> correction_variance; /* [row][filter state], of gain * innovation */
    std::vector<double> replay_variance; /* [row][output] expected of a replay's error, if asked */
    std::vector<double> pushed;          /* [state or memory][disturbance] what it is the rate of */
    std::vector<double> push;            /* [row][state or memory][disturbance] to the next row */
    std::vector<double> decay;           /* [row] of the disturbances to the next row */
    std::vector<double> transition;      /* [row][filter state][filter state], if kept */
    std::vector<double> slope;           /* [row][output][filter state], if kept */
    double log_likelihood = 0.0;
};

struct ParameterSets {
    const double *values = nullptr; /* [count][size] */
    int count = 0;
    int size = 0;
};

/* Change of a motor's command into row k, its mean square into and out of row k, and what makes a
 * step of it where row k begins: half of its square and of those of its differences from the
 * changes before and behind. */
double change_into(const Recording &recording, int motors, int k, int motor);
double squared_change(const Recording &recording, int motors, int k, int motor);
double squared_step(const Recording &recording, int motors, int k, int motor);

/* Parts that are compiled once per instruction set. */
class Kernel {
  public:
    virtual ~Kernel() = default;
    virtual int lanes() const = 0;
    virtual int states() const = 0;
    virtual int states_and_memory() const = 0;
    /* Disturbances. The filter has states(), the memory that it corrects, and pushes(). */
    virtual int pushes() const = 0;
    virtual int outputs() const = 0;
    virtual int motors() const = 0;
    /* How many of the outputs are motor currents; they come last. */
    virtual int current_outputs() const = 0;
    virtual int parameters() const = 0;
    virtual const char *instruction_set() const = 0;
    /* Fastest rate [1/s] of the first `count` <= lanes() sets; the steps are chosen from it. */
    virtual double fastest_rate_1_s(const double *values, int count) const = 0;
    /* One parameter set, made ready for the three functions below. */
    virtual std::shared_ptr<const void> load(const double *values) const = 0;
    /* Fills the memory behind the states: as if the first row had lasted for long. */
    virtual void settle(const void *loaded, const Recording &recording, double *state) const = 0;
    /* Places of the memory that the filter corrects. */
    virtual std::vector<int> filtered_memory(const void *loaded) const = 0;
    /* What each disturbance is the rate of [state or memory][disturbance]: one state, of a motor
     * on a spring also the slack, for its wheel goes on as it was. */
    virtual std::vector<double> pushed(const void *loaded,
                                       const std::vector<int> &memory) const = 0;
    /* From row `row` to the next: next [states_and_memory], transition [moved][moved]. `moved` are
     * the places of states and filtered memory. */
    virtual void linearise(const void *loaded, const Recording &recording, int row, double step_s,
                           const std::vector<int> &moved, const double *state, double *next,
                           double *transition) const = 0;
    /* Whether the camera shows the pose of another moment than the row's: then the way gone up to
     * each row is wanted. */
    virtual bool shows_late(const void *loaded) const = 0;
    /* In row `row`, state [states_and_memory]: output [outputs], slope [outputs][moved]. `gone`
     * [row][3]: the way of a robot up to each row (memory.h), or null. */
    virtual void linearise_output(const void *loaded, const Recording &recording, int row,
                                  const std::vector<int> &moved, const double *gone,
                                  const double *state, double *output, double *slope) const = 0;
    /* A covariance P [filter_states][filter_states] from one row to the next: F P F', F the
     * transition with the disturbances. */
    virtual void carry_covariance(const double *transition, int filter_states, double *p) const = 0;
    /* Kalman filter of one row: innovation [outputs], NaN where nothing was sampled, slope
     * [outputs][filter_states], variance and mistiming `late` [outputs]. Moves the estimate and P,
     * fills gain [filter_states][outputs], whitening [outputs][outputs] and what the estimate is
     * corrected by [filter_states], all 0 before. Returns the log likelihood, in which squares of
     * whitened innovations count `most`. */
    virtual double correct_by(const double *innovation, const double *slope, const double *variance,
                              const double *late, double most, int filter_states, double *estimate,
                              double *p, double *gain, double *whitening,
                              double *correction_variance) const = 0;
    /* Derivatives of the states of one set at many points: states [points][states], commands
     * [points][motors], derivative [points][states]; time 0, memory settled. */
    virtual void derivatives(const void *loaded, int points, const double *states,
                             const double *commands, double *derivative) const = 0;
    /* First `count` <= lanes() sets from `values` on; residuals[set] takes [row][output] from
     * `first_row` on. Sets that are no faster than least_rate_1_s take the same steps, so that
     * their difference is smooth. */
    virtual void innovations(const Recording &recording, const Track &track, const double *values,
                             int count, double step_s, double least_rate_1_s, int first_row,
                             double *const *residuals) const = 0;
    virtual void replays(const Recording &recording, const Track &track, const double *values,
                         int count, double step_s, double window_s, double *errors) const = 0;
    /* Columns `first` to `first` + lanes() - 1 of the response of `respond` below. */
    virtual void respond(const Recording &recording, const Track &track, const double *push,
                         const double *shown, int columns, int first, double *response) const = 0;
    /* `count` <= lanes() noises along a track with its matrices: log_likelihood [noise] is added
     * to. Unless `covariance` is null, that of the innovations is written: row by row the lower
     * triangle over the outputs that were sampled, [row][pair][width], of lanes() noises each. */
    virtual void likelihoods(const Recording &recording, const Track &track, const Noise *noises,
                             int count, double *log_likelihood, double *covariance,
                             int width) const = 0;
    /* From these: what the noises' changes from the first one tell together, added to information
     * [width][width] (see `likelihoods` below). */
    virtual void add_information(const Track &track, int rows, const double *covariance, int width,
                                 double *information) const = 0;
};

/* The electric robot shows bus voltage and four motor currents after the outputs of the robot. */
enum EngineKind { kRobotEngine, kAxisEngine, kElectricRobotEngine, kOdometryEngine };

/* Best kernel for this processor. `widest_lanes` bounds the width.
 * The terms must outlive the kernel. */
std::unique_ptr<Kernel> make_kernel(int kind, int widest_lanes, const UserTermList &terms = {});

Track track(const Kernel &kernel, const Recording &recording, const double *values,
            const Noise &noise, double step_s, double floor_window_s, bool keep_linear);

/* The functions below start at most `count` >= 1 threads from now on; without it one per core. */
void limit_threads(int count);
int thread_limit();

/* One filter per recording, on all cores. The variance of replays is of such that start again every
 * floor_window_s; 0: it is not wanted. */
std::vector<Track> track_all(const Kernel &kernel, const std::vector<const Recording *> &recordings,
                             const double *values, const Noise &noise, double step_s,
                             double floor_window_s, bool keep_linear);

/* Where the residuals of a recording go: those of set i to begin + place[i] * stride, [row][output]
 * from `first_row` on. */
struct Residuals {
    double *begin = nullptr;
    long stride = 0;
    int first_row = 0;
};

/* All recordings, all sets; `place` [sets]. */
void innovations(const Kernel &kernel, const std::vector<const Recording *> &recordings,
                 const std::vector<const Track *> &tracks, const ParameterSets &sets, double step_s,
                 double least_rate_1_s, const std::vector<Residuals> &residuals,
                 const std::vector<int> &place);
/* All recordings, all sets: errors[r] holds [set][row][output] of recording r. */
void replays(const Kernel &kernel, const std::vector<const Recording *> &recordings,
             const std::vector<const Track *> &tracks, const ParameterSets &sets, double step_s,
             double window_s, const std::vector<double *> &errors);

/* What pushes change of the whitened innovations, response [row][output][column]; `track` kept its
 * matrices. `push` [row][filter state][column] are rates from each row to the next, what is pushed
 * of the memory along with a motor (Track::pushed) understood; `shown` [row][output][column] is
 * what sensors show besides. With the transition F, output slope H and gain K of the track, the
 * error d of the prediction, 0 at first, obeys
 *     e_k = shown_k - H_k d_k,   d_(k+1) = F_k (d_k + K_k e_k + push_k T / 2) + push_k T / 2. */
void respond(const Kernel &kernel, const Recording &recording, const Track &track,
             const double *push, const double *shown, int columns, double *response);

/* All recordings, all noises: log_likelihood [noise], zero before. Unless `information` is null, it
 * is filled [noise][noise]: with S_0 = L L' the covariance of a row by the first noise and A_i =
 * L^-1 (S_i - S_0) L^-T what noise i changes of it, the sum over the rows of tr(A_i A_j) / 2. */
void likelihoods(const Kernel &kernel, const std::vector<const Recording *> &recordings,
                 const std::vector<const Track *> &tracks, const std::vector<Noise> &noises,
                 double *log_likelihood, double *information);

}  // namespace omnislip

#endif
