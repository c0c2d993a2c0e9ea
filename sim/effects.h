/* effects.h - the catalogue: every effect that can be missing from a model, each defined once.
 *
 * An effect is one struct: its `info` (name, parameters with unit, neutral value, bounds and
 * typical size, one line of physics, equation, source) and the term itself, written in the hook
 * where it acts. The plant calls the hooks of the effects that are switched on; the workflow, the
 * report, the file reader and the documentation read `info`. To add an effect, add a struct here
 * and its name to `Catalogue` at the end of the file.
 *
 * Hooks, in the order in which the signal passes them (N motors; N = 4 robot, N = 1 single axis):
 *   prepare   constants of the plant, once per parameter set            Constants
 *   command   the duty (axis: the command) before the driver            CommandTerm
 *   supply    the open-circuit voltage                                  SupplyTerm
 *   current   the motor current                                         CurrentTerm
 *   shaft     torques on the motor shaft                                ShaftTerm
 *   contact   grip, wheel radius and shape of the friction law          ContactTerm
 *   body      forces on the body                                        BodyTerm
 *   sensor    what the sensors show                                     SensorTerm
 *   motion    motion of the body against what its encoders claim        MotionTerm (odometry)
 *
 * Units are SI; speeds, angles and torques of a motor are at the motor shaft. A linear axis reads
 * "torque" as force, "speed in rad/s" as m/s and "angle" as position.
 */
#ifndef OMNISLIP_SIM_EFFECTS_H
#define OMNISLIP_SIM_EFFECTS_H

#include <limits>
#include <tuple>
#include <type_traits>

#include "lanes.h"

namespace omnislip {

constexpr double kUnbounded = std::numeric_limits<double>::infinity();
constexpr double kLoadShare = 0.2; /* wheel, shaft and last gear, of the drive's inertia */
/* Closed teeth: how both sides of the gear would swing against each other on them. What is softer
 * than 900 rad/s is a shaft_compliance. */
constexpr double kToothFrequency_rad_s = 1500.0, kToothDampingRatio = 0.3;
constexpr double kCoolingTime_s = 60.0; /* of a winding into its housing */
constexpr int kMaxEffectParameters = 8;

struct ParameterInfo {
    const char *name = nullptr;
    const char *unit = nullptr;
    double neutral = 0.0;
    double low = 0.0;
    double high = 0.0;
    double typical = 0.0; /* offset from neutral of a size worth looking for */
};

/* On which wheels the search tries an effect. A file may name a wheel for any but `kWhole`. */
enum class Scope { kWhole, kCommon, kSingle, kCommonOrSingle };

enum Kind : unsigned { kRobot = 1u, kAxis = 2u, kOdometry = 4u };

enum Hook : unsigned {
    kPrepare = 1u << 0,
    kCommand = 1u << 1,
    kSupply = 1u << 2,
    kCurrent = 1u << 3,
    kShaft = 1u << 4,
    kContact = 1u << 5,
    kBody = 1u << 6,
    kSensor = 1u << 7,
    kMotion = 1u << 8,
    kCounted = 1u << 12,
    /* Marks of effects: what shaft angles move, what goes with where a robot is or which way it is
     * turned; of sensors, what encoders show of speeds. */
    kByAngle = 1u << 9,
    kCounts = 1u << 10,
    kByPlace = 1u << 11,
};

struct EffectInfo {
    const char *name;
    const char *summary;
    const char *equation;
    const char *where;
    const char *source;
    Scope scope;
    unsigned kinds;
    unsigned hooks;
    int parameter_count;
    ParameterInfo parameters[kMaxEffectParameters];
};

inline namespace OMNISLIP_INSTRUCTION_SET {

/* Parameter values of one effect: `value(k, i)` is parameter k on motor i. */
template <class S>
struct Values {
    const S *first;
    int stride; /* N when each wheel has its own value, 1 when the robot has one */
    const S &operator()(int parameter, int wheel = 0) const {
        return first[parameter * stride + (stride > 1 ? wheel : 0)];
    }
};

template <class S, int N>
struct Constants {
    S mass_kg, inertia_kg_m2, wheel_distance_m, gravity_m_s2;
    S resistance_ohm, supply_v, gear_ratio;
    S torque_constant_nm_a[N], back_emf_constant_v_s_rad[N];
    S shaft_inertia_kg_m2[N], viscous_friction_nm_s[N];
    S wheel_radius_m[N], wheel_angle_rad[N], roller_angle_offset_rad[N];
    S mu_drive[N], mu_roller, slip_stiffness_s_m;
    S load_bias_n[N];
    S cog_x_m, cog_y_m, cog_height_m;
    S source_resistance_ohm;
    S pose_delay_s, clock_fraction; /* of the camera */
    S zero_angle_rad;               /* reading at which a pendulum hangs straight down */
    S friction_speed;               /* rad/s at the shaft; a Coulomb torque is smoothed over it */
    S ripple_nm[N], ripple_per_rad[N]; /* torque on a shaft that repeats with its angle */
    /* memory: see memory.h */
    S delay_s[N], driver_lag_s[N], inductance_h[N], heating_1_a2_s[N], cooling_time_s[N];
    S bristle_length_m[N], bristle_rolling[N];
    S slip_lags[N]; /* 1 where bristles hold the slip, 0 where they hold the force */
    S play_rad[N], tooth_frequency_rad_s[N], tooth_damping_ratio[N];
    S stiffness_nm_rad[N], damping_nm_s_rad[N], load_share[N];
};

template <class S, int N>
struct CommandTerm {
    S duty[N];
};

template <class S>
struct SupplyTerm {
    S open_circuit_v, time_s;
};

template <class S, int N>
struct CurrentTerm {
    S current_a[N]; /* in: from the armature equation; out: what flows */
    const S *duty;
    const S *speed_rad_s;
};

template <class S, int N>
struct ShaftTerm {
    S torque_nm[N]; /* sum of the effects' torques, positive drives the shaft */
    const S *speed_rad_s;
    const S *angle_rad;
    const S *motor_torque_nm;
    const S *inertia_kg_m2;
    S least_way_rad; /* amplitude of a ripple of the shafts' angles that shows nowhere */
    S sign[N];       /* smooth sign of the speed, tanh(W / friction speed) */
};

template <class S, int N>
struct ContactTerm {
    S mu_drive[N];      /* in and out */
    S radius_m[N];      /* in and out */
    S shape[N];         /* in and out: saturating function of k s, odd, limit +-1 */
    S force_scale[N];   /* in and out: factor on the drive force (1) */
    S roller_shape[N];  /* in and out: the same law across the wheel */
    S scaled_slip[N];   /* k s */
    S scaled_roller[N]; /* k VF */
    S slip_m_s[N];
    const S *shaft_angle_rad;
    S drive_direction_rad[N]; /* world direction of the drive axis */
    S x_m, y_m, time_s, gear_ratio;
};

template <class S, int N>
struct BodyTerm {
    S force_x_n, force_y_n, torque_nm; /* in and out: body frame, at the centre of gravity */
    S acceleration_x_m_s2, acceleration_y_m_s2; /* in and out: world frame, gravity-like */
    S force_along_drive_per_load[N]; /* in and out: force per wheel load, not felt by the motor */
    S hub_speed_m_s[N];
    S vx_m_s, vy_m_s, omega_rad_s;
    S x_m, y_m, cos_theta, sin_theta;
};

template <class S, int N>
struct SensorTerm {
    S gyro_rad_s, x_m, y_m, theta_rad; /* in and out */
    S encoder_rate[N];                 /* in and out: encoder angle per shaft angle */
    const S *speed_rad_s;
};

template <class S>
struct MotionTerm {
    S vx_m_s, vy_m_s, omega_rad_s; /* in: as the encoders claim; out: of the body */
};

template <class S, int N>
struct CountedTerm {
    S rate_rad_s[N]; /* in: as an encoder counts; out: of its wheel */
    S told_rad_s[N]; /* what the other wheels say of it, NaN where they cannot */
};

/* Every effect derives from this: hooks it does not define do nothing. */
struct Effect {
    template <class S, int N>
    static void prepare(Constants<S, N> &, const Values<S> &) {}
    template <class S, int N>
    static void command(CommandTerm<S, N> &, const Values<S> &) {}
    template <class S>
    static void supply(SupplyTerm<S> &, const Values<S> &) {}
    template <class S, int N>
    static void current(CurrentTerm<S, N> &, const Values<S> &) {}
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &, const Values<S> &) {}
    template <class S, int N>
    static void contact(ContactTerm<S, N> &, const Values<S> &) {}
    template <class S, int N>
    static void body(BodyTerm<S, N> &, const Values<S> &) {}
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &, const Values<S> &) {}
    template <class S>
    static void motion(MotionTerm<S> &, const Values<S> &) {}
    template <class S, int N>
    static void counted(CountedTerm<S, N> &, const Values<S> &) {}
};

/* ------------------------------------------------------------------ supply, driver and motor */

struct SupplySag : Effect {
    static constexpr EffectInfo info = {"supply_sag",
                                        "The battery voltage drops with the total current drawn.",
                                        "V = V0 - r sum(i d), currents and V in balance",
                                        "supply",
                                        "battery internal resistance",
                                        Scope::kWhole,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"source_resistance_ohm", "ohm", 0.0, 0.0, 2.0, 0.05}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.source_resistance_ohm = c.source_resistance_ohm + p(0);
    }
};

struct StateOfChargeDrift : Effect {
    static constexpr EffectInfo info = {"state_of_charge_drift",
                                        "The battery runs down during the run.",
                                        "V0 (1 - rate t)",
                                        "supply",
                                        "battery discharge",
                                        Scope::kWhole,
                                        kRobot,
                                        kSupply,
                                        1,
                                        {{"rate_1_s", "1/s", 0.0, 0.0, 0.05, 0.002}}};
    template <class S>
    static void supply(SupplyTerm<S> &c, const Values<S> &p) {
        c.open_circuit_v = c.open_circuit_v * (S(1.0) - p(0) * c.time_s);
    }
};

struct DeadZone : Effect {
    static constexpr EffectInfo info = {
        "dead_zone",
        "The driver gives nothing below a least duty and that much less above it.",
        "d -> sign(d) max(abs(d) - z, 0)",
        "driver",
        "dead time of the bridge",
        Scope::kCommon,
        kRobot | kAxis,
        kCommand,
        1,
        {{"duty", "1", 0.0, 0.0, 0.5, 0.02}}};
    template <class S, int N>
    static void command(CommandTerm<S, N> &c, const Values<S> &p) {
        using std::abs;
        using std::max;
        for (int i = 0; i < N; ++i) {
            const S left = max(abs(c.duty[i]) - p(0, i), S(0.0));
            c.duty[i] = sign_of(c.duty[i]) * left;
        }
    }
};

struct DriverNonlinearity : Effect {
    static constexpr EffectInfo info = {"driver_nonlinearity",
                                        "The driver's gain changes with the size of the duty.",
                                        "d -> d + cubic d^3",
                                        "driver",
                                        "odd cubic of the bridge characteristic",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kCommand,
                                        1,
                                        {{"cubic", "1", 0.0, -1.5, 1.5, 0.08}}};
    template <class S, int N>
    static void command(CommandTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.duty[i] = c.duty[i] * (S(1.0) + p(0, i) * c.duty[i] * c.duty[i]);
        }
    }
};

struct ActuationDelay : Effect {
    static constexpr EffectInfo info = {"actuation_delay",
                                        "The driver acts on the command of a moment ago.",
                                        "d(t - delay); before the log begins its first d",
                                        "driver",
                                        "transport and computing time",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kPrepare,
                                        1,
                                        {{"delay_s", "s", 0.0, 0.0, 0.1, 0.004}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.delay_s[i] = p(0, i);
    }
};

struct DriverLag : Effect {
    static constexpr EffectInfo info = {"driver_lag",
                                        "The driver approaches its command gradually.",
                                        "lag d' = d_command - d",
                                        "driver",
                                        "first-order filter of the bridge or its input",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kPrepare,
                                        1,
                                        {{"time_constant_s", "s", 0.0, 0.0, 0.2, 0.004}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.driver_lag_s[i] = p(0, i);
    }
};

struct ArmatureInductance : Effect {
    static constexpr EffectInfo info = {"armature_inductance",
                                        "The winding's inductance makes the current late.",
                                        "La i' = d V - k3 W - Ra i",
                                        "motor",
                                        "paper eq. (6), kept",
                                        Scope::kCommon,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"inductance_h", "H", 0.0, 0.0, 0.02, 8e-4}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.inductance_h[i] = p(0, i);
    }
};

struct WindingHeating : Effect {
    static constexpr EffectInfo info = {"winding_heating",
                                        "The current warms the winding and raises its resistance.",
                                        "Ra (1 + c Q), Q' = i^2 - Q / cooling_time, cold at first",
                                        "motor",
                                        "copper, 0.4 % per kelvin",
                                        Scope::kCommon,
                                        kRobot,
                                        kPrepare,
                                        2,
                                        {{"coefficient", "1/(A^2 s)", 0.0, 0.0, 1.0, 0.002},
                                         {"cooling_time_s", "s", kCoolingTime_s, 2.0, 1e3, 0.0}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.heating_1_a2_s[i] = p(0, i);
            c.cooling_time_s[i] = p(1, i);
        }
    }
};

struct CurrentLimit : Effect {
    static constexpr EffectInfo info = {"current_limit",
                                        "The driver clips the motor current.",
                                        "i clipped to +-limit",
                                        "driver",
                                        "current fold-back",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kCurrent,
                                        1,
                                        {{"limit_a", "A", kUnbounded, 0.5, kUnbounded, 12.0}}};
    template <class S, int N>
    static void current(CurrentTerm<S, N> &c, const Values<S> &p) {
        using std::max;
        using std::min;
        for (int i = 0; i < N; ++i) {
            c.current_a[i] = max(min(c.current_a[i], p(0, i)), -p(0, i));
        }
    }
};

struct DriverFreewheel : Effect {
    static constexpr EffectInfo info = {"driver_freewheel",
                                        "The bridge freewheels where the motor would brake.",
                                        "i -> f i where i W < 0 and d W >= 0",
                                        "driver",
                                        "slow against fast decay of the bridge",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kCurrent,
                                        1,
                                        {{"braking_fraction", "1", 1.0, 0.0, 1.5, -0.4}}};
    template <class S, int N>
    static void current(CurrentTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            const auto brakes = c.current_a[i] * c.speed_rad_s[i] < S(0.0);
            const auto keeps_sign = c.duty[i] * c.speed_rad_s[i] >= S(0.0);
            c.current_a[i] =
                select(brakes, select(keeps_sign, p(0, i) * c.current_a[i], c.current_a[i]),
                       c.current_a[i]);
        }
    }
};

struct WeakMotor : Effect {
    static constexpr EffectInfo info = {
        "weak_motor",
        "One motor has a smaller (or larger) torque and back-EMF constant.",
        "k2, k3 of one motor times scale",
        "motor",
        "demagnetised or different motor",
        Scope::kSingle,
        kRobot,
        kPrepare,
        1,
        {{"scale", "1", 1.0, 0.3, 1.7, -0.06}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.torque_constant_nm_a[i] = c.torque_constant_nm_a[i] * p(0, i);
            c.back_emf_constant_v_s_rad[i] = c.back_emf_constant_v_s_rad[i] * p(0, i);
        }
    }
};

struct TorqueConstantError : Effect {
    static constexpr EffectInfo info = {"torque_constant_error",
                                        "All motors have another torque and back-EMF constant.",
                                        "k2, k3 of all motors times scale",
                                        "motor",
                                        "data sheet against motor",
                                        Scope::kCommon,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"scale", "1", 1.0, 0.5, 1.5, 0.08}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        WeakMotor::prepare(c, p);
    }
};

struct MotorInertiaError : Effect {
    static constexpr EffectInfo info = {
        "motor_inertia_error",
        "The inertia at the motor shaft is another.",
        "J0 + x",
        "motor",
        "eq. (7)",
        Scope::kCommon,
        kRobot,
        kPrepare,
        1,
        {{"inertia_kg_m2", "kg m^2", 0.0, -2.0e-5, 2.0e-4, 4.0e-6}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.shaft_inertia_kg_m2[i] = c.shaft_inertia_kg_m2[i] + p(0, i);
        }
    }
};

/* ------------------------------------------------------------------------- friction and gear */

struct ViscousFrictionError : Effect {
    static constexpr EffectInfo info = {
        "viscous_friction_error",
        "The speed-proportional friction of the drive is another.",
        "b0 + x",
        "shaft",
        "eq. (7)",
        Scope::kCommon,
        kRobot | kAxis,
        kPrepare,
        1,
        {{"viscous_friction_nm_s", "N m s", 0.0, -kUnbounded, kUnbounded, 1.5e-5}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.viscous_friction_nm_s[i] = c.viscous_friction_nm_s[i] + p(0, i);
        }
    }
};

struct CoulombFriction : Effect {
    static constexpr EffectInfo info = {"coulomb_friction",
                                        "Dry friction of the drive, constant against the motion.",
                                        "shaft torque -T sg(W)",
                                        "shaft",
                                        "Coulomb",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kShaft,
                                        1,
                                        {{"torque_nm", "N m", 0.0, 0.0, kUnbounded, 0.005}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.torque_nm[i] = c.torque_nm[i] - p(0, i) * c.sign[i];
    }
};

struct AsymmetricFriction : Effect {
    static constexpr EffectInfo info = {
        "asymmetric_friction",
        "Extra friction in the positive direction only.",
        "shaft torque -(T + v W) sg(W) (1 + sg(W)) / 2",
        "shaft",
        "worn screw or gear; Janot et al., EMPS",
        Scope::kCommon,
        kRobot | kAxis,
        kShaft,
        2,
        {{"torque_nm", "N m", 0.0, -kUnbounded, kUnbounded, 0.004},
         {"viscous_nm_s", "N m s", 0.0, -kUnbounded, kUnbounded, 1.0e-5}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            const S forward = c.sign[i] * (S(1.0) + c.sign[i]) * S(0.5);
            c.torque_nm[i] = c.torque_nm[i] - (p(0, i) + p(1, i) * c.speed_rad_s[i]) * forward;
        }
    }
};

struct StribeckFriction : Effect {
    static constexpr EffectInfo info = {"stribeck_friction",
                                        "More friction near standstill than in motion.",
                                        "shaft torque -T exp(-(W/ws)^2) sg(W)",
                                        "shaft",
                                        "Stribeck",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kShaft,
                                        2,
                                        {{"torque_nm", "N m", 0.0, 0.0, kUnbounded, 0.006},
                                         {"speed_rad_s", "rad/s", 10.0, 0.0, kUnbounded, 0.0}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        using std::exp;
        for (int i = 0; i < N; ++i) {
            const S ratio = c.speed_rad_s[i] / p(1, i);
            c.torque_nm[i] = c.torque_nm[i] - p(0, i) * exp(-ratio * ratio) * c.sign[i];
        }
    }
};

struct LoadDependentFriction : Effect {
    static constexpr EffectInfo info = {"load_dependent_friction",
                                        "Gear friction in proportion to the transmitted torque.",
                                        "shaft torque -c abs(tau) sg(W)",
                                        "shaft",
                                        "gear mesh loss; Rhoban BAM M4",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kShaft,
                                        1,
                                        {{"coefficient", "1", 0.0, 0.0, 0.9, 0.05}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        using std::abs;
        for (int i = 0; i < N; ++i) {
            c.torque_nm[i] = c.torque_nm[i] - p(0, i) * abs(c.motor_torque_nm[i]) * c.sign[i];
        }
    }
};

struct QuadraticWheelDrag : Effect {
    static constexpr EffectInfo info = {
        "quadratic_wheel_drag",
        "Drag on the shaft that grows with the square of the speed.",
        "shaft torque -c W abs(W)",
        "shaft",
        "windage, grease churning",
        Scope::kCommon,
        kRobot | kAxis,
        kShaft,
        1,
        {{"coefficient", "N m s^2", 0.0, 0.0, kUnbounded, 4.0e-8}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        using std::abs;
        for (int i = 0; i < N; ++i) {
            c.torque_nm[i] = c.torque_nm[i] - p(0, i) * c.speed_rad_s[i] * abs(c.speed_rad_s[i]);
        }
    }
};

struct OneWheelDrag : Effect {
    static constexpr EffectInfo info = {"one_wheel_drag",
                                        "Dry friction on one drive only.",
                                        "shaft torque -T sg(W) on one shaft",
                                        "shaft",
                                        "rubbing wheel or bearing",
                                        Scope::kSingle,
                                        kRobot,
                                        kShaft,
                                        1,
                                        {{"torque_nm", "N m", 0.0, 0.0, kUnbounded, 0.008}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        CoulombFriction::shaft(c, p);
    }
};

/* The least way to be seen is that of so long a time at the speed over which dry friction is
 * smoothed (1e-4 rad of a robot's shafts, a thirtieth of a count). And the rate by which steps are
 * chosen for one of a ripple: a step of 2.5 rad of it, in which the rule of weights is off by 1 %.
 */
constexpr double kLeastWay_s = 50e-6;
constexpr double kRatePerRipple = 1.4 / 2.5;
template <class S, int N>
S least_way_rad(const Constants<S, N> &c) {
    return S(kLeastWay_s) * c.friction_speed;
}

/* So fast that it shows nowhere a ripple fades, and is not followed: of a torque T sin(n th) at the
 * speed W the shaft's angle keeps T / (J (n W)^2), which is the least way to be seen, e, at the
 * rate n W = sqrt(T / (J e)). From there to 1.5 times that rate the ripple is taken away. Steps
 * that are too long for it would see any part of it, for long where n W h is near a whole turn. */
template <class S>
S ripple_rate_1_s(const S &torque_nm, const S &inertia_kg_m2, const S &least_way_rad) {
    using std::abs;
    using std::sqrt;
    return sqrt(abs(torque_nm) / (inertia_kg_m2 * least_way_rad));
}
template <class S>
S ripple_left(const S &torque_nm, const S &rate_1_s, const S &inertia_kg_m2,
              const S &least_way_rad) {
    using std::abs;
    using std::max;
    using std::min;
    constexpr double gone = 1.5 * 1.5 - 1.0, tiny_nm = 1e-30;
    const S size = abs(torque_nm) + S(tiny_nm);
    const S beyond = rate_1_s * rate_1_s * inertia_kg_m2 * least_way_rad - size;
    const S u = max(min(beyond / (S(gone) * size), S(1.0)), S(0.0));
    return S(1.0) - u * u * (S(3.0) - S(2.0) * u);
}

struct Cogging : Effect {
    static constexpr EffectInfo info = {"cogging",
                                        "Torque ripple that repeats with the angle of the shaft.",
                                        "shaft torque -T sin(n th + phase)",
                                        "shaft",
                                        "slots and magnets",
                                        Scope::kCommon,
                                        kRobot | kAxis,
                                        kPrepare | kShaft | kByAngle,
                                        3,
                                        {{"torque_nm", "N m", 0.0, 0.0, kUnbounded, 0.004},
                                         {"cycles_per_rev", "1", 7.0, 1.0, 200.0, 0.0},
                                         {"phase_rad", "rad", 0.0, -kPi, kPi, 0.0}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.ripple_nm[i] = p(0, i);
            c.ripple_per_rad[i] = p(1, i);
        }
    }
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        using std::sin;
        for (int i = 0; i < N; ++i) {
            const S left = ripple_left(p(0, i), p(1, i) * c.speed_rad_s[i], c.inertia_kg_m2[i],
                                       c.least_way_rad);
            const S ripple_nm = p(0, i) * sin(p(1, i) * c.angle_rad[i] + p(2, i));
            c.torque_nm[i] = c.torque_nm[i] - left * ripple_nm;
        }
    }
};

struct GearBacklash : Effect {
    static constexpr EffectInfo info = {
        "gear_backlash",
        "The gear has play: after a reversal the motor turns before the wheel does.",
        "no torque while the twist at the wheel is within +-angle / 2; load_share of the inertia "
        "is behind it, which swings on closed teeth at tooth_frequency",
        "gear",
        "play between the teeth",
        Scope::kCommon,
        kRobot | kAxis,
        kPrepare,
        4,
        {{"angle_rad", "rad", 0.0, 0.0, 0.5, 0.01},
         {"load_share", "1", kLoadShare, 0.05, 0.95, 0.0},
         {"tooth_frequency_rad_s", "rad/s", kToothFrequency_rad_s, 900.0, 6000.0, 0.0},
         {"tooth_damping_ratio", "1", kToothDampingRatio, 0.02, 2.0, 0.0}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.play_rad[i] = p(0, i);
            c.load_share[i] = c.load_share[i] + (p(1, i) - S(kLoadShare));
            c.tooth_frequency_rad_s[i] = p(2, i);
            c.tooth_damping_ratio[i] = p(3, i);
        }
    }
};

struct ShaftCompliance : Effect {
    static constexpr EffectInfo info = {
        "shaft_compliance",
        "The shaft between motor and wheel or load is a spring.",
        "load torque = stiffness twist + damping twist'; load_share of the inertia is behind it",
        "gear",
        "two-mass drive: spring and damper at the wheel side, encoder at the motor",
        Scope::kCommon,
        kRobot | kAxis,
        kPrepare,
        3,
        {{"stiffness_nm_rad", "N m/rad", kUnbounded, 1.0, kUnbounded, 100.0},
         {"damping_nm_s_rad", "N m s/rad", 0.1, 0.0, kUnbounded, 0.0},
         {"load_share", "1", kLoadShare, 0.05, 0.95, 0.0}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.stiffness_nm_rad[i] = p(0, i);
            c.damping_nm_s_rad[i] = p(1, i);
            c.load_share[i] = c.load_share[i] + (p(2, i) - S(kLoadShare));
        }
    }
};

struct ForceOffset : Effect {
    static constexpr EffectInfo info = {
        "force_offset",
        "A constant force on the axis: offset of the drive or of gravity.",
        "constant force or torque added",
        "shaft",
        "amplifier offset, tilt",
        Scope::kCommon,
        kAxis,
        kShaft,
        1,
        {{"torque_nm", "N m", 0.0, -kUnbounded, kUnbounded, 0.003}}};
    template <class S, int N>
    static void shaft(ShaftTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.torque_nm[i] = c.torque_nm[i] + p(0, i);
    }
};

struct PendulumZeroError : Effect {
    static constexpr EffectInfo info = {
        "pendulum_zero_error",
        "The pendulum hangs straight down at another reading than zero.",
        "gravity torque m l g sin(q - angle)",
        "sensor",
        "encoder zero; Rhoban BAM q_offset",
        Scope::kCommon,
        kAxis,
        kPrepare,
        1,
        {{"angle_rad", "rad", 0.0, -0.5, 0.5, 0.02}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.zero_angle_rad = p(0);
    }
};

/* ---------------------------------------------------------------------- wheels and geometry */

struct WheelRadiusError : Effect {
    static constexpr EffectInfo info = {"wheel_radius_error",
                                        "A wheel (or every wheel) has another radius.",
                                        "R times scale",
                                        "wheel",
                                        "wear, tolerance",
                                        Scope::kCommonOrSingle,
                                        kRobot | kOdometry,
                                        kPrepare,
                                        1,
                                        {{"scale", "1", 1.0, 0.7, 1.3, 0.02}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.wheel_radius_m[i] = c.wheel_radius_m[i] * p(0, i);
    }
};

struct WheelEccentricity : Effect {
    static constexpr EffectInfo info = {
        "wheel_eccentricity",
        "A wheel runs out of round once per turn.",
        "R (1 + A sin(wheel angle + phase))",
        "wheel",
        "hub off centre",
        Scope::kSingle,
        kRobot,
        kContact | kByAngle,
        2,
        {{"amplitude", "1", 0.0, 0.0, 0.3, 0.02}, {"phase_rad", "rad", 0.0, -kPi, kPi, 0.0}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        using std::sin;
        for (int i = 0; i < N; ++i) {
            const S wheel_angle = c.shaft_angle_rad[i] / c.gear_ratio;
            c.radius_m[i] = c.radius_m[i] * (S(1.0) + p(0, i) * sin(wheel_angle + p(1, i)));
        }
    }
};

struct WheelAngleError : Effect {
    static constexpr EffectInfo info = {"wheel_angle_error",
                                        "A wheel is mounted turned about the vertical.",
                                        "drive and roller direction turned, position kept",
                                        "wheel",
                                        "bent bracket",
                                        Scope::kSingle,
                                        kRobot | kOdometry,
                                        kPrepare,
                                        1,
                                        {{"angle_rad", "rad", 0.0, -0.5, 0.5, 0.03}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.roller_angle_offset_rad[i] = c.roller_angle_offset_rad[i] + p(0, i);
        }
    }
};

struct WheelDistanceError : Effect {
    static constexpr EffectInfo info = {"wheel_distance_error",
                                        "The wheels sit nearer to or farther from the centre.",
                                        "L times scale",
                                        "wheel",
                                        "contact point of the rollers",
                                        Scope::kWhole,
                                        kRobot | kOdometry,
                                        kPrepare,
                                        1,
                                        {{"scale", "1", 1.0, 0.7, 1.3, 0.02}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.wheel_distance_m = c.wheel_distance_m * p(0);
    }
};

/* -------------------------------------------------------------------------------- contact */

struct LowGrip : Effect {
    static constexpr EffectInfo info = {"low_grip",
                                        "Every wheel grips less (or more) than believed.",
                                        "mu_drive of all wheels times scale",
                                        "contact",
                                        "dust, floor",
                                        Scope::kCommon,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"scale", "1", 1.0, 0.05, 3.0, -0.15}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.mu_drive[i] = c.mu_drive[i] * p(0, i);
    }
};

struct UnevenGrip : Effect {
    static constexpr EffectInfo info = {"uneven_grip",
                                        "One wheel grips less (or more) than the others.",
                                        "mu_drive of one wheel times scale",
                                        "contact",
                                        "worn rollers",
                                        Scope::kSingle,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"scale", "1", 1.0, 0.05, 3.0, -0.2}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        LowGrip::prepare(c, p);
    }
};

struct SlipStiffnessError : Effect {
    static constexpr EffectInfo info = {"slip_stiffness_error",
                                        "The friction force rises faster or slower with slip.",
                                        "k times scale",
                                        "contact",
                                        "eq. (13)",
                                        Scope::kWhole,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"scale", "1", 1.0, 0.05, 20.0, 0.3}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.slip_stiffness_s_m = c.slip_stiffness_s_m * p(0);
    }
};

struct GripFalloff : Effect {
    static constexpr EffectInfo info = {
        "grip_falloff",
        "Grip falls once the wheel slides fast.",
        "mu (1 - f (1 - exp(-(s/v)^2)))",
        "contact",
        "friction peak and fall-off",
        Scope::kWhole,
        kRobot,
        kContact,
        2,
        {{"fraction", "1", 0.0, 0.0, 0.9, 0.2}, {"speed_m_s", "m/s", 0.3, 0.02, 5.0, 0.0}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        using std::exp;
        for (int i = 0; i < N; ++i) {
            const S ratio = c.slip_m_s[i] / p(1);
            c.mu_drive[i] = c.mu_drive[i] * (S(1.0) - p(0) * (S(1.0) - exp(-ratio * ratio)));
        }
    }
};

struct GripDrift : Effect {
    static constexpr EffectInfo info = {"grip_drift",
                                        "Grip falls steadily during the run.",
                                        "mu (1 - rate t)",
                                        "contact",
                                        "dust, warm rollers",
                                        Scope::kWhole,
                                        kRobot,
                                        kContact,
                                        1,
                                        {{"rate_1_s", "1/s", 0.0, -0.1, 0.1, 0.02}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.mu_drive[i] = c.mu_drive[i] * (S(1.0) - p(0) * c.time_s);
    }
};

struct ContactShape : Effect {
    static constexpr EffectInfo info = {
        "contact_shape",
        "The friction law bends otherwise between stick and slide.",
        "(1 - b - c - d - e - f - g - h) (2/pi) atan(k s) + b tanh(x) + "
        "c sgn(x) (1 - max(1 - |x|/3, 0)^3) + d x / sqrt(1 + x^2) + e sgn(x) (1 - exp(-|x|)) + "
        "f x / (1 + |x|) + g sgn(x) min(|x|, 1) + h sin(1.4 atan(x / 1.4)), x = (2/pi) k s; the "
        "rollers' law takes the share `roller` of that change",
        "contact",
        "tyre laws: c is the brush model, h the magic formula, which falls behind a peak (Pacejka, "
        "Tire and Vehicle Dynamics, 2012, 3.2 and 4.3); c to h and roller only where b does not "
        "suffice",
        Scope::kWhole,
        kRobot,
        kContact,
        8,
        {{"blend", "1", 0.0, -1.0, 2.5, 0.4},
         {"brush", "1", 0.0, -2.5, 2.5, 0.3},
         {"root", "1", 0.0, -2.5, 2.5, 0.3},
         {"exponential", "1", 0.0, -2.5, 2.5, 0.3},
         {"roller", "1", 0.0, -0.5, 1.5, 0.5},
         {"rational", "1", 0.0, -2.5, 2.5, 0.3},
         {"straight", "1", 0.0, -2.5, 2.5, 0.3},
         {"peaked", "1", 0.0, -2.5, 2.5, 0.3}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        const bool across = used(p(4));
        const Used uses = {used(p(2)), used(p(5)), used(p(7))};
        for (int i = 0; i < N; ++i) {
            c.shape[i] = c.shape[i] + change(c.shape[i], c.scaled_slip[i], p, uses);
            if (across) {
                const S more = change(c.roller_shape[i], c.scaled_roller[i], p, uses);
                c.roller_shape[i] = c.roller_shape[i] + p(4) * more;
            }
        }
    }
    struct Used {
        bool root, rational, peaked;
    };
    /* Most laws have one share: the elementary functions of the others would be most of a step. */
    template <class S>
    static bool used(const S &share) {
        using std::abs;
        return any_above(abs(share), 0.0);
    }
    template <class S>
    static S change(const S &shape, const S &scaled_slip, const Values<S> &p, const Used &uses) {
        using std::abs;
        using std::atan;
        using std::exp;
        using std::sin;
        using std::sqrt;
        const S x = S(2.0 / kPi) * scaled_slip, size = abs(x);
        const S left = S(1.0) - size * S(1.0 / 3.0);
        const S sticking = select(left > S(0.0), left, S(0.0));
        const S decay = exp(-size), twice = decay * decay;
        S even = p(0) * (S(1.0) - twice) / (S(1.0) + twice) +
                 p(1) * (S(1.0) - sticking * sticking * sticking) + p(3) * (S(1.0) - decay) +
                 p(6) * select(size < S(1.0), size, S(1.0));
        if (uses.root)
            even = even + p(2) * size / sqrt(S(1.0) + size * size);
        if (uses.rational)
            even = even + p(5) * size / (S(1.0) + size);
        if (uses.peaked)
            even = even + p(7) * sin(S(1.4) * atan(size * S(1.0 / 1.4)));
        const S shares = p(0) + p(1) + p(2) + p(3) + p(5) + p(6) + p(7);
        return select(x < S(0.0), -even, even) - shares * shape;
    }
};

struct BristleRelaxation : Effect {
    static constexpr EffectInfo info = {
        "bristle_relaxation",
        "The drive force follows the slip after some sliding, or some rolling on.",
        "z' = pace (phi(s) - z) / length, force = N mu z; pace = abs(s / phi(s)), or "
        "abs(R W / n) + abs(s) + 0.02 m/s with rolling = 1; with rolling = 2 so does the slip: "
        "z' = pace (s - z) / length, force = N mu phi(z)",
        "contact",
        "LuGre bristles (rolling = 0), or a tyre's relaxation length: its force lags (1; between, "
        "a blend), or its slip (beyond 1.5); phi the friction law as a share of its limit",
        Scope::kCommon,
        kRobot,
        kPrepare,
        2,
        {{"length_m", "m", 0.0, 0.0, 0.2, 0.001}, {"rolling", "1", 0.0, 0.0, 2.0, 0.0}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        using std::min;
        for (int i = 0; i < N; ++i) {
            c.bristle_length_m[i] = p(0, i);
            c.bristle_rolling[i] = min(p(1, i), S(1.0));
            c.slip_lags[i] = select(p(1, i) > S(1.5), S(1.0), S(0.0));
        }
    }
};

struct CarpetAnisotropy : Effect {
    static constexpr EffectInfo info = {
        "carpet_anisotropy",
        "Grip depends on the direction over the floor.",
        "mu (1 + c cos 2p + s sin 2p), p = world direction of the drive axis",
        "contact",
        "nap of the carpet",
        Scope::kWhole,
        kRobot,
        kContact | kByPlace,
        2,
        {{"cos2", "1", 0.0, -0.8, 0.8, 0.12}, {"sin2", "1", 0.0, -0.8, 0.8, 0.12}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        using std::cos;
        using std::sin;
        for (int i = 0; i < N; ++i) {
            const S twice = S(2.0) * c.drive_direction_rad[i];
            c.mu_drive[i] = c.mu_drive[i] * (S(1.0) + p(0) * cos(twice) + p(1) * sin(twice));
        }
    }
};

struct SlipperyPatch : Effect {
    static constexpr EffectInfo info = {
        "slippery_patch",
        "A part of the floor is slippery (or sticky).",
        "mu_drive times scale while the body centre is inside",
        "contact",
        "spill, tape",
        Scope::kWhole,
        kRobot,
        kContact | kByPlace,
        5,
        {{"x_min_m", "m", -kUnbounded, -kUnbounded, kUnbounded, 0.0},
         {"x_max_m", "m", kUnbounded, -kUnbounded, kUnbounded, 0.0},
         {"y_min_m", "m", -kUnbounded, -kUnbounded, kUnbounded, 0.0},
         {"y_max_m", "m", kUnbounded, -kUnbounded, kUnbounded, 0.0},
         {"scale", "1", 1.0, 0.05, 3.0, -0.4}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        S scale = select(c.x_m >= p(0), p(4), S(1.0));
        scale = select(c.x_m <= p(1), scale, S(1.0));
        scale = select(c.y_m >= p(2), scale, S(1.0));
        scale = select(c.y_m <= p(3), scale, S(1.0));
        for (int i = 0; i < N; ++i)
            c.mu_drive[i] = c.mu_drive[i] * scale;
    }
};

struct RollerFriction : Effect {
    static constexpr EffectInfo info = {"roller_friction",
                                        "The free rollers resist more than believed.",
                                        "mu_roller + x",
                                        "contact",
                                        "roller bearings",
                                        Scope::kWhole,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"mu", "1", 0.0, -0.2, 0.6, 0.015}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.mu_roller = c.mu_roller + p(0);
    }
};

struct RollerRipple : Effect {
    static constexpr EffectInfo info = {
        "roller_ripple",
        "The drive force ripples as roller follows roller.",
        "f (1 + A sin(rollers wheel angle))",
        "contact",
        "roller gaps; Williams et al. 2002",
        Scope::kWhole,
        kRobot,
        kContact | kByAngle,
        2,
        {{"amplitude", "1", 0.0, -0.9, 0.9, 0.1}, {"rollers", "1", 12.0, 1.0, 60.0, 0.0}}};
    template <class S, int N>
    static void contact(ContactTerm<S, N> &c, const Values<S> &p) {
        using std::sin;
        for (int i = 0; i < N; ++i) {
            const S wheel_angle = c.shaft_angle_rad[i] / c.gear_ratio;
            c.force_scale[i] = c.force_scale[i] * (S(1.0) + p(0) * sin(p(1) * wheel_angle));
        }
    }
};

struct RollingResistance : Effect {
    static constexpr EffectInfo info = {
        "rolling_resistance",
        "The floor resists rolling; the motor does not feel it.",
        "body force -c N tanh(VT / 0.02 m/s) along the drive direction",
        "contact",
        "soft floor",
        Scope::kWhole,
        kRobot,
        kBody,
        1,
        {{"coefficient", "1", 0.0, 0.0, 0.3, 0.01}}};
    template <class S, int N>
    static void body(BodyTerm<S, N> &c, const Values<S> &p) {
        using std::tanh;
        for (int i = 0; i < N; ++i) {
            c.force_along_drive_per_load[i] =
                c.force_along_drive_per_load[i] - p(0) * tanh(c.hub_speed_m_s[i] * S(50.0));
        }
    }
};

/* ----------------------------------------------------------------------------------- body */

struct LoadTransfer : Effect {
    static constexpr EffectInfo info = {"load_transfer",
                                        "Acceleration shifts load between the wheels.",
                                        "N_i = m g / 4 - m h (x_i ax / sum x^2 + y_i ay / sum y^2)",
                                        "body",
                                        "height of the centre of gravity",
                                        Scope::kWhole,
                                        kRobot,
                                        kPrepare,
                                        1,
                                        {{"cog_height_m", "m", 0.0, 0.0, 0.5, 0.08}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.cog_height_m = c.cog_height_m + p(0);
    }
};

struct DiagonalLoadBias : Effect {
    static constexpr EffectInfo info = {
        "diagonal_load_bias",
        "The robot stands on two opposite wheels more than on the others.",
        "N += f (1, -1, 1, -1)",
        "body",
        "four legs on an uneven floor",
        Scope::kWhole,
        kRobot,
        kPrepare,
        1,
        {{"force_n", "N", 0.0, -45.0, 45.0, 6.0}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i) {
            c.load_bias_n[i] = c.load_bias_n[i] + (i % 2 == 0 ? p(0) : -p(0));
        }
    }
};

struct Payload : Effect {
    static constexpr EffectInfo info = {"payload",
                                        "The robot is heavier (or lighter) than believed.",
                                        "m + x at the centre (of a pendulum: at its end)",
                                        "body",
                                        "load, battery",
                                        Scope::kWhole,
                                        kRobot | kAxis,
                                        kPrepare,
                                        1,
                                        {{"mass_kg", "kg", 0.0, -kUnbounded, kUnbounded, 1.2}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.mass_kg = c.mass_kg + p(0);
    }
};

struct InertiaError : Effect {
    static constexpr EffectInfo info = {"inertia_error",
                                        "The robot turns heavier (or lighter) than believed.",
                                        "Iz + x",
                                        "body",
                                        "mass distribution",
                                        Scope::kWhole,
                                        kRobot | kAxis,
                                        kPrepare,
                                        1,
                                        {{"inertia_kg_m2", "kg m^2", 0.0, -0.5, 5.0, 0.06}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.inertia_kg_m2 = c.inertia_kg_m2 + p(0);
    }
};

struct CogOffset : Effect {
    static constexpr EffectInfo info = {
        "cog_offset",
        "The centre of gravity is off the wheel centre.",
        "rigid-body coupling with Iz about the centre of gravity, static wheel loads",
        "body",
        "battery off centre",
        Scope::kWhole,
        kRobot,
        kPrepare,
        2,
        {{"x_m", "m", 0.0, -0.12, 0.12, 0.012}, {"y_m", "m", 0.0, -0.12, 0.12, 0.012}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.cog_x_m = c.cog_x_m + p(0);
        c.cog_y_m = c.cog_y_m + p(1);
    }
};

struct FloorSlope : Effect {
    static constexpr EffectInfo info = {
        "floor_slope",
        "The floor is not level.",
        "constant acceleration in the world frame",
        "body",
        "tilt",
        Scope::kWhole,
        kRobot,
        kBody | kByPlace,
        2,
        {{"x_m_s2", "m/s^2", 0.0, -3.0, 3.0, 0.1}, {"y_m_s2", "m/s^2", 0.0, -3.0, 3.0, 0.1}}};
    template <class S, int N>
    static void body(BodyTerm<S, N> &c, const Values<S> &p) {
        c.acceleration_x_m_s2 = c.acceleration_x_m_s2 + p(0);
        c.acceleration_y_m_s2 = c.acceleration_y_m_s2 + p(1);
    }
};

struct BodyDrag : Effect {
    static constexpr EffectInfo info = {
        "body_drag",
        "A force against the motion of the body, in proportion to its speed.",
        "force -c v",
        "body",
        "skids, cable on the floor",
        Scope::kWhole,
        kRobot,
        kBody,
        1,
        {{"coefficient_n_s_m", "N s/m", 0.0, 0.0, 100.0, 2.0}}};
    template <class S, int N>
    static void body(BodyTerm<S, N> &c, const Values<S> &p) {
        c.force_x_n = c.force_x_n - p(0) * c.vx_m_s;
        c.force_y_n = c.force_y_n - p(0) * c.vy_m_s;
    }
};

struct QuadraticBodyDrag : Effect {
    static constexpr EffectInfo info = {"quadratic_body_drag",
                                        "A force against the motion that grows with speed squared.",
                                        "force -c abs(v) v",
                                        "body",
                                        "air drag",
                                        Scope::kWhole,
                                        kRobot,
                                        kBody,
                                        1,
                                        {{"coefficient", "N s^2/m^2", 0.0, 0.0, 60.0, 2.0}}};
    template <class S, int N>
    static void body(BodyTerm<S, N> &c, const Values<S> &p) {
        using std::sqrt;
        const S speed = sqrt(c.vx_m_s * c.vx_m_s + c.vy_m_s * c.vy_m_s);
        c.force_x_n = c.force_x_n - p(0) * speed * c.vx_m_s;
        c.force_y_n = c.force_y_n - p(0) * speed * c.vy_m_s;
    }
};

struct TetherSpring : Effect {
    static constexpr EffectInfo info = {"tether_spring",
                                        "A cable pulls the robot towards a point of the floor.",
                                        "world-fixed spring, force -k (p - p0)",
                                        "body",
                                        "cable, elastic",
                                        Scope::kWhole,
                                        kRobot,
                                        kBody | kByPlace,
                                        3,
                                        {{"stiffness_n_m", "N/m", 0.0, 0.0, 100.0, 2.0},
                                         {"x_m", "m", 0.0, -20.0, 20.0, 0.0},
                                         {"y_m", "m", 0.0, -20.0, 20.0, 0.0}}};
    template <class S, int N>
    static void body(BodyTerm<S, N> &c, const Values<S> &p) {
        const S world_x = p(0) * (p(1) - c.x_m);
        const S world_y = p(0) * (p(2) - c.y_m);
        c.force_x_n = c.force_x_n + c.cos_theta * world_x + c.sin_theta * world_y;
        c.force_y_n = c.force_y_n - c.sin_theta * world_x + c.cos_theta * world_y;
    }
};

struct YawScrub : Effect {
    static constexpr EffectInfo info = {"yaw_scrub",
                                        "The contact patches resist turning on the spot.",
                                        "torque -T tanh(w / 0.05)",
                                        "body",
                                        "spin friction",
                                        Scope::kWhole,
                                        kRobot,
                                        kBody,
                                        1,
                                        {{"torque_nm", "N m", 0.0, 0.0, 10.0, 0.3}}};
    template <class S, int N>
    static void body(BodyTerm<S, N> &c, const Values<S> &p) {
        using std::tanh;
        c.torque_nm = c.torque_nm - p(0) * tanh(c.omega_rad_s * S(20.0));
    }
};

/* -------------------------------------------------------------------------------- sensors */

struct PoseLatency : Effect {
    static constexpr EffectInfo info = {"pose_latency",
                                        "The camera shows the pose of a moment ago.",
                                        "row shows the pose of t - delay",
                                        "sensor",
                                        "exposure and transport",
                                        Scope::kWhole,
                                        kRobot | kOdometry,
                                        kPrepare,
                                        1,
                                        {{"delay_s", "s", 0.0, -0.05, 0.5, 0.01}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.pose_delay_s = p(0);
    }
};

struct PoseRotation : Effect {
    static constexpr EffectInfo info = {"pose_rotation",
                                        "The camera's axes are turned against the robot's world.",
                                        "measured (x, y) = Rot(+a) true (x, y), theta unchanged",
                                        "sensor",
                                        "camera mounting",
                                        Scope::kWhole,
                                        kRobot | kOdometry,
                                        kSensor,
                                        1,
                                        {{"angle_rad", "rad", 0.0, -kPi, kPi, 0.02}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        using std::cos;
        using std::sin;
        const S x = c.x_m;
        c.x_m = cos(p(0)) * x - sin(p(0)) * c.y_m;
        c.y_m = sin(p(0)) * x + cos(p(0)) * c.y_m;
    }
};

struct MarkerOffset : Effect {
    static constexpr EffectInfo info = {
        "marker_offset",
        "What the camera follows sits off the robot's centre.",
        "measured (x, y) = true (x, y) + Rot(theta) (x_m, y_m)",
        "sensor",
        "mounting of the markers",
        Scope::kWhole,
        kOdometry,
        kSensor,
        2,
        {{"x_m", "m", 0.0, -0.5, 0.5, 0.01}, {"y_m", "m", 0.0, -0.5, 0.5, 0.01}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        using std::cos;
        using std::sin;
        const S cosine = cos(c.theta_rad), sine = sin(c.theta_rad);
        c.x_m = c.x_m + cosine * p(0) - sine * p(1);
        c.y_m = c.y_m + sine * p(0) + cosine * p(1);
    }
};

struct HeadingOffset : Effect {
    static constexpr EffectInfo info = {"heading_offset",
                                        "The camera's forward is not the robot's forward.",
                                        "measured theta = true theta + angle",
                                        "sensor",
                                        "mounting of the markers",
                                        Scope::kWhole,
                                        kOdometry,
                                        kSensor,
                                        1,
                                        {{"angle_rad", "rad", 0.0, -0.5, 0.5, 0.01}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        c.theta_rad = c.theta_rad + p(0);
    }
};

struct ClockSkew : Effect {
    static constexpr EffectInfo info = {"clock_skew",
                                        "The camera's clock runs fast against the log's.",
                                        "row at t shows the pose of t (1 - fraction)",
                                        "sensor",
                                        "unsynchronised clocks",
                                        Scope::kWhole,
                                        kRobot | kOdometry,
                                        kPrepare,
                                        1,
                                        {{"fraction", "1", 0.0, -0.05, 0.05, 0.003}}};
    template <class S, int N>
    static void prepare(Constants<S, N> &c, const Values<S> &p) {
        c.clock_fraction = p(0);
    }
};

struct GyroBias : Effect {
    static constexpr EffectInfo info = {"gyro_bias",
                                        "The gyro shows a turn at rest.",
                                        "measured = true + bias",
                                        "sensor",
                                        "zero-rate offset",
                                        Scope::kWhole,
                                        kRobot,
                                        kSensor,
                                        1,
                                        {{"rate_rad_s", "rad/s", 0.0, -1.0, 1.0, 0.005}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        c.gyro_rad_s = c.gyro_rad_s + p(0);
    }
};

struct GyroScale : Effect {
    static constexpr EffectInfo info = {"gyro_scale",
                                        "The gyro shows too much or too little.",
                                        "measured = scale true",
                                        "sensor",
                                        "scale factor",
                                        Scope::kWhole,
                                        kRobot,
                                        kSensor,
                                        1,
                                        {{"scale", "1", 1.0, 0.5, 1.5, 0.01}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        c.gyro_rad_s = c.gyro_rad_s * p(0);
    }
};

struct EncoderScale : Effect {
    static constexpr EffectInfo info = {"encoder_scale",
                                        "An encoder gives another number of counts per turn.",
                                        "counts times scale",
                                        "sensor",
                                        "wrong disc or setting",
                                        Scope::kCommonOrSingle,
                                        kRobot | kOdometry,
                                        kSensor | kCounts,
                                        1,
                                        {{"scale", "1", 1.0, 0.3, 3.0, 0.02}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        for (int i = 0; i < N; ++i)
            c.encoder_rate[i] = c.encoder_rate[i] * p(0, i);
    }
};

struct EncoderDropout : Effect {
    static constexpr EffectInfo info = {"encoder_dropout",
                                        "An encoder loses counts above a speed.",
                                        "share of counts lost above the speed",
                                        "sensor",
                                        "bandwidth of encoder or counter",
                                        Scope::kSingle,
                                        kRobot | kOdometry,
                                        kSensor | kCounts | kCounted,
                                        2,
                                        {{"fraction", "1", 0.0, 0.0, 1.0, 0.05},
                                         {"speed_rad_s", "rad/s", 150.0, 0.0, 2000.0, 0.0}}};
    template <class S, int N>
    static void sensor(SensorTerm<S, N> &c, const Values<S> &p) {
        using std::abs;
        for (int i = 0; i < N; ++i) {
            const S kept = select(abs(c.speed_rad_s[i]) > p(1, i), S(1.0) - p(0, i), S(1.0));
            c.encoder_rate[i] = c.encoder_rate[i] * kept;
        }
    }
    /* The other way round. A wheel just above the speed counts as a slower one below it: between
     * the two the other wheels tell, or the rates are parted in the middle. */
    template <class S, int N>
    static void counted(CountedTerm<S, N> &c, const Values<S> &p) {
        using std::abs;
        const S one(1.0), half(0.5), least_kept(0.01);
        for (int i = 0; i < N; ++i) {
            const S kept = select(p(0, i) < one - least_kept, one - p(0, i), least_kept);
            const S shown = abs(c.rate_rad_s[i]), told = abs(c.told_rad_s[i]);
            const S amid = select(shown > half * (one + kept) * p(1, i), kept, one);
            const S nearer = select(told > half * (shown + shown / kept), kept, one);
            const S either = select(told == told, nearer, amid);
            const S slow_or_either = select(shown > kept * p(1, i), either, one);
            c.rate_rad_s[i] = c.rate_rad_s[i] / select(shown > p(1, i), kept, slow_or_either);
        }
    }
};

/* ------------------------------------------------------------------- motion against encoders */

struct LateralSlip : Effect {
    static constexpr EffectInfo info = {
        "lateral_slip",
        "Moving sideways the body falls short of what the encoders claim.",
        "body vy times (1 - fraction)",
        "contact",
        "rollers that give way under side load",
        Scope::kWhole,
        kOdometry,
        kMotion,
        1,
        {{"fraction", "1", 0.0, -0.3, 0.5, 0.02}}};
    template <class S>
    static void motion(MotionTerm<S> &c, const Values<S> &p) {
        c.vy_m_s = c.vy_m_s * (S(1.0) - p(0));
    }
};

struct TurningLoss : Effect {
    static constexpr EffectInfo info = {"turning_loss",
                                        "Turning, the body falls short of what the encoders claim.",
                                        "body w times (1 - fraction)",
                                        "contact",
                                        "spin friction of the contact patches",
                                        Scope::kWhole,
                                        kOdometry,
                                        kMotion,
                                        1,
                                        {{"fraction", "1", 0.0, -0.3, 0.5, 0.02}}};
    template <class S>
    static void motion(MotionTerm<S> &c, const Values<S> &p) {
        c.omega_rad_s = c.omega_rad_s * (S(1.0) - p(0));
    }
};

using Catalogue = std::tuple<
    SupplySag, StateOfChargeDrift, DeadZone, DriverNonlinearity, ActuationDelay, DriverLag,
    ArmatureInductance, WindingHeating, CurrentLimit, DriverFreewheel, WeakMotor,
    TorqueConstantError, MotorInertiaError, ViscousFrictionError, CoulombFriction,
    AsymmetricFriction, StribeckFriction, LoadDependentFriction, QuadraticWheelDrag, OneWheelDrag,
    Cogging, GearBacklash, ShaftCompliance, ForceOffset, WheelRadiusError, WheelEccentricity,
    WheelAngleError, WheelDistanceError, LowGrip, UnevenGrip, SlipStiffnessError, GripFalloff,
    GripDrift, ContactShape, BristleRelaxation, CarpetAnisotropy, SlipperyPatch, RollerFriction,
    RollerRipple, RollingResistance, LoadTransfer, DiagonalLoadBias, Payload, InertiaError,
    CogOffset, FloorSlope, BodyDrag, QuadraticBodyDrag, TetherSpring, YawScrub, PoseLatency,
    ClockSkew, MarkerOffset, PoseRotation, GyroBias, GyroScale, EncoderScale, EncoderDropout,
    PendulumZeroError, LateralSlip, TurningLoss, HeadingOffset>;

constexpr int kEffectCount = static_cast<int>(std::tuple_size<Catalogue>::value);

constexpr int effect_stride(const EffectInfo &info, int motors) {
    return info.scope == Scope::kWhole ? 1 : motors;
}

/* Calls `action(effect, index, slot)` for every effect; slot = place of its first parameter among
 * all effect parameters of a plant with `motors` motors. Unrolled by the compiler. */
template <int Index = 0, class Action>
inline void for_each_effect(int motors, Action &&action, int slot = 0) {
    if constexpr (Index < kEffectCount) {
        using E = std::tuple_element_t<Index, Catalogue>;
        action(E{}, Index, slot);
        for_each_effect<Index + 1>(motors, action,
                                   slot + E::info.parameter_count * effect_stride(E::info, motors));
    }
}

inline int effect_slot_count(int motors) {
    int count = 0;
    for_each_effect(motors, [&](auto effect, int, int slot) {
        count = slot + decltype(effect)::info.parameter_count *
                           effect_stride(decltype(effect)::info, motors);
    });
    return count;
}

/* `active`: one flag per effect, up where one of `count` parameter sets of `size` values differs
 * from neutral. */
template <class Plant>
void mark_active(const double *values, int count, int size, bool *active) {
    for_each_effect(Plant::kMotors, [&](auto effect, int index, int slot) {
        using E = decltype(effect);
        const int stride = effect_stride(E::info, Plant::kMotors);
        active[index] = false;
        for (int s = 0; s < count; ++s) {
            const double *own = values + static_cast<long>(s) * size + Plant::kBase + slot;
            for (int k = 0; k < E::info.parameter_count * stride; ++k)
                active[index] = active[index] || own[k] != E::info.parameters[k / stride].neutral;
        }
    });
}

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
