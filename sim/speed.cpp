#include "speed.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "axis_plant.h"
#include "closed_loop.h"
#include "firmware/control_loop.h"
#include "integrator.h"
#include "motion_hal.h"
#include "odometry_plant.h"
#include "rigid_model.h"
#include "robot_motion.h"

namespace omnislip {
namespace {

constexpr double kStep_s = 5e-4;
constexpr double kNoWheel_deg = std::numeric_limits<double>::quiet_NaN();
constexpr int kMeasurements = 200, kRepetitions = 1000;

/* Least nanoseconds per call of `work`, which runs the state x on: x is looked at in the end, lest
 * the compiler leave the work out. */
template <class Work>
double least_ns(const char *model, const double *x, Work &&work) {
    using Clock = std::chrono::steady_clock;
    double least = kUnbounded;
    for (int i = 0; i < kMeasurements; ++i) {
        const Clock::time_point begin = Clock::now();
        for (int k = 0; k < kRepetitions; ++k)
            work();
        const std::chrono::duration<double, std::nano> spent = Clock::now() - begin;
        least = std::min(least, spent.count() / kRepetitions);
    }
    if (!std::isfinite(x[0]))
        throw std::runtime_error(std::string(model) + " ran away while its step was measured");
    return least;
}

/* The nominal machine, and room for effects of which none is active. */
template <class Plant>
std::vector<double> nominal_values(const BaseParameter (&base)[Plant::kBase]) {
    std::vector<double> values;
    for (const BaseParameter &p : base)
        values.push_back(p.value);
    values.resize(static_cast<std::size_t>(Plant::kBase + effect_slot_count(Plant::kMotors)));
    return values;
}

/* Shafts that follow their duty with a lag: just enough for the firmware to hold a speed. */
class Shafts {
  public:
    void counts(std::uint16_t *out) {
        for (int i = 0; i < 4; ++i) {
            counts_[i] += counts_per_tick_[i];
            out[i] = static_cast<std::uint16_t>(static_cast<std::int64_t>(counts_[i]));
        }
    }
    void set_duty(const std::int16_t *duty_q15) {
        constexpr double kNoLoad = 300.0; /* counts per tick: 24 V / 0.0255 V s of 2000 counts */
        for (int i = 0; i < 4; ++i) {
            const double settled = kNoLoad * duty_q15[i] / 32768.0;
            counts_per_tick_[i] += 0.05 * (settled - counts_per_tick_[i]);
        }
    }
    std::uint16_t supply_mv() const {
        return 24000;
    }
    void currents_ma(std::int16_t *out) const {
        std::fill_n(out, 4, static_cast<std::int16_t>(0));
    }
    const double *turned() const {
        return counts_;
    }

  private:
    double counts_[4] = {}, counts_per_tick_[4] = {};
};

}  // namespace

double rigid_step_ns(const std::vector<double> &values) {
    RobotPlant<double> plant;
    bool active[kEffectCount];
    mark_active<RobotPlant<double>>(values.data(), 1, static_cast<int>(values.size()), active);
    plant.prepare(values.data(), active);
    const RigidModel rigid(plant.constants());
    const double voltage_v[4] = {4.8, -2.4, 7.2, 2.4};
    double x[RigidModel::kStates] = {};
    RigidInternals in;
    return least_ns("rigid model", x,
                    [&] { advance(rigid, x, voltage_v, 0.0, kStep_s, kStep_s, 0.0, in); });
}

double slip_step_ns(const std::vector<double> &values) {
    const auto motion = make_robot_motion(values.data(), static_cast<int>(values.size()), {});
    const double time_s = 0.0, duty[4] = {0.2, -0.1, 0.3, 0.1};
    const DutyHistory duties = {&time_s, duty, 0};
    double x[RobotLayout::kAll] = {};
    RobotInternals<double> in = {};
    return least_ns("slip model", x, [&] {
        motion->advance(x, duties, time_s, kStep_s, kStep_s, Rule::kRk4, false, in);
    });
}

double axis_step_ns() {
    using Plant = AxisPlant<double>;
    const std::vector<double> values = nominal_values<Plant>(kAxisBase);
    const bool active[kEffectCount] = {};
    Plant plant;
    plant.prepare(values.data(), active);
    const double time_s = 0.0, command = 0.2;
    const LoggedCommands<Plant> commands(plant, &time_s, &command, 0);
    const double rate_1_s = plant.fastest_rate_1_s();
    double x[Plant::kAll] = {};
    AxisInternals<double> in = {};
    return least_ns("axis", x,
                    [&] { advance(plant, x, commands, time_s, kStep_s, kStep_s, rate_1_s, in); });
}

double odometry_step_ns() {
    using Plant = OdometryPlant<double>;
    std::vector<double> values = nominal_values<Plant>(kOdometryBase);
    constexpr double kBearings_deg[kMostWheels] = {
        30.0, 150.0, 210.0, 330.0, kNoWheel_deg, kNoWheel_deg, kNoWheel_deg, kNoWheel_deg};
    std::copy_n(kBearings_deg, kMostWheels, &values[Plant::kBase - kMostWheels]);
    const bool active[kEffectCount] = {};
    Plant plant;
    plant.prepare(values.data(), active);
    const double time_s = 0.0, rates_rad_s[kMostWheels] = {2.0, -1.0, 3.0, 1.0};
    const ShownCommands<double> commands(plant, &time_s, rates_rad_s, 0, 1);
    double x[Plant::kAll] = {};
    OdometryInternals in;
    return least_ns("odometry", x,
                    [&] { advance(plant, x, commands, time_s, kStep_s, kStep_s, 0.0, in); });
}

double firmware_tick_ns(const std::vector<std::int32_t> &firmware) {
    const parameters settings = to_settings(firmware);
    Shafts shafts;
    const MotionHal<Shafts> hal(shafts);
    control_loop loop;
    control_loop_init(&loop, &settings);
    control_loop_tick(&loop); /* BOOT -> IDLE */
    control_loop_arm(&loop);
    const double spent_ns = least_ns("firmware", shafts.turned(), [&] {
        control_loop_command_velocity(&loop, 500, 300, 1000);
        control_loop_tick(&loop);
    });
    if (loop.telemetry.mode != CONTROL_MODE_VELOCITY)
        throw std::runtime_error("the firmware stopped while its tick was measured");
    return spent_ns;
}

}  // namespace omnislip
