/* What is compiled for several instruction sets, replay kernels and the motion of one robot,
 * computes what the plant of one robot computes.
 *
 * Lanes hold robots with different effects; the step is short enough that the stiffest of them
 * does not cut it finer, so every kernel takes the same steps and only rounding may differ.
 */
#include <memory>
#include <numeric>

#include "replay.h"
#include "robot_motion.h"
#include "tests/sim/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using namespace omnislip;

extern "C" void setUp() {}
extern "C" void tearDown() {}

static const double kStep_s = 1e-4;
static const double kWholeRun_s = 1e9;

/* ---- the arc tangent of the friction law ---- */

static double atan_in_right_angles(double x) {
    return lane(omnislip::atan_in_right_angles(LotOf<double>::Type(x)), 0);
}

/* Over all powers of ten that a slip can have, and where one formula takes over from the next. */
static void arc_tangent_is_right_to_two_units_of_the_last_digit(void) {
    for (int k = -40000; k <= 40000; ++k) {
        const double x = std::pow(10.0, k * 5e-4);
        const double right = static_cast<double>(std::atan(static_cast<long double>(x)) /
                                                 std::acos(static_cast<long double>(0.0)));
        const double last_digit = std::nextafter(right, 2.0) - right;
        TEST_ASSERT_DOUBLE_WITHIN(2.0 * last_digit, right, atan_in_right_angles(x));
        TEST_ASSERT_EQUAL_DOUBLE(-atan_in_right_angles(x), atan_in_right_angles(-x));
    }
}

static void arc_tangent_keeps_zero_infinity_and_no_number(void) {
    TEST_ASSERT_EQUAL_DOUBLE(0.0, atan_in_right_angles(0.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.5, atan_in_right_angles(1.0));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, atan_in_right_angles(kUnbounded));
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, atan_in_right_angles(-kUnbounded));
    TEST_ASSERT_DOUBLE_IS_NAN(atan_in_right_angles(kUnbounded - kUnbounded));
}

/* ---- kernels ---- */

/* Unevenly sampled commands; sensors "show" zero, so errors are the negative of the outputs. */
template <class Plant>
static Recording recording_of(double amplitude) {
    Recording r;
    r.rows = 200;
    double time_s = 0.3;
    for (int k = 0; k < r.rows; ++k) {
        r.time_s.push_back(time_s);
        time_s += 0.004 + 0.002 * std::sin(2.0 * k);
        for (int i = 0; i < Plant::kMotors; ++i) {
            r.command.push_back(amplitude * std::sin(0.05 * k * (i + 1) + i));
        }
    }
    r.output.assign(static_cast<std::size_t>(r.rows * Plant::kOutputs), 0.0);
    r.initial_state.assign(Plant::kStates, 0.0);
    r.initial_state[0] = 1.0;
    return r;
}

/* A filter that corrects nothing. */
static Track free_running(const Kernel &kernel, const Recording &r) {
    const auto each_row = [&r](int numbers) {
        return std::vector<double>(static_cast<std::size_t>(r.rows * numbers), 0.0);
    };
    Track t;
    t.gain = each_row((kernel.states() + kernel.pushes()) * kernel.outputs());
    t.whitening = each_row(kernel.outputs() * kernel.outputs());
    t.push = each_row(kernel.states() * kernel.pushes());
    t.decay = each_row(1);
    return t;
}

/* What sensors show in row k; the camera, where it is late, a pose of `poses`, where this one goes.
 */
static void show(const RobotPlant<double> &plant, const Recording &r, std::size_t k,
                 const double *x, std::vector<double> &poses, double *y) {
    double since[3];
    poses.insert(poses.end(), x + RobotLayout::kPose, x + RobotLayout::kPose + 3);
    way_since(r.time_s.data(), poses.data(), static_cast<long>(k), plant.late_s(r.time_s[k]),
              since);
    plant.output(x, r.time_s[k], y, since);
}
static void show(const AxisPlant<double> &plant, const Recording &r, std::size_t k, const double *x,
                 std::vector<double> &, double *y) {
    plant.output(x, r.time_s[k], y);
}

template <class AnyBench, class Plant>
static std::vector<double> outputs_of(const Model<Plant> &model, const Recording &r) {
    AnyBench bench(model);
    std::vector<double> outputs, poses;
    std::copy(r.initial_state.begin(), r.initial_state.end(), bench.x.begin());
    bench.time_s = r.time_s[0];
    for (std::size_t k = 0; k < r.time_s.size(); ++k) {
        double y[Plant::kOutputs];
        show(bench.plant, r, k, bench.x.data(), poses, y);
        outputs.insert(outputs.end(), y, y + Plant::kOutputs);
        if (k + 1 < r.time_s.size()) {
            typename AnyBench::Command command;
            std::copy_n(&r.command[k * Plant::kMotors], Plant::kMotors, command.begin());
            bench.drive(command, r.time_s[k + 1] - r.time_s[k], kStep_s);
            bench.time_s = r.time_s[k + 1];
        }
    }
    return outputs;
}

/* One model per effect with that effect at its typical size, and a neutral one. */
template <class Plant>
static std::vector<Model<Plant>> one_model_per_effect() {
    std::vector<Model<Plant>> models(kEffectCount + 1);
    for (int wanted = 0; wanted < kEffectCount; ++wanted) {
        Model<Plant> &model = models[static_cast<std::size_t>(wanted)];
        model.each_slot([&](const EffectInfo &info, int index, int k, int, double &slot) {
            if (index == wanted && (info.kinds & Plant::kKind) != 0) {
                const ParameterInfo &p = info.parameters[k];
                const bool unlimited = p.neutral == kUnbounded && p.typical > 0.0;
                slot = unlimited ? p.typical : p.neutral + p.typical;
                model.active[index] = true;
            }
        });
    }
    return models;
}

template <class Plant>
static std::vector<double> joined(const std::vector<Model<Plant>> &models) {
    std::vector<double> values;
    for (const Model<Plant> &model : models) {
        values.insert(values.end(), model.flat.begin(), model.flat.end());
    }
    return values;
}

/* Largest difference of kernel and scalar plant, relative to the size of the output. */
template <class AnyBench, class Plant>
static double worst_difference(int kind, int lanes, const std::vector<Model<Plant>> &models,
                               const Recording &r) {
    const std::unique_ptr<Kernel> kernel = make_kernel(kind, lanes);
    const std::vector<double> values = joined(models);
    const Track track = free_running(*kernel, r);
    const std::size_t plane = static_cast<std::size_t>(r.rows * Plant::kOutputs);
    std::vector<double> errors(models.size() * plane);
    replays(*kernel, {&r}, {&track},
            {values.data(), static_cast<int>(models.size()), kernel->parameters()}, kStep_s,
            kWholeRun_s, {errors.data()});
    double worst = 0.0;
    for (std::size_t m = 0; m < models.size(); ++m) {
        const std::vector<double> expected = outputs_of<AnyBench>(models[m], r);
        for (std::size_t j = 0; j < plane; ++j) {
            const double apart = std::abs(expected[j] + errors[m * plane + j]);
            worst = std::max(worst, apart / (1.0 + std::abs(expected[j])));
        }
    }
    return worst;
}

static void robots_in_lanes_move_as_one_robot_alone(void) {
    const auto models = one_model_per_effect<RobotPlant<double>>();
    const Recording r = recording_of<RobotPlant<double>>(0.5);
    for (const int lanes : {2, 4, 8}) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.0, worst_difference<Robot>(0, lanes, models, r));
    }
}

static void axes_in_lanes_move_as_one_axis_alone(void) {
    const auto models = one_model_per_effect<AxisPlant<double>>();
    const Recording r = recording_of<AxisPlant<double>>(0.5);
    for (const int lanes : {2, 4, 8}) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.0, worst_difference<Axis>(1, lanes, models, r));
    }
}

/* What the sensors show in each row of a robot that moves by itself. */
static std::vector<double> outputs_of_motion(const RobotModel &model, const Recording &r,
                                             int widest_lanes) {
    const auto motion =
        make_robot_motion(model.flat.data(), static_cast<int>(model.flat.size()), {}, widest_lanes);
    std::vector<double> outputs, poses;
    double x[RobotLayout::kAll] = {};
    RobotInternals<double> in = {};
    std::copy(r.initial_state.begin(), r.initial_state.end(), x);
    motion->settle(x, r.command.data(), in);
    for (std::size_t k = 0; k < r.time_s.size(); ++k) {
        double y[RobotLayout::kOutputs];
        poses.insert(poses.end(), x + RobotLayout::kPose, x + RobotLayout::kPose + 3);
        motion->output(x, r.time_s[k], {r.time_s.data(), poses.data(), static_cast<long>(k)}, y);
        outputs.insert(outputs.end(), y, y + RobotLayout::kOutputs);
        if (k + 1 < r.time_s.size()) {
            const DutyHistory duties = {r.time_s.data(), r.command.data(), static_cast<long>(k)};
            motion->advance(x, duties, r.time_s[k], r.time_s[k + 1] - r.time_s[k], kStep_s,
                            Rule::kRk4, false, in);
        }
    }
    return outputs;
}

static void robot_moves_alike_whatever_registers_hold_its_wheels(void) {
    const Recording r = recording_of<RobotPlant<double>>(0.5);
    for (const RobotModel &model : one_model_per_effect<RobotPlant<double>>()) {
        const std::vector<double> expected = outputs_of<Robot>(model, r);
        for (const int lanes : {2, 4}) {
            const std::vector<double> found = outputs_of_motion(model, r, lanes);
            for (std::size_t j = 0; j < expected.size(); ++j) {
                const double bound = 1e-9 * (1.0 + std::abs(expected[j]));
                TEST_ASSERT_DOUBLE_WITHIN(bound, expected[j], found[j]);
            }
        }
    }
}

/* A step that begins where `look` was is bit for bit that of a step that looks itself. */
static void step_goes_on_from_a_look_as_from_none(void) {
    const RobotModel model;
    const auto motion =
        make_robot_motion(model.flat.data(), static_cast<int>(model.flat.size()), {});
    const double time_s = 0.0, duty[4] = {0.5, -0.2, 0.4, 0.1};
    const DutyHistory duties = {&time_s, duty, 0};
    RobotInternals<double> in = {};
    for (const Rule rule : {Rule::kRk4, Rule::kMerson}) {
        double x[2][RobotLayout::kAll] = {};
        for (const bool looks : {false, true}) {
            x[looks][RobotLayout::kPose + 2] = 0.7;
            if (looks)
                motion->look(x[looks], duties, time_s, in);
            motion->advance(x[looks], duties, time_s, 3e-3, 1e-3, rule, looks, in);
        }
        TEST_ASSERT_EQUAL_MEMORY(x[0], x[1], sizeof x[0]);
        TEST_ASSERT_TRUE(x[1][RobotLayout::kSpeed] > 1.0);
    }
}

static void kernel_describes_the_plant(void) {
    const std::unique_ptr<Kernel> robot = make_kernel(0, 8), axis = make_kernel(1, 8);
    TEST_ASSERT_EQUAL_INT(RobotLayout::kStates, robot->states());
    TEST_ASSERT_EQUAL_INT(RobotLayout::kBase + effect_slot_count(4), robot->parameters());
    TEST_ASSERT_EQUAL_INT(AxisPlant<double>::kStates, axis->states());
    TEST_ASSERT_EQUAL_INT(AxisPlant<double>::kBase + effect_slot_count(1), axis->parameters());
    TEST_ASSERT_EQUAL_INT(2, make_kernel(0, 2)->lanes());
}

/* Transition over a row against central differences of the scalar plant. */
static void rows_slope_is_the_plants(const RobotModel &model, std::size_t remembered) {
    const std::unique_ptr<Kernel> kernel = make_kernel(0, 8);
    const std::shared_ptr<const void> loaded = kernel->load(model.flat.data());
    const std::vector<int> memory = kernel->filtered_memory(loaded.get());
    TEST_ASSERT_EQUAL_size_t(remembered, memory.size());
    using Whole = std::array<double, RobotLayout::kAll>;
    Whole start = {120.0, -80.0, 60.0, -30.0, 1.0, 2.0, 3.0, 4.0, 0.7, -0.3, 1.2, 0.5, 0.6, 0.7};
    std::vector<int> moved(RobotLayout::kStates);
    std::iota(moved.begin(), moved.end(), 0);
    for (const int place : memory) {
        start[static_cast<std::size_t>(place)] = 0.1 * (place - RobotLayout::kGrip - 2);
        moved.push_back(place);
    }
    const Robot::Command duty = {0.5, -0.2, 0.4, 0.1};
    const std::vector<double> begin_s = {0.0};
    const Robot robot(model);
    const auto reached = [&](int place, double offset) {
        Whole x = start;
        x[static_cast<std::size_t>(place)] += offset;
        RobotInternals<double> in{};
        const LoggedCommands<RobotPlant<double>> log(robot.plant, begin_s.data(), duty.data(), 0);
        advance(robot.plant, x.data(), log, 0.0, 0.005, kStep_s, robot.plant.fastest_rate_1_s(),
                in);
        return x;
    };
    Recording row;
    row.time_s = {0.0, 0.005};
    row.command.assign(duty.begin(), duty.end());
    const std::size_t n = moved.size();
    Whole next;
    std::vector<double> transition(n * n);
    kernel->linearise(loaded.get(), row, 0, kStep_s, moved, start.data(), next.data(),
                      transition.data());
    for (std::size_t j = 0; j < n; ++j) {
        const Whole up = reached(moved[j], 1e-4), down = reached(moved[j], -1e-4);
        for (std::size_t i = 0; i < n; ++i) {
            const std::size_t place = static_cast<std::size_t>(moved[i]);
            const double slope = (up[place] - down[place]) / 2e-4;
            TEST_ASSERT_DOUBLE_WITHIN(1e-3 * (1.0 + std::abs(slope)), slope, transition[i * n + j]);
        }
    }
}

static void linearised_row_is_the_slope_of_the_plant(void) {
    rows_slope_is_the_plants(RobotModel().effect("coulomb_friction", "torque_nm", 0.005), 0);
}

static void linearised_row_knows_what_bristles_hold(void) {
    for (const double rolling : {0.0, 1.0, 2.0}) { /* 2: they hold the slip */
        RobotModel bristles;
        bristles.effect("bristle_relaxation", "length_m", 2e-3);
        rows_slope_is_the_plants(bristles.effect("bristle_relaxation", "rolling", rolling), 4);
    }
}

static void linearised_row_knows_how_springs_are_twisted(void) {
    RobotModel springs = RobotModel()
                             .effect("shaft_compliance", "stiffness_nm_rad", 40.0)
                             .effect("shaft_compliance", "damping_nm_s_rad", 0.02);
    rows_slope_is_the_plants(springs, 8);
    springs.effect("bristle_relaxation", "length_m", 2e-3);
    rows_slope_is_the_plants(springs, 12);
}

/* What no slope describes the filter leaves alone. */
static void play_is_not_corrected(void) {
    const std::unique_ptr<Kernel> kernel = make_kernel(0, 8);
    const RobotModel model = RobotModel()
                                 .effect("shaft_compliance", "stiffness_nm_rad", 40.0)
                                 .effect("gear_backlash", "angle_rad", 0.02);
    TEST_ASSERT_TRUE(kernel->filtered_memory(kernel->load(model.flat.data()).get()).empty());
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(arc_tangent_is_right_to_two_units_of_the_last_digit);
    RUN_TEST(arc_tangent_keeps_zero_infinity_and_no_number);
    RUN_TEST(robots_in_lanes_move_as_one_robot_alone);
    RUN_TEST(axes_in_lanes_move_as_one_axis_alone);
    RUN_TEST(robot_moves_alike_whatever_registers_hold_its_wheels);
    RUN_TEST(step_goes_on_from_a_look_as_from_none);
    RUN_TEST(kernel_describes_the_plant);
    RUN_TEST(linearised_row_is_the_slope_of_the_plant);
    RUN_TEST(linearised_row_knows_what_bristles_hold);
    RUN_TEST(linearised_row_knows_how_springs_are_twisted);
    RUN_TEST(play_is_not_corrected);
    return UNITY_END();
}
