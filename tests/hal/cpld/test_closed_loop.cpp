/* One scenario on three carriers: the stub HAL, the virtual board, and the virtual board with the
 * Verilog counters on its bus. */
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "../../sim/robot.h"
#include "closed_loop.h"
#include "rtl_counters.h"
#include "unity.h"

using namespace omnislip;

void setUp(void) {}
void tearDown(void) {}

namespace {

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) initial,
const std::vector<std::int32_t> kFirmware = {
#include "firmware/parameters.def"
};
#undef PARAMETER

constexpr double kStep_s = 5e-4;
constexpr double kRimPerShaft_m = 0.05 / 12, kWheelDistance_m = 0.20, kShaftCounts = 2000;

struct Scenario {
    const char *name;
    std::vector<Command> commands;
    double duration_s;
    std::array<double, 4> start_counts = {};
};

Command command(double time_s, Command::Kind kind, std::vector<double> values) {
    Command command;
    command.time_s = time_s;
    command.kind = kind;
    std::copy(values.begin(), values.end(), command.value);
    return command;
}

/* Those of tests/loop/test_board.py. */
const Scenario kStraight = {"straight", {command(0.0, Command::kVelocity, {1.5, 0.0, 0.0})}, 3.0};
const Scenario kPose = {"pose", {command(0.0, Command::kPose, {1.0, 0.5, 0.5})}, 3.0};
const Scenario kCurves = {"curves",
                          {command(0.0, Command::kVelocity, {1.0, 0.5, 2.0}),
                           command(1.0, Command::kVelocity, {-1.0, 0.5, -2.0})},
                          3.0};
/* Full voltage at wheels that turn the robot on the spot, and back: the fastest there is. */
const Scenario kFullDuty = {"full duty",
                            {command(0.0, Command::kDuty, {1.0, 1.0, 1.0, 1.0}),
                             command(0.4, Command::kDuty, {-1.0, -1.0, -1.0, -1.0})},
                            0.8,
                            {0.3, -7.2, 1000.9, 30001.5}};

ClosedLoopLog run(const Scenario &scenario, Carrier carrier, const CountersMaker &counters = {}) {
    const Model<RobotPlant<double>> nominal;
    BoardSensors sensors;
    std::copy_n(scenario.start_counts.data(), 4, sensors.encoder_start_counts);
    return run_closed_loop(nominal.flat, kFirmware, scenario.commands, {}, scenario.duration_s,
                           kStep_s, sensors, carrier, {}, counters);
}

ClosedLoopLog run_rtl(const Scenario &scenario, RtlCounters::Tally &tally, bool skipping = true) {
    return run(scenario, Carrier::kBoard, [&](EncoderSource &source) {
        return std::make_unique<RtlCounters>(source, skipping, tally);
    });
}

double largest(const std::vector<double> &values) {
    double result = 0.0;
    for (double value : values)
        result = std::max(result, std::abs(value));
    return result;
}

/* Largest distance between two paths, in place [m] and heading [rad]. */
std::array<double, 2> apart(const ClosedLoopLog &one, const ClosedLoopLog &other) {
    std::array<double, 2> result = {};
    for (std::size_t i = 0; i < one.pose.size(); ++i) {
        double &worst = result[i % 3 == 2];
        worst = std::max(worst, std::abs(one.pose[i] - other.pose[i]));
    }
    return result;
}

/* Largest distance of the two paths, in place and heading, that is explained. The Verilog shows
 * where the shafts were 0.15 us before: at any LATCH the count of the behavioural counters or the
 * one behind. So the two believe in places one count of each wheel apart, J+ times its path at the
 * rim; and their duties, rounded apart by up to a step of 1/2000, let the slip observers see forces
 * and slips that are apart as tests/loop/test_board.py derives. The heading turns the path; on the
 * average over the run half of it is wrong. */
std::array<double, 2> explained(const ClosedLoopLog &log, double duration_s) {
    constexpr double kGrip_n = 0.6 * 20.0 * 9.81 / 4, kSlipStiffness_s_m = 40.0;
    constexpr double kDutyStep = 1.0 / 2000, kSupply_v = 24.0;
    constexpr double kForce_n_v = 0.0255 / 0.6 / kRimPerShaft_m;
    /* Sums of the rows of J+ for bearings 30, 150, 210, 330 degrees. */
    constexpr double kPlace = 4 * 0.5, kTurn_1_m = 1.0 / kWheelDistance_m;
    std::vector<double> force_n = log.drive_force_n;
    for (double &force : force_n)
        force = std::abs(force);
    std::sort(force_n.begin(), force_n.end());
    const double tangent = std::tan(kPi / 2 * force_n[force_n.size() / 2] / kGrip_n);
    const double slip_m_s = kDutyStep * kSupply_v * kForce_n_v * kPi / 2 /
                            (kSlipStiffness_s_m * kGrip_n) * (1 + tangent * tangent);
    const double rim_m = 2 * kPi / kShaftCounts * kRimPerShaft_m + slip_m_s * duration_s;
    double fastest_m_s = 0.0;
    for (std::size_t i = 0; i < log.velocity.size(); i += 3)
        fastest_m_s = std::max(fastest_m_s, std::hypot(log.velocity[i], log.velocity[i + 1]));
    const double heading_rad = kTurn_1_m * rim_m;
    return {kPlace * rim_m + fastest_m_s * duration_s * heading_rad / 2, heading_rad};
}

/* Every LATCH of the run showed all four shafts where they were. */
void nothing_is_lost(const RtlCounters::Tally &tally, double duration_s) {
    TEST_ASSERT_EQUAL_INT(0, tally.wrong_counts);
    TEST_ASSERT_EQUAL_INT(0, tally.errors);
    TEST_ASSERT_EQUAL_INT(4 * tally.latches, tally.counts_read);
    TEST_ASSERT_GREATER_THAN_INT(static_cast<int>(duration_s / kTick_s), tally.latches);
}

void same_path(const Scenario &scenario) {
    RtlCounters::Tally tally;
    const ClosedLoopLog stub = run(scenario, Carrier::kPlant);
    const ClosedLoopLog board = run(scenario, Carrier::kBoard);
    const ClosedLoopLog rtl = run_rtl(scenario, tally);
    const std::array<double, 2> near = apart(board, rtl);
    const std::array<double, 2> bound = explained(board, scenario.duration_s);
    const auto print = [](const char *what, const std::array<double, 2> &distance) {
        std::printf("  %s: %.2f mm, %.2f mrad\n", what, distance[0] * 1e3, distance[1] * 1e3);
    };
    std::printf("%s\n", scenario.name);
    print("stub and board", apart(stub, board));
    print("stub and Verilog", apart(stub, rtl));
    print("board and Verilog", near);
    print("explained", bound);
    TEST_ASSERT_TRUE(near[0] < bound[0]);
    TEST_ASSERT_TRUE(near[1] < bound[1]);
    nothing_is_lost(tally, scenario.duration_s);
}

}  // namespace

static void straight(void) {
    same_path(kStraight);
}
static void to_a_pose(void) {
    same_path(kPose);
}
static void curves(void) {
    same_path(kCurves);
}
/* Nothing that the counters show decides on the duty, so the paths are equal to the bit. */
static void at_full_duty_nothing_is_lost(void) {
    RtlCounters::Tally tally;
    const ClosedLoopLog board = run(kFullDuty, Carrier::kBoard), rtl = run_rtl(kFullDuty, tally);
    nothing_is_lost(tally, kFullDuty.duration_s);
    TEST_ASSERT_TRUE(board.pose == rtl.pose);
    const double fastest_rad_s = largest(rtl.wheel_speed_rad_s);
    std::printf("no count lost up to %.0f rad/s, %.0f thousand counts/s\n", fastest_rad_s,
                fastest_rad_s / (2 * kPi) * kShaftCounts / 1e3);
    TEST_ASSERT_TRUE(fastest_rad_s > 800.0);
}

/* Skipping clocks is a matter of speed alone. */
static void every_clock_gives_the_same(void) {
    Scenario scenario = kFullDuty;
    scenario.duration_s = 0.05;
    scenario.commands[1].time_s = 0.02;
    RtlCounters::Tally tally;
    const ClosedLoopLog skipping = run_rtl(scenario, tally), all = run_rtl(scenario, tally, false);
    TEST_ASSERT_TRUE(skipping.encoder_counts == all.encoder_counts);
    TEST_ASSERT_TRUE(skipping.pose == all.pose);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(straight);
    RUN_TEST(to_a_pose);
    RUN_TEST(curves);
    RUN_TEST(at_full_duty_nothing_is_lost);
    RUN_TEST(every_clock_gives_the_same);
    return UNITY_END();
}
