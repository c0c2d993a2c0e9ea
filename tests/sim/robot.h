/* robot.h - a robot or an axis on the test bench: parameters by name, state, one call to drive it.
 *
 * Units are those of the plant: SI, speeds and angles of a motor at its shaft.
 */
#ifndef OMNISLIP_TESTS_SIM_ROBOT_H
#define OMNISLIP_TESTS_SIM_ROBOT_H

#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>
#include <vector>

#include "axis_plant.h"
#include "integrator.h"
#include "robot_plant.h"

namespace omnislip {

constexpr double kHalfSqrt3 = 0.86602540378443864676;
/* The motion of four wheels that no body motion without slip can have: J' n = 0. */
constexpr double kNull[4] = {1.0, -1.0, 1.0, -1.0};

inline const auto &base_of(const RobotPlant<double> *) {
    return kRobotBase;
}
inline const auto &base_of(const AxisPlant<double> *) {
    return kAxisBase;
}

/* A set of parameters: base values and all effects neutral until told otherwise. */
template <class Plant>
class Model {
  public:
    Model() {
        for (const BaseParameter &p : base_of(static_cast<Plant *>(nullptr))) {
            flat.push_back(p.value);
        }
        flat.resize(static_cast<std::size_t>(Plant::kBase + effect_slot_count(Plant::kMotors)));
        each_slot([&](const EffectInfo &info, int, int k, int, double &slot) {
            slot = info.parameters[k].neutral;
        });
    }

    Model &set(const std::string &key, double value) {
        int index = 0;
        for (const BaseParameter &p : base_of(static_cast<Plant *>(nullptr))) {
            if (key == p.name) {
                flat[static_cast<std::size_t>(index)] = value;
                return *this;
            }
            ++index;
        }
        throw std::invalid_argument("no base parameter " + key);
    }

    /* Switches the effect on and sets one of its parameters; wheel 1..4, 0 = all. */
    Model &effect(const std::string &name, const std::string &parameter, double value,
                  int wheel = 0) {
        bool found = false;
        each_slot([&](const EffectInfo &info, int index, int k, int i, double &slot) {
            const bool asked = name == info.name && parameter == info.parameters[k].name;
            if (asked && (wheel == 0 || wheel == i + 1)) {
                slot = value;
                active[index] = found = true;
            }
        });
        if (!found) {
            throw std::invalid_argument("no effect " + name + "." + parameter);
        }
        return *this;
    }

    /* `action(info, effect index, parameter, wheel, value)` for every effect parameter. */
    template <class Action>
    void each_slot(Action &&action) {
        for_each_effect(Plant::kMotors, [&](auto effect, int index, int slot) {
            constexpr EffectInfo info = decltype(effect)::info;
            const int stride = effect_stride(info, Plant::kMotors);
            for (int k = 0; k < info.parameter_count; ++k) {
                for (int i = 0; i < stride; ++i) {
                    const int place = Plant::kBase + slot + k * stride + i;
                    action(info, index, k, i, flat[static_cast<std::size_t>(place)]);
                }
            }
        });
    }

    std::vector<double> flat;
    bool active[kEffectCount] = {};
};

/* A plant with its state. The plant keeps a pointer into the model: no copies. */
template <class Plant, class Internals>
class Bench {
  public:
    using State = std::array<double, Plant::kStates>;
    using Command = std::array<double, Plant::kMotors>;

    explicit Bench(const Model<Plant> &model = Model<Plant>()) : model_(model) {
        plant.prepare(model_.flat.data(), model_.active);
    }
    Bench(const Bench &) = delete;
    Bench &operator=(const Bench &) = delete;

    /* With the memory as if the command had lasted for long. */
    State derivative(const Command &command, double time_s = 0.0) {
        std::array<double, Plant::kAll> all, change;
        std::copy(x.begin(), x.end(), all.begin());
        settle(plant, all.data(), command.data(), time_s, in);
        look(plant, all.data(), command.data(), time_s, change.data(), in);
        State states;
        std::copy_n(change.begin(), Plant::kStates, states.begin());
        return states;
    }

    /* The first command has lasted for long before. */
    void drive(const Command &command, double duration_s, double step_s = 1e-3) {
        times_s_.push_back(time_s);
        commands_.insert(commands_.end(), command.begin(), command.end());
        std::copy(x.begin(), x.end(), all.begin());
        if (times_s_.size() == 1)
            settle(plant, all.data(), command.data(), time_s, in);
        const LoggedCommands<Plant> log(plant, times_s_.data(), commands_.data(),
                                        static_cast<long>(times_s_.size()) - 1);
        advance(plant, all.data(), log, time_s, duration_s, step_s, plant.fastest_rate_1_s(), in);
        std::copy_n(all.begin(), Plant::kStates, x.begin());
        time_s += duration_s;
    }

    Plant plant;
    State x{};
    std::array<double, Plant::kAll> all{}; /* x and the memory after the last drive */
    double time_s = 0.0;
    Internals in{};

  private:
    const Model<Plant> model_;
    std::vector<double> times_s_, commands_;
};

using RobotModel = Model<RobotPlant<double>>;
using AxisModel = Model<AxisPlant<double>>;
using Robot = Bench<RobotPlant<double>, RobotInternals<double>>;
using Axis = Bench<AxisPlant<double>, AxisInternals<double>>;

}  // namespace omnislip

#endif
