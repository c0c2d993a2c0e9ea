/* binding.cpp - Python module omnislip._core: catalogue, replay engine, firmware in the loop. */
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/list.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <map>
#include <numeric>
#include <stdexcept>
#include <string>

#if defined(__GLIBC__)
#include <malloc.h>
#endif

#include "axis_plant.h"
#include "binding.h"
#include "closed_loop.h"
#include "integrator.h"
#include "odometry_plant.h"
#include "replay.h"
#include "robot_plant.h"
#include "speed.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace omnislip {
namespace {

using Array1 = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Array2 = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Array3 = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Written2 = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

/* Hands a buffer over to numpy. */
nb::object to_numpy(std::vector<double> &&data, const std::vector<std::size_t> &shape) {
    auto *owned = new std::vector<double>(std::move(data));
    nb::capsule owner(owned,
                      [](void *p) noexcept { delete static_cast<std::vector<double> *>(p); });
    return nb::cast(
        nb::ndarray<nb::numpy, double>(owned->data(), shape.size(), shape.data(), owner));
}

nb::object copy_to_numpy(const std::vector<double> &data) {
    return to_numpy(std::vector<double>(data), {data.size()});
}

std::vector<double> to_vector(const Array1 &array) {
    return std::vector<double>(array.data(), array.data() + array.shape(0));
}

void require(bool holds, const char *message) {
    if (!holds)
        throw std::invalid_argument(message);
}

const char *scope_name(Scope scope) {
    switch (scope) {
        case Scope::kWhole:
            return "whole";
        case Scope::kCommon:
            return "common";
        case Scope::kSingle:
            return "single";
        default:
            return "common or single";
    }
}

nb::list parameter_list(const EffectInfo &info) {
    nb::list parameters;
    for (int k = 0; k < info.parameter_count; ++k) {
        const ParameterInfo &p = info.parameters[k];
        nb::dict entry;
        entry["name"] = p.name;
        entry["unit"] = p.unit;
        entry["neutral"] = p.neutral;
        entry["low"] = p.low;
        entry["high"] = p.high;
        entry["typical"] = p.typical;
        parameters.append(entry);
    }
    return parameters;
}

nb::list effects() {
    nb::list catalogue;
    for_each_effect(1, [&](auto effect, int, int) {
        constexpr EffectInfo info = decltype(effect)::info;
        nb::dict entry;
        entry["name"] = info.name;
        entry["summary"] = info.summary;
        entry["equation"] = info.equation;
        entry["where"] = info.where;
        entry["source"] = info.source;
        entry["scope"] = scope_name(info.scope);
        entry["per_wheel"] = info.scope != Scope::kWhole;
        nb::list kinds;
        if (info.kinds & kRobot)
            kinds.append("robot");
        if (info.kinds & kAxis)
            kinds.append("axis");
        if (info.kinds & kOdometry)
            kinds.append("odometry");
        entry["kinds"] = kinds;
        nb::list goes_with;
        if (info.hooks & kByAngle)
            goes_with.append("angle");
        if (info.hooks & kByPlace)
            goes_with.append("place");
        entry["goes_with"] = goes_with;
        entry["parameters"] = parameter_list(info);
        catalogue.append(entry);
    });
    return catalogue;
}

template <int Count>
nb::list base_list(const BaseParameter (&base)[Count]) {
    nb::list parameters;
    for (const BaseParameter &p : base) {
        nb::dict entry;
        entry["name"] = p.name;
        entry["unit"] = p.unit;
        entry["default"] = p.value;
        parameters.append(entry);
    }
    return parameters;
}

EngineKind engine_kind(const std::string &kind) {
    const std::map<std::string, EngineKind> kinds = {
        {"robot", kRobotEngine}, {"axis", kAxisEngine}, {"odometry", kOdometryEngine}};
    const auto found = kinds.find(kind);
    require(found != kinds.end(), "kind must be 'robot', 'axis' or 'odometry'");
    return found->second;
}

nb::list base_parameters(const std::string &kind) {
    const EngineKind number = engine_kind(kind);
    return number == kRobotEngine  ? base_list(kRobotBase)
           : number == kAxisEngine ? base_list(kAxisBase)
                                   : base_list(kOdometryBase);
}

/* ------------------------------------------------------------------ effects of the user */

template <std::size_t Count>
int index_of(const char *const (&names)[Count], const std::string &name) {
    for (std::size_t i = 0; i < Count; ++i) {
        if (name == names[i])
            return static_cast<int>(i);
    }
    throw std::invalid_argument("unknown name '" + name + "' in a user's effect");
}

/* Checks that the program keeps within the stack and ends with one value on it. */
void check_program(const UserTerm &term) {
    int depth = 0, deepest = 0;
    for (const UserInstruction &step : term.program) {
        const bool pushes = step.operation <= UserOperation::kInput;
        const bool one = !pushes && step.operation < UserOperation::kAdd;
        const int taken = pushes ? 0 : one ? 1 : step.operation == UserOperation::kWhere ? 3 : 2;
        require(depth >= taken, "a user's effect takes more values than there are");
        depth += 1 - taken;
        deepest = std::max(deepest, depth);
        if (step.operation == UserOperation::kParameter)
            require(step.argument < static_cast<int>(term.neutral.size()), "no such parameter");
    }
    require(depth == 1 && deepest <= kUserStack, "a user's effect is nested too deeply");
}

UserTerm to_user_term(const nb::dict &given, int motors) {
    UserTerm term;
    term.target =
        static_cast<UserTarget>(index_of(kUserTargets, nb::cast<std::string>(given["adds_to"])));
    term.stride = nb::cast<bool>(given["per_wheel"]) ? motors : 1;
    for (nb::handle parameter : nb::cast<nb::list>(given["parameters"]))
        term.neutral.push_back(nb::cast<double>(nb::cast<nb::dict>(parameter)["neutral"]));
    for (nb::handle item : nb::cast<nb::list>(given["program"])) {
        const nb::tuple step = nb::cast<nb::tuple>(item);
        UserInstruction instruction{};
        instruction.operation =
            static_cast<UserOperation>(index_of(kUserOperations, nb::cast<std::string>(step[0])));
        if (instruction.operation == UserOperation::kConstant) {
            instruction.constant = nb::cast<double>(step[1]);
        } else if (instruction.operation == UserOperation::kInput) {
            instruction.argument = index_of(kUserInputs, nb::cast<std::string>(step[1]));
        } else if (instruction.operation == UserOperation::kParameter ||
                   instruction.operation == UserOperation::kIntegerPower) {
            instruction.argument = nb::cast<int>(step[1]);
        }
        term.program.push_back(instruction);
    }
    check_program(term);
    return term;
}

std::vector<UserTerm> to_user_terms(const nb::list &given, int motors) {
    require(given.size() <= kMaxUserTerms, "too many effects of the user");
    std::vector<UserTerm> terms;
    for (nb::handle item : given)
        terms.push_back(to_user_term(nb::cast<nb::dict>(item), motors));
    return terms;
}

UserTermList list_of(const std::vector<UserTerm> &terms) {
    return {terms.data(), static_cast<int>(terms.size())};
}

Recording rising(const Recording &held, const Array2 &rise) {
    require(
        rise.size() == held.command.size() && rise.shape(0) == static_cast<std::size_t>(held.rows),
        "rise must have the shape of command");
    Recording r = held;
    r.rise.assign(rise.data(), rise.data() + rise.size());
    for (std::size_t k = r.rise.size() - rise.shape(1); k < r.rise.size(); ++k)
        require(r.rise[k] == 0.0, "the last row has no end to rise to");
    return r;
}

Recording warmed(const Recording &cold, const Array1 &length_s, const Array2 &cold_current_a2) {
    require(cold_current_a2.shape(0) == length_s.size() &&
                cold_current_a2.shape(1) == RobotLayout::kMotors,
            "squares of currents must be (rows, motors of a robot)");
    Recording r = cold;
    r.past_s.assign(length_s.data(), length_s.data() + length_s.size());
    r.past_current_a2.assign(cold_current_a2.data(),
                             cold_current_a2.data() + cold_current_a2.size());
    return r;
}

Recording missing(const Recording &whole, const Array1 &untold) {
    require(untold.size() == static_cast<std::size_t>(whole.rows),
            "untold must have one value for each row");
    Recording r = whole;
    r.untold = to_vector(untold);
    return r;
}

Recording reading_before(const Recording &other, double share) {
    require(share >= 0.0 && share <= 1.0, "share must be within 0..1");
    Recording r = other;
    r.read_before = share;
    return r;
}

Recording commanded(const Recording &other, const Array2 &command) {
    require(command.size() == other.command.size() &&
                command.shape(0) == static_cast<std::size_t>(other.rows),
            "command must keep its shape");
    Recording r = other;
    r.command.assign(command.data(), command.data() + command.size());
    return r;
}

class Engine {
  public:
    Engine(const std::string &kind, int widest_lanes, const nb::list &user_effects, bool electric) {
        const EngineKind number = engine_kind(kind);
        require(number == kRobotEngine || !electric, "only a robot has electric outputs");
        terms_ = to_user_terms(user_effects, number == kRobotEngine ? RobotLayout::kMotors : 1);
        kernel_ =
            make_kernel(electric ? kElectricRobotEngine : number, widest_lanes, list_of(terms_));
        require(kernel_->parameters() <= kMaxParameters, "too many parameters of user effects");
    }

    const Kernel &kernel() const {
        return *kernel_;
    }

    Recording recording(const Array1 &time_s, const Array2 &command, const Array2 &output,
                        const Array1 &initial_state, double settle_s,
                        const std::optional<Array1> &begun_variance) const {
        const auto rows = time_s.shape(0);
        require(rows >= 2 && command.shape(0) == rows && output.shape(0) == rows,
                "time_s, command and output must have the same number of rows, at least 2");
        require(command.shape(1) == static_cast<std::size_t>(kernel_->motors()) &&
                    output.shape(1) == static_cast<std::size_t>(kernel_->outputs()) &&
                    initial_state.shape(0) == static_cast<std::size_t>(kernel_->states()),
                "command, output or initial_state has the wrong number of columns");
        Recording r;
        r.rows = static_cast<int>(rows);
        r.time_s = to_vector(time_s);
        for (std::size_t k = 1; k < r.time_s.size(); ++k) {
            require(r.time_s[k] > r.time_s[k - 1], "time_s must increase from row to row");
        }
        r.command.assign(command.data(), command.data() + command.size());
        r.output.assign(output.data(), output.data() + output.size());
        require(settle_s >= 0.0, "settle_s must not be negative");
        r.initial_state = to_vector(initial_state);
        r.settle_s = settle_s;
        if (begun_variance) {
            r.begun_variance = to_vector(*begun_variance);
            require(r.begun_variance.size() == r.initial_state.size() + pushes(),
                    "begun_variance must have one value for each state and push");
        }
        return r;
    }

    std::vector<Track> tracks_of(const std::vector<const Recording *> &recordings,
                                 const Array1 &values, const Array1 &process, const Array1 &output,
                                 const Array1 &initial, double timing_s2, double unresolved,
                                 double unresolved_current, const std::vector<double> &coloured,
                                 double colour_rate_1_s, double step_s, double floor_window_s,
                                 bool keep_linear) const {
        require_rate(fastest_rate_1_s(values));
        const Noise noise{to_vector(process), to_vector(output), to_vector(initial),
                          timing_s2,          unresolved,        unresolved_current,
                          coloured,           colour_rate_1_s};
        require(noise.process.size() == static_cast<std::size_t>(kernel_->states()) &&
                    noise.initial.size() == noise.process.size() &&
                    noise.output.size() == static_cast<std::size_t>(kernel_->outputs()) &&
                    (noise.coloured.empty() || noise.coloured.size() == pushes() * pushes()),
                "noise vectors have the wrong length");
        nb::gil_scoped_release release;
        return track_all(*kernel_, recordings, values.data(), noise, step_s, floor_window_s,
                         keep_linear);
    }

    nb::list innovations_of(const std::vector<const Recording *> &recordings,
                            const std::vector<const Track *> &tracks, const Array2 &values,
                            double step_s, double least_rate_1_s) const {
        return batch(recordings, tracks, values, [&](const ParameterSets &sets, const auto &out) {
            std::vector<int> place(static_cast<std::size_t>(sets.count));
            std::iota(place.begin(), place.end(), 0);
            std::vector<Residuals> residuals;
            for (std::size_t r = 0; r < recordings.size(); ++r) {
                const long plane = static_cast<long>(recordings[r]->rows) * kernel_->outputs();
                residuals.push_back({out[r], plane, 0});
            }
            innovations(*kernel_, recordings, tracks, sets, step_s, least_rate_1_s, residuals,
                        place);
        });
    }

    void innovations_into(const std::vector<const Recording *> &recordings,
                          const std::vector<const Track *> &tracks, const Array2 &values,
                          const Written2 &residuals, const std::vector<long> &begin,
                          const std::vector<int> &first_row, const std::vector<int> &place,
                          double step_s, double least_rate_1_s) const {
        const ParameterSets sets = checked(recordings, tracks, values);
        const long width = static_cast<long>(residuals.shape(1));
        require(begin.size() == recordings.size() && first_row.size() == recordings.size() &&
                    place.size() == values.shape(0),
                "begin and first_row need one number per recording, place one per set");
        std::vector<Residuals> targets;
        for (std::size_t r = 0; r < recordings.size(); ++r) {
            const long rows = recordings[r]->rows - first_row[r];
            require(begin[r] >= 0 && first_row[r] >= 0 && rows >= 0 &&
                        begin[r] + rows * kernel_->outputs() <= width,
                    "residuals has too few columns");
            targets.push_back({residuals.data() + begin[r], width, first_row[r]});
        }
        for (const int row : place)
            require(row >= 0 && row < static_cast<long>(residuals.shape(0)),
                    "residuals has too few rows");
        nb::gil_scoped_release release;
        innovations(*kernel_, recordings, tracks, sets, step_s, least_rate_1_s, targets, place);
    }

    double fastest_rate_1_s(const Array1 &values) const {
        check_size(values.shape(0));
        return kernel_->fastest_rate_1_s(values.data(), 1);
    }

    nb::list replays_of(const std::vector<const Recording *> &recordings,
                        const std::vector<const Track *> &tracks, const Array2 &values,
                        double step_s, double window_s) const {
        return batch(recordings, tracks, values, [&](const ParameterSets &sets, const auto &out) {
            replays(*kernel_, recordings, tracks, sets, step_s, window_s, out);
        });
    }

    nb::tuple likelihoods_of(const std::vector<const Recording *> &recordings,
                             const std::vector<const Track *> &tracks, const Array2 &process,
                             const Array2 &output, const Array2 &initial, const Array1 &timing_s2,
                             const Array1 &unresolved, const Array1 &unresolved_current,
                             const Array2 &coloured, const Array1 &colour_rate_1_s,
                             bool with_information) const {
        const std::size_t sets = process.shape(0);
        const std::size_t states = static_cast<std::size_t>(kernel_->states());
        const std::size_t outputs = static_cast<std::size_t>(kernel_->outputs());
        check_tracks(recordings, tracks);
        for (const Track *track : tracks)
            require(!track->transition.empty(), "the track did not keep its matrices");
        require(process.shape(1) == states && initial.shape(1) == states &&
                    output.shape(1) == outputs && output.shape(0) == sets &&
                    initial.shape(0) == sets && timing_s2.shape(0) == sets &&
                    unresolved.shape(0) == sets && unresolved_current.shape(0) == sets &&
                    coloured.shape(0) == sets && coloured.shape(1) == pushes() * pushes() &&
                    colour_rate_1_s.shape(0) == sets,
                "noise arrays have the wrong shape");
        std::vector<Noise> noises(sets);
        for (std::size_t i = 0; i < sets; ++i) {
            const auto row = [i](const Array2 &a) {
                return std::vector<double>(a.data() + i * a.shape(1),
                                           a.data() + (i + 1) * a.shape(1));
            };
            noises[i] = {row(process),         row(output),
                         row(initial),         timing_s2.data()[i],
                         unresolved.data()[i], unresolved_current.data()[i],
                         row(coloured),        colour_rate_1_s.data()[i]};
        }
        const std::size_t told = with_information ? sets : 0;
        std::vector<double> log_likelihood(sets, 0.0), information(told * told);
        {
            nb::gil_scoped_release release;
            likelihoods(*kernel_, recordings, tracks, noises, log_likelihood.data(),
                        with_information ? information.data() : nullptr);
        }
        return nb::make_tuple(to_numpy(std::move(log_likelihood), {sets}),
                              to_numpy(std::move(information), {told, told}));
    }

    nb::object response_of(const Recording &recording, const Track &track, const Array3 &push,
                           const Array3 &shown) const {
        check_tracks({&recording}, {&track});
        require(!track.transition.empty(), "the track did not keep its matrices");
        const std::size_t rows = static_cast<std::size_t>(recording.rows);
        const std::size_t outputs = static_cast<std::size_t>(kernel_->outputs());
        const std::size_t columns = push.shape(2);
        require(push.shape(0) == rows && push.shape(1) == track.state.size() / rows &&
                    shown.shape(0) == rows && shown.shape(1) == outputs &&
                    shown.shape(2) == columns,
                "pushes or what is shown have the wrong shape");
        std::vector<double> result(rows * outputs * columns, 0.0);
        {
            nb::gil_scoped_release release;
            respond(*kernel_, recording, track, push.data(), shown.data(),
                    static_cast<int>(columns), result.data());
        }
        return to_numpy(std::move(result), {rows, outputs, columns});
    }

    nb::object derivatives_of(const Array1 &values, const Array2 &states,
                              const Array2 &commands) const {
        check_size(values.shape(0));
        require(states.shape(0) == commands.shape(0) &&
                    states.shape(1) == static_cast<std::size_t>(kernel_->states()) &&
                    commands.shape(1) == static_cast<std::size_t>(kernel_->motors()),
                "states or commands have the wrong shape");
        std::vector<double> result(states.size());
        kernel_->derivatives(kernel_->load(values.data()).get(), static_cast<int>(states.shape(0)),
                             states.data(), commands.data(), result.data());
        return to_numpy(std::move(result), {states.shape(0), states.shape(1)});
    }

  private:
    std::size_t pushes() const {
        return static_cast<std::size_t>(kernel_->pushes());
    }

    void check_size(std::size_t size) const {
        require(size == static_cast<std::size_t>(kernel_->parameters()),
                "a parameter set has the wrong length");
    }

    static void check_tracks(const std::vector<const Recording *> &recordings,
                             const std::vector<const Track *> &tracks) {
        require(recordings.size() == tracks.size(), "one track per recording");
        for (std::size_t i = 0; i < tracks.size(); ++i) {
            require(tracks[i]->innovation.size() == recordings[i]->output.size(),
                    "a track belongs to another recording");
        }
    }

    template <class Work>
    nb::list batch(const std::vector<const Recording *> &recordings,
                   const std::vector<const Track *> &tracks, const Array2 &values,
                   Work &&work) const {
        const ParameterSets sets = checked(recordings, tracks, values);
        return filled(recordings, values.shape(0), {static_cast<std::size_t>(kernel_->outputs())},
                      [&](const auto &out) { work(sets, out); });
    }

    ParameterSets checked(const std::vector<const Recording *> &recordings,
                          const std::vector<const Track *> &tracks, const Array2 &values) const {
        check_size(values.shape(1));
        check_tracks(recordings, tracks);
        for (std::size_t first = 0; first < values.shape(0); first += kernel_->lanes()) {
            const auto count = std::min<std::size_t>(kernel_->lanes(), values.shape(0) - first);
            require_rate(kernel_->fastest_rate_1_s(values.data() + first * values.shape(1),
                                                   static_cast<int>(count)));
        }
        return {values.data(), static_cast<int>(values.shape(0)),
                static_cast<int>(values.shape(1))};
    }

    /* One array [sets][rows][of_row...] per recording, filled by `work` on buffers of zeros. */
    template <class Work>
    static nb::list filled(const std::vector<const Recording *> &recordings, std::size_t sets,
                           const std::vector<std::size_t> &of_row, Work &&work) {
        std::vector<std::vector<std::size_t>> shapes;
        std::vector<std::vector<double>> results;
        std::vector<double *> pointers;
        for (const Recording *r : recordings) {
            shapes.push_back({sets, static_cast<std::size_t>(r->rows)});
            shapes.back().insert(shapes.back().end(), of_row.begin(), of_row.end());
            std::size_t size = 1;
            for (const std::size_t length : shapes.back())
                size *= length;
            results.emplace_back(size, 0.0);
            pointers.push_back(results.back().data());
        }
        {
            nb::gil_scoped_release release;
            work(pointers);
        }
        nb::list arrays;
        for (std::size_t i = 0; i < results.size(); ++i)
            arrays.append(to_numpy(std::move(results[i]), shapes[i]));
        return arrays;
    }

    std::vector<UserTerm> terms_;
    std::unique_ptr<Kernel> kernel_;
};

/* ------------------------------------------------------------------ firmware in the loop */

int base_index(const std::string &name) {
    for (int i = 0; i < RobotLayout::kBase; ++i) {
        if (name == kRobotBase[i].name)
            return i;
    }
    throw std::invalid_argument("unknown parameter '" + name + "'");
}

/* Where the parameters of an effect stand in the flat values. */
struct Place {
    int first, stride;
    std::vector<std::string> parameters;
};
using Places = std::map<std::string, Place>;

Places places_of(const std::vector<UserTerm> &terms, const nb::list &user_effects) {
    Places places;
    for_each_effect(RobotLayout::kMotors, [&](auto effect, int, int slot) {
        using E = decltype(effect);
        Place place{RobotLayout::kBase + slot, effect_stride(E::info, RobotLayout::kMotors), {}};
        for (int k = 0; k < E::info.parameter_count; ++k)
            place.parameters.emplace_back(E::info.parameters[k].name);
        places[E::info.name] = place;
    });
    int first = RobotLayout::kBase + effect_slot_count(RobotLayout::kMotors);
    for (std::size_t k = 0; k < terms.size(); ++k) {
        const nb::dict given = nb::cast<nb::dict>(user_effects[k]);
        Place place{first, terms[k].stride, {}};
        for (nb::handle item : nb::cast<nb::list>(given["parameters"]))
            place.parameters.push_back(nb::cast<std::string>(nb::cast<nb::dict>(item)["name"]));
        places[nb::cast<std::string>(given["name"])] = place;
        first += terms[k].slots();
    }
    return places;
}

/* Sets one effect of a model in the flat values; parameters that are not named keep theirs. */
void set_effect(const nb::dict &given, const Places &places, std::vector<double> &values) {
    const std::string name = nb::cast<std::string>(given["name"]);
    const bool one_wheel = given.contains("wheel") && !given["wheel"].is_none();
    const int wheel = one_wheel ? nb::cast<int>(given["wheel"]) : 0;
    require(wheel >= 0 && wheel <= RobotLayout::kMotors, "wheel must be 1 to 4");
    const auto found = places.find(name);
    if (found == places.end())
        throw std::invalid_argument("unknown effect '" + name + "'");
    const Place &place = found->second;
    for (const auto &[parameter, value] : nb::cast<Numbers>(given["parameters"])) {
        const auto named = std::find(place.parameters.begin(), place.parameters.end(), parameter);
        if (named == place.parameters.end()) {
            throw std::invalid_argument("unknown parameter '" + parameter + "' of effect '" + name +
                                        "'");
        }
        const int k = static_cast<int>(named - place.parameters.begin());
        for (int i = 0; i < place.stride; ++i) {
            if (wheel != 0 && place.stride > 1 && i != wheel - 1)
                continue;
            values[static_cast<std::size_t>(place.first + k * place.stride + i)] = value;
        }
    }
}

std::vector<double> robot_values(const Numbers &parameters, const nb::list &effects,
                                 const std::vector<UserTerm> &terms, const nb::list &user_effects) {
    std::vector<double> values(
        static_cast<std::size_t>(RobotLayout::kBase + effect_slot_count(RobotLayout::kMotors)));
    for (int i = 0; i < RobotLayout::kBase; ++i) {
        values[static_cast<std::size_t>(i)] = kRobotBase[i].value;
    }
    for (const auto &[name, value] : parameters) {
        values[static_cast<std::size_t>(base_index(name))] = value;
    }
    for_each_effect(RobotLayout::kMotors, [&](auto effect, int, int slot) {
        using E = decltype(effect);
        const int stride = effect_stride(E::info, RobotLayout::kMotors);
        for (int k = 0; k < E::info.parameter_count * stride; ++k) {
            values[static_cast<std::size_t>(RobotLayout::kBase + slot + k)] =
                E::info.parameters[k / stride].neutral;
        }
    });
    for (const UserTerm &term : terms) {
        for (const double neutral : term.neutral)
            values.insert(values.end(), static_cast<std::size_t>(term.stride), neutral);
    }
    if (effects.size() == 0)
        return values;
    const Places places = places_of(terms, user_effects);
    for (nb::handle effect : effects)
        set_effect(nb::cast<nb::dict>(effect), places, values);
    return values;
}

std::string unknown_firmware_name(const std::map<std::string, std::int32_t> &named) {
    for (const auto &[name, value] : named) {
        (void)value;
        bool known = false;
        for (int id = 0; id < firmware_parameter_count(); ++id)
            known = known || name == firmware_parameter_name(id);
        if (!known)
            return "unknown firmware parameter '" + name + "'";
    }
    return "a firmware parameter is missing";
}

std::vector<std::int32_t> firmware_values(const std::map<std::string, std::int32_t> &named) {
    std::vector<std::int32_t> values;
    for (int id = 0; id < firmware_parameter_count(); ++id) {
        const auto found = named.find(firmware_parameter_name(id));
        if (found == named.end()) {
            throw std::invalid_argument(std::string("firmware parameter ") +
                                        firmware_parameter_name(id) + " is missing");
        }
        values.push_back(found->second);
    }
    if (named.size() != values.size())
        throw std::invalid_argument(unknown_firmware_name(named));
    return values;
}

Command to_command(const nb::dict &given) {
    Command command;
    command.time_s = nb::cast<double>(given["t_s"]);
    const std::string kind = nb::cast<std::string>(given["kind"]);
    const auto value = nb::cast<std::vector<double>>(given["value"]);
    const std::map<std::string, std::pair<Command::Kind, std::size_t>> kinds = {
        {"stop", {Command::kStop, 0}},
        {"velocity", {Command::kVelocity, 3}},
        {"pose", {Command::kPose, 6}},
        {"duty", {Command::kDuty, 4}}};
    const auto found = kinds.find(kind);
    require(found != kinds.end(), "a command's kind is stop, velocity, pose or duty");
    require(value.size() == found->second.second, "a command has the wrong number of values");
    command.kind = found->second.first;
    std::copy(value.begin(), value.end(), command.value);
    return command;
}

Impulse to_impulse(const nb::dict &given) {
    Impulse impulse;
    impulse.at_x = given.contains("x_m");
    impulse.trigger = nb::cast<double>(given[impulse.at_x ? "x_m" : "t_s"]);
    impulse.x_n_s = nb::cast<double>(given["impulse_x_n_s"]);
    impulse.y_n_s = nb::cast<double>(given["impulse_y_n_s"]);
    impulse.theta_n_m_s = nb::cast<double>(given["impulse_theta_n_m_s"]);
    return impulse;
}

BoardSensors to_sensors(const std::vector<double> &start_counts,
                        const std::optional<Array1> &supply_error_v, double supply_resolution_v,
                        double duration_s) {
    require(start_counts.size() == 4, "encoder_start_counts needs four numbers");
    require(supply_resolution_v > 0.0, "supply_resolution_v must be positive");
    BoardSensors sensors;
    std::copy(start_counts.begin(), start_counts.end(), sensors.encoder_start_counts);
    sensors.supply_resolution_v = supply_resolution_v;
    if (supply_error_v) {
        require(supply_error_v->size() == static_cast<std::size_t>(closed_loop_ticks(duration_s)),
                "supply_error_v needs one number per tick");
        sensors.supply_error_v.assign(supply_error_v->data(),
                                      supply_error_v->data() + supply_error_v->size());
    }
    return sensors;
}

template <class T>
nb::object integers_to_numpy(std::vector<T> &&data, std::initializer_list<std::size_t> shape) {
    auto *owned = new std::vector<T>(std::move(data));
    nb::capsule owner(owned, [](void *p) noexcept { delete static_cast<std::vector<T> *>(p); });
    return nb::cast(nb::ndarray<nb::numpy, T>(owned->data(), shape, owner));
}

nb::dict simulate(const Numbers &parameters, const nb::list &effects,
                  const std::map<std::string, std::int32_t> &firmware_parameters,
                  const nb::list &commands, const nb::list &impulses, double duration_s,
                  double step_s, const std::vector<double> &encoder_start_counts,
                  const std::optional<Array1> &supply_error_v, double supply_resolution_v,
                  bool on_board, const nb::list &user_effects) {
    require(duration_s > 0.0 && step_s > 0.0, "duration_s and step_s must be positive");
    std::vector<Command> command_list;
    for (nb::handle command : commands) {
        command_list.push_back(to_command(nb::cast<nb::dict>(command)));
    }
    std::vector<Impulse> impulse_list;
    for (nb::handle impulse : impulses) {
        impulse_list.push_back(to_impulse(nb::cast<nb::dict>(impulse)));
    }
    const RobotParameters model = robot_parameters(parameters, effects, user_effects);
    const std::vector<std::int32_t> firmware = firmware_values(firmware_parameters);
    const BoardSensors sensors =
        to_sensors(encoder_start_counts, supply_error_v, supply_resolution_v, duration_s);
    ClosedLoopLog log;
    {
        nb::gil_scoped_release release;
        log =
            run_closed_loop(model.values, firmware, command_list, impulse_list, duration_s, step_s,
                            sensors, on_board ? Carrier::kBoard : Carrier::kPlant, model.list());
    }
    const std::size_t n = log.time_s.size();
    nb::dict result;
    result["t_s"] = to_numpy(std::move(log.time_s), {n});
    result["duty"] = to_numpy(std::move(log.duty), {n, 4});
    result["encoder_counts"] = integers_to_numpy(std::move(log.encoder_counts), {n, 4});
    result["pose"] = to_numpy(std::move(log.pose), {n, 3});
    result["velocity"] = to_numpy(std::move(log.velocity), {n, 3});
    result["wheel_speed_rad_s"] = to_numpy(std::move(log.wheel_speed_rad_s), {n, 4});
    result["current_a"] = to_numpy(std::move(log.current_a), {n, 4});
    result["slip_m_s"] = to_numpy(std::move(log.slip_m_s), {n, 4});
    result["drive_force_n"] = to_numpy(std::move(log.drive_force_n), {n, 4});
    result["supply_v"] = to_numpy(std::move(log.supply_v), {n});
    result["gyro_rad_s"] = to_numpy(std::move(log.gyro_rad_s), {n});
    result["camera_pose"] = to_numpy(std::move(log.camera_pose), {n, 3});
    result["odometry"] = to_numpy(std::move(log.odometry), {n, 3});
    result["limited"] = integers_to_numpy(std::move(log.limited), {n});
    result["limit_wheel"] = integers_to_numpy(std::move(log.limit_wheel), {n});
    result["fault"] = integers_to_numpy(std::move(log.fault), {n});
    result["fault_wheel"] = integers_to_numpy(std::move(log.fault_wheel), {n});
    return result;
}

nb::dict step_times_ns(const Numbers &parameters, const nb::list &effects,
                       const std::map<std::string, std::int32_t> &firmware_parameters) {
    const std::vector<double> values = robot_values(parameters, effects, {}, nb::list());
    const std::vector<double> plain = robot_values(parameters, nb::list(), {}, nb::list());
    nb::dict result;
    result["rigid"] = rigid_step_ns(plain);
    result["slip"] = slip_step_ns(plain);
    result["slip, with effects"] = slip_step_ns(values);
    result["axis"] = axis_step_ns();
    result["odometry"] = odometry_step_ns();
    result["firmware"] = firmware_tick_ns(firmware_values(firmware_parameters));
    return result;
}

void limit_engine_threads(int count) {
    require(count >= 1, "at least one thread is needed");
    limit_threads(count);
}

void bind_replay(nb::module_ &m) {
    m.def("limit_threads", &limit_engine_threads, "count"_a,
          "Engines of this process start at most so many threads; without it one per core.");
    m.def("most_threads", &thread_limit, "How many threads these are.");
    nb::class_<Recording>(m, "Recording")
        .def_prop_ro("rows", [](const Recording &r) { return r.rows; })
        .def_ro("settle_s", &Recording::settle_s,
                "Until so long after the first row the filter finds the initial state.")
        .def_prop_ro(
            "begun_variance", [](const Recording &r) { return copy_to_numpy(r.begun_variance); },
            "As `Engine.recording` was given it; empty without.")
        .def_ro("read_before", &Recording::read_before, "As `reading_before` was given it, or 0.")
        .def_prop_ro(
            "untold", [](const Recording &r) { return copy_to_numpy(r.untold); },
            "As `missing` was given it; empty without.")
        .def("rising", &rising, "rise"_a,
             "The same with commands that rise (rows, motors) evenly within each row.")
        .def("commanded", &commanded, "command"_a, "The same with other commands (rows, motors).")
        .def("reading_before", &reading_before, "share"_a = 1.0,
             "The same with electric sensors that are read before the command of their row begins: "
             "1, after: 0, or show so much of both.")
        .def("warmed", &warmed, "length_s"_a, "cold_current_a2"_a,
             "The same of a robot behind rows of these lengths (rows,) in which cold windings "
             "would have let currents of these squares (rows, motors) through.")
        .def("missing", &missing, "untold"_a,
             "The same of a machine with disturbed motors, with rows missing: a motor's rate per "
             "command times the share of each row (rows,) of which nothing tells the command.");
    nb::class_<Track>(m, "Track", "Arrays are flat, row major: see replay.h for their layout.")
        .def_ro("log_likelihood", &Track::log_likelihood)
        .def_prop_ro(
            "filter_states", [](const Track &t) { return t.state.size() / t.decay.size(); },
            "Those of the plant, memory that the filter corrects, disturbances.")
        .def_prop_ro("state", [](const Track &t) { return copy_to_numpy(t.state); })
        .def_prop_ro("innovation", [](const Track &t) { return copy_to_numpy(t.innovation); })
        .def_prop_ro("whitening", [](const Track &t) { return copy_to_numpy(t.whitening); })
        .def_prop_ro("transition", [](const Track &t) { return copy_to_numpy(t.transition); })
        .def_prop_ro("slope", [](const Track &t) { return copy_to_numpy(t.slope); })
        .def_prop_ro("gain", [](const Track &t) { return copy_to_numpy(t.gain); })
        .def_prop_ro("push", [](const Track &t) { return copy_to_numpy(t.push); })
        .def_prop_ro("correction_variance",
                     [](const Track &t) { return copy_to_numpy(t.correction_variance); })
        .def_prop_ro("replay_variance",
                     [](const Track &t) { return copy_to_numpy(t.replay_variance); });
    nb::class_<Engine>(m, "Engine")
        .def(nb::init<const std::string &, int, const nb::list &, bool>(), "kind"_a,
             "widest_lanes"_a = 8, "user_effects"_a = nb::list(), "electric"_a = false)
        .def_prop_ro("states", [](const Engine &e) { return e.kernel().states(); })
        .def_prop_ro(
            "pushes", [](const Engine &e) { return e.kernel().pushes(); },
            "Disturbances: the last states of the filter.")
        .def_prop_ro("outputs", [](const Engine &e) { return e.kernel().outputs(); })
        .def_prop_ro("motors", [](const Engine &e) { return e.kernel().motors(); })
        .def_prop_ro("parameters", [](const Engine &e) { return e.kernel().parameters(); })
        .def_prop_ro("lanes", [](const Engine &e) { return e.kernel().lanes(); })
        .def_prop_ro("instruction_set",
                     [](const Engine &e) { return e.kernel().instruction_set(); })
        .def("recording", &Engine::recording, "time_s"_a, "command"_a, "output"_a,
             "initial_state"_a, "settle_s"_a = kSettleTime_s, "begun_variance"_a = nb::none(),
             "Of a robot that stood until its first command began, behind which nothing lags yet: "
             "`begun_variance` of the initial state (states,), then what those of the first "
             "disturbances have more (pushes,).")
        .def("derivatives", &Engine::derivatives_of, "values"_a, "states"_a, "commands"_a)
        .def("track", &Engine::tracks_of, "recordings"_a, "values"_a, "process"_a, "output"_a,
             "initial"_a, "timing_s2"_a = 0.0, "unresolved"_a = 0.0, "unresolved_current"_a = 0.0,
             "coloured"_a = std::vector<double>(), "colour_rate_1_s"_a = 100.0, "step_s"_a = 1e-3,
             "floor_window_s"_a = 0.0, "keep_linear"_a = false)
        .def("response", &Engine::response_of, "recording"_a, "track"_a, "push"_a, "shown"_a)
        .def("likelihoods", &Engine::likelihoods_of, "recordings"_a, "tracks"_a, "process"_a,
             "output"_a, "initial"_a, "timing_s2"_a, "unresolved"_a, "unresolved_current"_a,
             "coloured"_a, "colour_rate_1_s"_a, "with_information"_a = false)
        .def("innovations", &Engine::innovations_of, "recordings"_a, "tracks"_a, "values"_a,
             "step_s"_a = 1e-3, "least_rate_1_s"_a = 0.0)
        .def("innovations_into", &Engine::innovations_into, "recordings"_a, "tracks"_a, "values"_a,
             "residuals"_a, "begin"_a, "first_row"_a, "place"_a, "step_s"_a = 1e-3,
             "least_rate_1_s"_a = 0.0,
             "Those of set i into row place[i] of residuals (sets, columns): of recording r the "
             "outputs of the rows from first_row[r] on, from column begin[r] on.")
        .def("fastest_rate_1_s", &Engine::fastest_rate_1_s, "values"_a)
        .def("replays", &Engine::replays_of, "recordings"_a, "tracks"_a, "values"_a,
             "step_s"_a = 1e-3, "window_s"_a = 1.0);
}

}  // namespace

/* glibc would map every large array anew, page by page as they are written, and the kernel clears
 * each: a sixth of the time of a closed loop, and of the search for a gap. */
static void keep_freed_memory() {
#if defined(__GLIBC__)
    mallopt(M_MMAP_MAX, 0);
    mallopt(M_TRIM_THRESHOLD, 1 << 30);
#endif
}

RobotParameters robot_parameters(const Numbers &parameters, const nb::list &effects,
                                 const nb::list &user_effects) {
    RobotParameters result;
    result.terms = to_user_terms(user_effects, RobotLayout::kMotors);
    result.values = robot_values(parameters, effects, result.terms, user_effects);
    return result;
}

}  // namespace omnislip

NB_MODULE(_core, m) {
    omnislip::keep_freed_memory();
    m.doc() = "Plant, effect catalogue, replay engine and firmware in the loop of omnislip.";
    m.def("effects", &omnislip::effects, "The catalogue: one dict per effect.");
    m.def("base_parameters", &omnislip::base_parameters, "kind"_a = "robot",
          "Keys of the model file the plant reads, in the order of a parameter set.");
    m.def("simulate", &omnislip::simulate, "parameters"_a, "effects"_a, "firmware_parameters"_a,
          "commands"_a, "impulses"_a, "duration_s"_a, "step_s"_a = 1e-3,
          "encoder_start_counts"_a = std::vector<double>(4, 0.0), "supply_error_v"_a = nb::none(),
          "supply_resolution_v"_a = 1e-3, "on_board"_a = false, "user_effects"_a = nb::list(),
          "Firmware and plant in closed loop; arrays with one row per control tick of 1 ms. "
          "on_board: through the drivers on the virtual LF2407A instead of the stub HAL.");
    m.def("step_times_ns", &omnislip::step_times_ns, "parameters"_a, "effects"_a,
          "firmware_parameters"_a,
          "Nanoseconds per step of 0.5 ms of each model and per control tick of the firmware.");
    m.attr("SETTLE_S") = omnislip::kSettleTime_s;
    m.attr("FASTEST_RATE_1_S") = omnislip::kFastestRate_1_s;
    omnislip::bind_replay(m);
    omnislip::bind_link(m);
}
