/* robot_plant.h - the four-wheeled robot with slip: seven degrees of freedom, eqs. (6)-(13).
 *
 * State x (14): W_i shaft speed [rad/s], a_i encoder angle [rad], i = 1..4; body velocity of the
 * wheel centre (vx, vy, w) in the body frame; world pose (x, y, theta). Behind it the memory (28)
 * of memory.h, per wheel: duty that has left the driver, armature current, heat of the winding,
 * share of the grip that the bristles hold, slack (wheel speed - W / n) and twist of a soft gear,
 * angle that an encoder does not show.
 *
 *   bus       V = V0 - r sum(i_j d_j)                          (r = 0: V = V0)
 *   current   i = (d V - k3 W) / Ra                                                     (8)
 *   shaft     J0 dW/dt = k2 i - b0 W + effects - (R/n) fT                                (7)
 *   contact   s = R W / n - VT;  fT = N mu_T (2/pi) atan(k s)                           (13)
 *             fF = -N mu_F (2/pi) atan(k VF)
 *             VT, VF: hub velocity along the drive direction d_i and roller direction r_i
 *   body      m (a_O + w' x c - w^2 c) = sum(fT d_i + fF r_i) + external force           (4)
 *             Iz w' = moment about the centre of gravity c
 *             dvx/dt = a_Ox + w vy,  dvy/dt = a_Oy - w vx
 *   world     (x, y)' = T(theta) (vx, vy), theta' = w                                    (2)
 *
 * Loads: N_i = m g / 4 + m g (x_i cx / sum x^2 + y_i cy / sum y^2) + diagonal bias
 *              - m h (x_i ax / sum x^2 + y_i ay / sum y^2)
 * (minimum-norm balance of four legs). With h > 0 the load depends on the acceleration and the
 * acceleration on the load; both are linear, so a 2 x 2 system is solved instead of iterating.
 * Four legs leave the pattern n = (1, -1, 1, -1) free: where a wheel would pull at the floor, N
 * moves along n until that wheel carries nothing, and the others balance the robot. Where one of
 * each sign would pull, no n helps: the robot tips, which the plant does not follow, and those
 * wheels carry nothing.
 *
 * Effects enter through the hooks of effects.h; an effect at its neutral value is never called.
 */
#ifndef OMNISLIP_SIM_ROBOT_PLANT_H
#define OMNISLIP_SIM_ROBOT_PLANT_H

#include <cmath>

#include "active_effects.h"
#include "memory.h"
#include "user_terms.h"

namespace omnislip {

struct BaseParameter {
    const char *name;
    const char *unit;
    double value;
};

/* The believed robot: keys of robot.toml with the nominal robot's values. */
constexpr BaseParameter kRobotBase[] = {
    {"robot.mass_kg", "kg", 20.0},
    {"robot.inertia_kg_m2", "kg m^2", 0.55},
    {"robot.wheel_radius_m", "m", 0.05},
    {"robot.wheel_distance_m", "m", 0.20},
    {"robot.wheel_angles_deg[0]", "deg", 30.0},
    {"robot.wheel_angles_deg[1]", "deg", 150.0},
    {"robot.wheel_angles_deg[2]", "deg", 210.0},
    {"robot.wheel_angles_deg[3]", "deg", 330.0},
    {"motor.resistance_ohm", "ohm", 0.6},
    {"motor.torque_constant_nm_a", "N m/A", 0.0255},
    {"motor.back_emf_constant_v_s_rad", "V s/rad", 0.0255},
    {"motor.gear_ratio", "1", 12.0},
    {"motor.inertia_kg_m2", "kg m^2", 2.5e-5},
    {"motor.viscous_friction_nm_s", "N m s", 1.5e-5},
    {"motor.supply_v", "V", 24.0},
    {"contact.mu_drive", "1", 0.6},
    {"contact.mu_roller", "1", 0.05},
    {"contact.slip_stiffness_s_m", "s/m", 40.0},
    {"contact.gravity_m_s2", "m/s^2", 9.81},
    {"encoder.counts_per_rev", "1", 2000.0},
};

struct RobotLayout {
    static constexpr int kMotors = 4;
    static constexpr int kStates = 14;
    static constexpr int kStatesInLots = 8;   /* speeds and angles, see integrator.h */
    static constexpr int kAll = kStates + 28; /* with memory */
    static constexpr int kOutputs = 8;        /* encoder angles 4, gyro, x, y, theta */
    static constexpr int kBase = static_cast<int>(sizeof(kRobotBase) / sizeof(kRobotBase[0]));
    static constexpr Kind kKind = kRobot;
    static constexpr double kCommandJump = 0.05; /* duty */
    enum StateIndex { kSpeed = 0, kAngle = 4, kVelocity = 8, kPose = 11 };
    enum MemoryIndex {
        kDrivenDuty = 14,
        kCoilCurrent = 18,
        kHeat = 22,
        kGrip = 26,
        kSlack = 30,
        kTwist = 34,
        kUnshown = 38
    };
};

/* What the plant does inside a step, for logs, pictures and tests. */
template <class S>
struct RobotInternals {
    S bus_v;
    S conductance_s[4]; /* of the armatures, 1 / Ra */
    S current_a[4], motor_torque_nm[4], friction_torque_nm[4];
    S load_n[4], slip_m_s[4], drive_force_n[4], roller_force_n[4], roller_speed_m_s[4];
    S hub_speed_m_s[4];
    S external_force_x_n, external_force_y_n, external_torque_nm;
};

inline namespace OMNISLIP_INSTRUCTION_SET {

/* What stays during one step: the duty on average over it, a heading from which the robot turns
 * little; of the memory how lags relax. */
template <class S>
struct RobotStep {
    S duty[4];
    NearbyAngle<S> heading;
    /* only with memory: */
    double length_s, inverse_s; /* inverse 0 for an instant, in which memory stands still */
    S current_a[4], grip[4];    /* at the begin */
    S duty_rate_1_s[4];
    S coil_gained[4], coil_left[4];
};

template <class S>
class RobotPlant : public RobotLayout {
    using Lot = typename LotOf<S>::Type;
    static constexpr int kLot = LotOf<S>::kWheels;
    static constexpr double kCreep_m_s = 0.02; /* a contact at rest settles all the same */
    static constexpr double kFreeLoad[4] = {1.0, -1.0, 1.0, -1.0}; /* which four legs leave free */

  public:
    using Step = RobotStep<S>;

    /* `flat`: base parameters, effect slots, parameters of the user's terms; `active`: one flag per
     * effect; the terms must outlive the plant. */
    void prepare(const S *flat, const bool *active, const UserTermList &terms = {}) {
        load_base(flat);
        active_.prepare(flat + kBase, active, c_);
        active_.add_hooks(user_.prepare(terms, flat + kBase + effect_slot_count(kMotors)));
        derive_geometry();
        derive_reciprocals();
        derive_memory();
    }

    /* Duty as it leaves a driver without memory. */
    void command(const S *duty, S *driven) const {
        CommandTerm<S, 4> term;
        for (int i = 0; i < 4; ++i)
            term.duty[i] = duty[i];
        active_.apply(kCommand, [&](auto effect, const Values<S> &values) {
            decltype(effect)::command(term, values);
        });
        for (int i = 0; i < 4; ++i)
            driven[i] = term.duty[i];
        if (active_.use(kCommand)) {
            UserInputs<S> inputs;
            inputs.at[kInD] = term.duty;
            user_.add(UserTarget::kDuty, inputs, 4, driven);
        }
    }

    /* Driver and armature over a step from x [kAll] under a constant duty. */
    void begin_step(const S *x, const S *duty, double length_s, Step &step) const {
        command(duty, step.duty);
        step.heading.follow(x[kPose + 2]);
        if (remembers_)
            recall(x, length_s, step);
    }

    /* Warms the windings of x by n rows before; resistance times 1 + h lets 1 / (1 + h) through. */
    void warm(const double *length_s, const double *cold_current_a2, std::size_t n, S *x) const {
        using std::exp;
        for (std::size_t k = 0; heats_ && k < n; ++k) {
            for (int i = 0; i < 4; ++i) {
                const S &cools_s = c_.cooling_time_s[i], kept = exp(S(-length_s[k]) / cools_s);
                S &heat = x[kHeat + i];
                const S through = S(1.0) / (S(1.0) + c_.heating_1_a2_s[i] * heat);
                const S heating = S(cold_current_a2[4 * k + i]) * through * through;
                heat = kept * heat + (S(1.0) - kept) * cools_s * heating;
            }
        }
    }

    /* dx [kStates], with memory [kAll]. */
    void derivative(const S *x, const Step &step, const S &time_s, S *dx,
                    RobotInternals<S> &in) const {
        const S &vx = x[kVelocity];
        const S &vy = x[kVelocity + 1];
        const S &omega = x[kVelocity + 2];
        motor(x, step, time_s, in);
        S traction_per_load[4]; /* fT / N */
        S radius_m[4];
        S grip_rate[4];
        contact(x, step, time_s, in, traction_per_load, radius_m, grip_rate);
        S cos_theta, sin_theta;
        step.heading(x[kPose + 2], sin_theta, cos_theta);
        BodyTerm<S, 4> external = outside(x, time_s, cos_theta, sin_theta, in);
        body(x, in, traction_per_load, external, dx);

        const Lot per_gear_ratio(per_gear_ratio_);
        for (int i = 0; i < 4; i += kLot) {
            const Lot road_nm = per_gear_ratio * lot(radius_m + i) * lot(in.drive_force_n + i);
            const Lot own_nm = lot(in.motor_torque_nm + i) + lot(in.friction_torque_nm + i);
            put((own_nm - road_nm) * lot(per_shaft_inertia_ + i), dx + kSpeed + i);
            put(lot(x + kSpeed + i), dx + kAngle + i);
        }
        if (remembers_)
            memorise(x, step, in, radius_m, grip_rate, dx);
        if (active_.use(kCounts))
            count(x, step, dx);
        dx[kPose] = cos_theta * vx - sin_theta * vy;
        dx[kPose + 1] = sin_theta * vx + cos_theta * vy;
        dx[kPose + 2] = omega;
    }

    /* What the sensors show in state x: encoder angles [rad], gyro [rad/s], camera pose.
     * `way_since`: what the body went since the moment that a late camera shows (memory.h), x, y,
     * theta; null: as far as at its present velocity. */
    void output(const S *x, const S &time_s, S *y, const S *way_since = nullptr) const {
        for (int i = 0; i < 4; ++i)
            y[i] = x[kAngle + i];
        if (!active_.use(kSensor) && !shows_late_) {
            y[4] = x[kVelocity + 2];
            for (int i = 0; i < 3; ++i)
                y[5 + i] = x[kPose + i];
            return;
        }
        const SensorTerm<S, 4> term = sensors(x, time_s, way_since);
        y[4] = term.gyro_rad_s;
        y[5] = term.x_m;
        y[6] = term.y_m;
        y[7] = term.theta_rad;
    }

    /* Bound on the fastest rate of the linearised plant [1/s]; the step is chosen from it. */
    double fastest_rate_1_s() const {
        using std::max;
        using std::min;
        S rate = S(0.0);
        const S stiffness = S(2.0 / kPi) * c_.slip_stiffness_s_m;
        for (int i = 0; i < 4; ++i) {
            const S damping = static_load_n_[i] * c_.mu_drive[i] * stiffness;
            const S ratio = c_.wheel_radius_m[i] / c_.gear_ratio;
            const S motor =
                c_.torque_constant_nm_a[i] * c_.back_emf_constant_v_s_rad[i] / c_.resistance_ohm +
                c_.viscous_friction_nm_s[i] + shaft_damping_[i];
            const S per_inertia = S(1.0) / c_.shaft_inertia_kg_m2[i];
            const S &lever = c_.wheel_distance_m;
            const S body =
                S(4.0) * damping * max(S(1.0) / c_.mass_kg, lever * lever / c_.inertia_kg_m2);
            const S shaft =
                gear_[i].rate_1_s(motor * per_inertia, damping * ratio * ratio * per_inertia);
            rate = max(rate, shaft + body);
            const S rolling = c_.ripple_per_rad[i] * c_.supply_v / c_.back_emf_constant_v_s_rad[i];
            const S ripple =
                ripple_rate_1_s(c_.ripple_nm[i], c_.shaft_inertia_kg_m2[i], least_way_rad(c_));
            rate = max(rate, S(kRatePerRipple) * min(ripple, rolling));
        }
        double worst = 0.0;
        for (int i = 0; i < LaneCount<S>::value; ++i)
            worst = std::max(worst, lane(rate, i));
        return worst;
    }

    const Constants<S, 4> &constants() const {
        return c_;
    }
    /* Whether the memory behind the states is in use, and whether commands act late. */
    bool remembers() const {
        return remembers_;
    }
    const MemoryPlaces<kAll - kStates> &memory() const {
        return memory_;
    }
    bool delays() const {
        return delays_;
    }
    bool has_bristles() const {
        return bristles_;
    }
    /* Whether all gears are springs, without play. */
    bool has_springs() const {
        return springs_;
    }
    /* Whether the camera shows the pose of another moment than the row's, and how late. */
    bool shows_late() const {
        return shows_late_;
    }
    S late_s(const S &time_s) const {
        return c_.pose_delay_s + c_.clock_fraction * time_s;
    }

  private:
    void load_base(const S *p) {
        c_.mass_kg = p[0];
        c_.inertia_kg_m2 = p[1];
        c_.wheel_distance_m = p[3];
        c_.resistance_ohm = p[8];
        c_.gear_ratio = p[11];
        c_.supply_v = p[14];
        c_.mu_roller = p[16];
        c_.slip_stiffness_s_m = p[17];
        c_.gravity_m_s2 = p[18];
        c_.cog_x_m = c_.cog_y_m = c_.cog_height_m = S(0.0);
        c_.source_resistance_ohm = S(0.0);
        c_.friction_speed = S(2.0);
        forget(c_);
        for (int i = 0; i < 4; ++i) {
            c_.wheel_radius_m[i] = p[2];
            c_.wheel_angle_rad[i] = p[4 + i] * S(kPi / 180.0);
            c_.roller_angle_offset_rad[i] = S(0.0);
            c_.torque_constant_nm_a[i] = p[9];
            c_.back_emf_constant_v_s_rad[i] = p[10];
            c_.shaft_inertia_kg_m2[i] = p[12];
            c_.viscous_friction_nm_s[i] = p[13];
            c_.mu_drive[i] = p[15];
            c_.load_bias_n[i] = S(0.0);
        }
    }

    void derive_geometry() {
        using std::cos;
        using std::sin;
        S sum_xx = S(0.0), sum_yy = S(0.0);
        for (int i = 0; i < 4; ++i) {
            wheel_x_[i] = c_.wheel_distance_m * cos(c_.wheel_angle_rad[i]);
            wheel_y_[i] = c_.wheel_distance_m * sin(c_.wheel_angle_rad[i]);
            sum_xx = sum_xx + wheel_x_[i] * wheel_x_[i];
            sum_yy = sum_yy + wheel_y_[i] * wheel_y_[i];
            const S direction = c_.wheel_angle_rad[i] + c_.roller_angle_offset_rad[i];
            drive_x_[i] = -sin(direction);
            drive_y_[i] = cos(direction);
            drive_lever_[i] = wheel_x_[i] * drive_y_[i] - wheel_y_[i] * drive_x_[i];
            roller_lever_[i] = wheel_x_[i] * -drive_x_[i] - wheel_y_[i] * drive_y_[i];
        }
        const S weight = c_.mass_kg * c_.gravity_m_s2;
        for (int i = 0; i < 4; ++i) {
            leg_x_[i] = wheel_x_[i] / sum_xx;
            leg_y_[i] = wheel_y_[i] / sum_yy;
            const S share = S(0.25) + leg_x_[i] * c_.cog_x_m + leg_y_[i] * c_.cog_y_m;
            static_load_n_[i] = weight * share + c_.load_bias_n[i];
            shaft_damping_[i] = S(0.0);
        }
        estimate_shaft_damping();
        load_moves_ = any_differs(&c_.cog_height_m, 1, 0.0);
        if (!load_moves_)
            rest_on_the_floor(static_load_n_, kFreeLoad);
        off_centre_ = any_differs(&c_.cog_x_m, 1, 0.0) || any_differs(&c_.cog_y_m, 1, 0.0);
        bus_sags_ = any_differs(&c_.source_resistance_ohm, 1, 0.0);
    }

    /* Divisions take as long as the rest of a step. */
    void derive_reciprocals() {
        per_mass_ = S(1.0) / c_.mass_kg;
        per_inertia_ = S(1.0) / c_.inertia_kg_m2;
        per_gear_ratio_ = S(1.0) / c_.gear_ratio;
        conductance_s_ = S(1.0) / c_.resistance_ohm;
        for (int i = 0; i < 4; ++i)
            per_shaft_inertia_[i] = S(1.0) / c_.shaft_inertia_kg_m2[i];
    }

    void derive_memory() {
        for (int i = 0; i < 4; ++i)
            gear_[i].prepare(c_, i, c_.shaft_inertia_kg_m2[i] * c_.gear_ratio * c_.gear_ratio);
        delays_ = any_differs(c_.delay_s, 4, 0.0);
        shows_late_ =
            any_lane_differs(c_.pose_delay_s, 0.0) || any_lane_differs(c_.clock_fraction, 0.0);
        inductive_ = any_differs(c_.inductance_h, 4, 0.0);
        bristles_ = any_differs(c_.bristle_length_m, 4, 0.0);
        slip_lags_ = bristles_ && any_differs(c_.slip_lags, 4, 0.0);
        const bool plays = any_differs(c_.play_rad, 4, 0.0);
        springs_ = any_differs(c_.stiffness_nm_rad, 4, kUnbounded) && !plays;
        soft_ = springs_ || plays;
        heats_ = any_differs(c_.heating_1_a2_s, 4, 0.0);
        lags_ = any_differs(c_.driver_lag_s, 4, 0.0);
        memory_.clear();
        remember(lags_, kDrivenDuty);
        remember(inductive_, kCoilCurrent);
        remember(heats_, kHeat);
        remember(bristles_, kGrip);
        remember(soft_, kSlack);
        remember(soft_, kTwist);
        unshown_ = active_.use(kByAngle) && active_.use(kCounts);
        remember(unshown_, kUnshown);
        remembers_ = memory_.begin() != memory_.end();
        for (int i = 0; i < 4; ++i) {
            per_driver_lag_s_[i] = Relaxation<S>::per(c_.driver_lag_s[i]);
            per_bristle_m_[i] = Relaxation<S>::per(c_.bristle_length_m[i]);
        }
    }

    void remember(bool used, int first) {
        if (used)
            memory_.add(first, 4);
    }

    /* The part of begin_step that needs the memory. */
    void recall(const S *x, double length_s, Step &step) const {
        step.length_s = length_s;
        step.inverse_s = length_s > 0.0 ? 1.0 / length_s : 0.0;
        for (int i = 0; lags_ && i < 4; ++i) {
            const auto driver = Relaxation<S>::over(S(length_s), per_driver_lag_s_[i]);
            const S ahead = step.duty[i] - x[kDrivenDuty + i];
            step.duty_rate_1_s[i] = driver.gained * S(step.inverse_s) * ahead;
            step.duty[i] = step.duty[i] - driver.left * ahead;
        }
        if (inductive_)
            recall_currents(x, length_s, step);
        for (int i = 0; bristles_ && i < 4; ++i)
            step.grip[i] = x[kGrip + i];
    }

    void recall_currents(const S *x, double length_s, Step &step) const {
        S conductance_s[4];
        for (int i = 0; i < 4; i += kLot)
            put(warm_conductance_s(x, i), conductance_s + i);
        for (int i = 0; i < 4; ++i) {
            const S constant_s = c_.inductance_h[i] * conductance_s[i];
            const auto coil = Relaxation<S>::over(S(length_s), Relaxation<S>::per(constant_s));
            step.coil_gained[i] = coil.gained;
            step.coil_left[i] = coil.left;
            step.current_a[i] = x[kCoilCurrent + i];
        }
    }

    /* of the armatures from i on */
    Lot warm_conductance_s(const S *x, int i) const {
        const Lot cold_s(conductance_s_);
        if (!heats_)
            return cold_s;
        return cold_s / (Lot(S(1.0)) + lot(c_.heating_1_a2_s + i) * lot(x + kHeat + i));
    }

    /* Derivatives of the memory, and of the shafts where a gear is soft. */
    void memorise(const S *x, const Step &step, const RobotInternals<S> &in, const S *radius_m,
                  const S *grip_rate, S *dx) const {
        for (int i = 0; lags_ && i < 4; ++i)
            dx[kDrivenDuty + i] = step.duty_rate_1_s[i];
        for (int i = 0; inductive_ && i < 4; i += kLot) {
            const Lot behind_a =
                steady_current_a(i, x + kSpeed, step, in) - lot(step.current_a + i);
            put(lot(step.coil_gained + i) * Lot(S(step.inverse_s)) * behind_a,
                dx + kCoilCurrent + i);
        }
        for (int i = 0; heats_ && i < 4; ++i) {
            const S heating =
                in.current_a[i] * in.current_a[i] - x[kHeat + i] / c_.cooling_time_s[i];
            dx[kHeat + i] = step.length_s == kForever_s ? S(0.0) : heating;
        }
        for (int i = 0; bristles_ && i < 4; ++i)
            dx[kGrip + i] = grip_rate[i];
        for (int i = 0; soft_ && i < 4; ++i)
            twist_gear(i, x, step, in, radius_m[i] * in.drive_force_n[i], dx);
    }

    void twist_gear(int i, const S *x, const Step &step, const RobotInternals<S> &in,
                    const S &road_nm, S *dx) const {
        const S motor_nm = c_.gear_ratio * (in.motor_torque_nm[i] + in.friction_torque_nm[i]);
        S acceleration;
        if (step.length_s == kForever_s) {
            dx[kTwist + i] =
                gear_[i].settled_twist(motor_nm, road_nm, acceleration) * S(step.inverse_s);
            dx[kSlack + i] = S(0.0);
        } else {
            gear_[i].accelerate(motor_nm, road_nm, x[kTwist + i], x[kSlack + i], acceleration,
                                dx[kSlack + i]);
            dx[kTwist + i] = -x[kSlack + i];
        }
        dx[kSpeed + i] = c_.gear_ratio * acceleration;
    }

    /* Slope of the effects' shaft torques at standstill: the stiffness of smoothed dry friction. */
    void estimate_shaft_damping() {
        if (!active_.use(kShaft))
            return;
        const S probe = S(1e-3) * c_.friction_speed;
        S speed[4], angle[4], torque[4];
        for (int i = 0; i < 4; ++i) {
            speed[i] = probe;
            angle[i] = S(0.0);
            torque[i] = c_.torque_constant_nm_a[i] * c_.supply_v / c_.resistance_ohm;
        }
        const S start_s = S(0.0);
        const ShaftTerm<S, 4> moving = friction(speed, angle, torque, start_s);
        for (int i = 0; i < 4; ++i)
            speed[i] = S(0.0);
        const ShaftTerm<S, 4> still = friction(speed, angle, torque, start_s);
        using std::max;
        for (int i = 0; i < 4; ++i) {
            shaft_damping_[i] = max((still.torque_nm[i] - moving.torque_nm[i]) / probe, S(0.0));
        }
    }

    ShaftTerm<S, 4> friction(const S *speed, const S *angle, const S *motor_torque,
                             const S &time_s) const {
        using std::tanh;
        ShaftTerm<S, 4> term;
        term.speed_rad_s = speed;
        term.angle_rad = angle;
        term.motor_torque_nm = motor_torque;
        term.inertia_kg_m2 = c_.shaft_inertia_kg_m2;
        term.least_way_rad = least_way_rad(c_);
        for (int i = 0; i < 4; ++i) {
            term.torque_nm[i] = S(0.0);
            term.sign[i] = tanh(speed[i] / c_.friction_speed);
        }
        active_.apply(kShaft, [&](auto effect, const Values<S> &values) {
            decltype(effect)::shaft(term, values);
        });
        UserInputs<S> inputs;
        inputs.at[kInW] = speed;
        inputs.at[kInThM] = angle;
        inputs.at[kInTau] = motor_torque;
        inputs.at[kInT] = &time_s;
        user_.add(UserTarget::kShaftTorque, inputs, 4, term.torque_nm);
        return term;
    }

    /* Bus voltage, currents (8) and shaft torques (7). */
    void motor(const S *x, const Step &step, const S &time_s, RobotInternals<S> &in) const {
        const S *speed = x + kSpeed;
        SupplyTerm<S> supply{c_.supply_v, time_s};
        active_.apply(kSupply, [&](auto effect, const Values<S> &values) {
            decltype(effect)::supply(supply, values);
        });
        if (active_.use(kSupply)) {
            UserInputs<S> inputs;
            inputs.at[kInT] = &time_s;
            user_.add(UserTarget::kSupply, inputs, 1, &supply.open_circuit_v);
        }
        for (int i = 0; i < 4; i += kLot)
            put(warm_conductance_s(x, i), in.conductance_s + i);
        balance_bus(speed, step, supply.open_circuit_v, in);
        for (int i = 0; i < 4; i += kLot) {
            put(lot(c_.torque_constant_nm_a + i) * lot(in.current_a + i), in.motor_torque_nm + i);
            put(-lot(c_.viscous_friction_nm_s + i) * lot(speed + i), in.friction_torque_nm + i);
        }
        if (active_.use(kShaft)) {
            S room[4];
            const S *angle = shaft_angles(x, room);
            const ShaftTerm<S, 4> term = friction(speed, angle, in.motor_torque_nm, time_s);
            for (int i = 0; i < 4; ++i) {
                in.friction_torque_nm[i] = in.friction_torque_nm[i] + term.torque_nm[i];
            }
        }
    }

    /* V = V0 - r sum(i d). With i linear in V the balance has a closed form. A limit or a
     * freewheeling driver bends i(V) at corners: Newton's method with the slope of the piece. */
    void balance_bus(const S *speed, const Step &step, const S &open_circuit_v,
                     RobotInternals<S> &in) const {
        const S &r = c_.source_resistance_ohm;
        const S *driven = step.duty;
        in.bus_v = open_circuit_v;
        if (bus_sags_) {
            S conductance = S(0.0), returned = S(0.0);
            for (int i = 0; i < 4; ++i) {
                S through = driven[i] * in.conductance_s[i];
                if (inductive_) {
                    through = through * (S(1.0) - step.coil_left[i]);
                    returned = returned - driven[i] * step.coil_left[i] * step.current_a[i];
                }
                conductance = conductance + driven[i] * through;
                returned = returned + through * c_.back_emf_constant_v_s_rad[i] * speed[i];
            }
            in.bus_v = (open_circuit_v + r * returned) / (S(1.0) + r * conductance);
        }
        armature(speed, step, in);
        if (!active_.use(kCurrent))
            return;
        limit_currents(speed, driven, in);
        if (!bus_sags_)
            return;
        for (int pass = 0; pass < 4; ++pass) {
            const S probe_v = S(1e-3), bus_v = in.bus_v;
            const S drawn = drawn_current(driven, in);
            in.bus_v = bus_v + probe_v;
            armature(speed, step, in);
            limit_currents(speed, driven, in);
            const S slope = (drawn_current(driven, in) - drawn) / probe_v;
            in.bus_v = bus_v + (open_circuit_v - r * drawn - bus_v) / (S(1.0) + r * slope);
            armature(speed, step, in);
            limit_currents(speed, driven, in);
        }
    }

    static S drawn_current(const S *driven, const RobotInternals<S> &in) {
        S drawn = S(0.0);
        for (int i = 0; i < 4; ++i)
            drawn = drawn + in.current_a[i] * driven[i];
        return drawn;
    }

    void armature(const S *speed, const Step &step, RobotInternals<S> &in) const {
        for (int i = 0; i < 4; i += kLot) {
            const Lot steady_a = steady_current_a(i, speed, step, in);
            if (inductive_) {
                const Lot behind_a = lot(step.current_a + i) - steady_a;
                put(steady_a + lot(step.coil_left + i) * behind_a, in.current_a + i);
            } else {
                put(steady_a, in.current_a + i);
            }
        }
    }

    /* (8) of the wheels from i on */
    Lot steady_current_a(int i, const S *speed, const Step &step,
                         const RobotInternals<S> &in) const {
        const Lot motion_v = lot(c_.back_emf_constant_v_s_rad + i) * lot(speed + i);
        return lot(in.conductance_s + i) * (Lot(in.bus_v) * lot(step.duty + i) - motion_v);
    }

    void limit_currents(const S *speed, const S *driven, RobotInternals<S> &in) const {
        CurrentTerm<S, 4> term;
        term.duty = driven;
        term.speed_rad_s = speed;
        for (int i = 0; i < 4; ++i)
            term.current_a[i] = in.current_a[i];
        active_.apply(kCurrent, [&](auto effect, const Values<S> &values) {
            decltype(effect)::current(term, values);
        });
        for (int i = 0; i < 4; ++i)
            in.current_a[i] = term.current_a[i];
    }

    /* Slip and friction law (11)-(13), per unit of wheel load. */
    void contact(const S *x, const Step &step, const S &time_s, RobotInternals<S> &in,
                 S *traction_per_load, S *radius_m, S *grip_rate) const {
        const S &vx = x[kVelocity];
        const S &vy = x[kVelocity + 1];
        const S &omega = x[kVelocity + 2];
        S mu[4], shape[4], roller_shape[4];
        for (int i = 0; i < 4; i += kLot) {
            const Lot drive_x = lot(drive_x_ + i), drive_y = lot(drive_y_ + i);
            const Lot x_m_s(vx), y_m_s(vy), turning(omega);
            put(x_m_s * drive_x + y_m_s * drive_y + turning * lot(drive_lever_ + i),
                in.hub_speed_m_s + i);
            put(x_m_s * drive_y - y_m_s * drive_x + turning * lot(roller_lever_ + i),
                in.roller_speed_m_s + i);
            put(lot(c_.wheel_radius_m + i), radius_m + i);
            put(lot(c_.mu_drive + i), mu + i);
        }
        if (active_.use(kContact)) {
            contact_effects(x, step, time_s, in, mu, radius_m, shape, roller_shape, grip_rate);
        } else {
            find_slip(x, radius_m, in, in.slip_m_s);
            if (slip_lags_) {
                S lagged_m_s[4];
                lag_slip(step, in, lagged_m_s, grip_rate);
                friction_law(lagged_m_s, shape);
            } else {
                friction_law(in.slip_m_s, shape);
            }
            friction_law(in.roller_speed_m_s, roller_shape);
        }
        if (bristles_)
            bend_bristles(step, in, shape, grip_rate);
        for (int i = 0; i < 4; i += kLot) {
            put(lot(mu + i) * lot(shape + i), traction_per_load + i);
            put(Lot(-c_.mu_roller) * lot(roller_shape + i), in.roller_force_n + i);
        }
    }

    /* (11), (12) */
    void find_slip(const S *x, const S *radius_m, const RobotInternals<S> &in, S *slip_m_s) const {
        for (int i = 0; i < 4; i += kLot) {
            Lot turning = Lot(per_gear_ratio_) * lot(x + kSpeed + i);
            if (soft_)
                turning = turning + lot(x + kSlack + i);
            put(lot(radius_m + i) * turning - lot(in.hub_speed_m_s + i), slip_m_s + i);
        }
    }

    /* (13) per friction limit, along or across the wheels: (2/pi) atan(k s). Not called, since the
     * step waits for it. */
    [[gnu::always_inline]] void friction_law(const S *slip_m_s, S *shape) const {
        for (int i = 0; i < 4; i += kLot) {
            const Lot scaled = Lot(c_.slip_stiffness_s_m) * lot(slip_m_s + i);
            put(atan_in_right_angles(scaled), shape + i);
        }
    }

    /* The slip that the friction law knows: where it lags, the mean over the step of what relaxes
     * to the slip, and the rate of that. */
    void lag_slip(const Step &step, const RobotInternals<S> &in, S *lagged_m_s, S *rate) const {
        for (int i = 0; i < 4; ++i) {
            const auto lag =
                Relaxation<S>::over(S(step.length_s) * rolled_m_s(in, i), per_bristle_m_[i]);
            const S ahead = in.slip_m_s[i] - step.grip[i];
            const S left = select(c_.slip_lags[i] > S(0.0), lag.left, S(0.0));
            lagged_m_s[i] = in.slip_m_s[i] - left * ahead;
            rate[i] = lag.gained * S(step.inverse_s) * ahead;
        }
    }

    /* By how much a tyre's contact renews itself: the way of its rim and what it slips, and creep.
     */
    S rolled_m_s(const RobotInternals<S> &in, int i) const {
        using std::abs;
        const S &slip = in.slip_m_s[i];
        return abs(in.hub_speed_m_s[i] + slip) + abs(slip) + S(kCreep_m_s);
    }

    /* The bristles' share of the grip relaxes to that of the friction law with the distance slipped
     * or rolled; in: law, out: mean share over the step and rate of the share. Not where the slip
     * lags: there what is held is slip. */
    void bend_bristles(const Step &step, const RobotInternals<S> &in, S *shape, S *rate) const {
        using std::abs;
        using std::max;
        const S at_rest = S(2.0 / kPi) * c_.slip_stiffness_s_m; /* share per slip */
        for (int i = 0; i < 4; ++i) {
            const auto slip_lags = c_.slip_lags[i] > S(0.0);
            const S share = abs(shape[i]);
            const S slip_per_share = select(
                share > S(1e-9), abs(in.slip_m_s[i]) / max(share, S(1e-9)), S(1.0) / at_rest);
            const S more_m_s = rolled_m_s(in, i) - slip_per_share;
            const S pace_m_s = slip_per_share + c_.bristle_rolling[i] * more_m_s;
            const auto bristle =
                Relaxation<S>::over(S(step.length_s) * pace_m_s, per_bristle_m_[i]);
            const S ahead = shape[i] - step.grip[i];
            const S bending = bristle.gained * S(step.inverse_s) * ahead;
            const S bent = shape[i] - bristle.left * ahead;
            rate[i] = slip_lags_ ? select(slip_lags, rate[i], bending) : bending;
            shape[i] = select(slip_lags, shape[i], bent);
        }
    }

    void contact_effects(const S *x, const Step &step, const S &time_s, RobotInternals<S> &in,
                         S *mu, S *radius_m, S *shape, S *roller_shape, S *grip_rate) const {
        ContactTerm<S, 4> term;
        S room[4];
        term.shaft_angle_rad = shaft_angles(x, room);
        term.x_m = x[kPose];
        term.y_m = x[kPose + 1];
        term.time_s = time_s;
        term.gear_ratio = c_.gear_ratio;
        for (int i = 0; i < 4; ++i) {
            term.mu_drive[i] = mu[i];
            term.radius_m[i] = radius_m[i];
            term.force_scale[i] = S(1.0);
            term.drive_direction_rad[i] =
                x[kPose + 2] + c_.wheel_angle_rad[i] + c_.roller_angle_offset_rad[i] + S(kPi / 2.0);
        }
        eccentric_radius(term);
        find_slip(x, term.radius_m, in, in.slip_m_s);
        for (int i = 0; i < 4; ++i)
            term.slip_m_s[i] = in.slip_m_s[i];
        if (slip_lags_)
            lag_slip(step, in, term.slip_m_s, grip_rate);
        for (int i = 0; i < 4; ++i) {
            term.scaled_slip[i] = c_.slip_stiffness_s_m * term.slip_m_s[i];
            term.scaled_roller[i] = c_.slip_stiffness_s_m * in.roller_speed_m_s[i];
        }
        friction_law(term.slip_m_s, term.shape);
        friction_law(in.roller_speed_m_s, term.roller_shape);
        active_.apply(kContact, [&](auto effect, const Values<S> &values) {
            using E = decltype(effect);
            if constexpr (!std::is_same<E, WheelEccentricity>::value) {
                E::contact(term, values);
            }
        });
        UserInputs<S> inputs = motion(x, time_s);
        inputs.at[kInThM] = term.shaft_angle_rad;
        inputs.at[kInS] = term.slip_m_s;
        inputs.at[kInVT] = in.hub_speed_m_s;
        inputs.at[kInVF] = in.roller_speed_m_s;
        user_.add(UserTarget::kGrip, inputs, 4, term.mu_drive);
        for (int i = 0; i < 4; ++i) {
            mu[i] = term.mu_drive[i] * term.force_scale[i];
            radius_m[i] = term.radius_m[i];
            shape[i] = term.shape[i];
            roller_shape[i] = term.roller_shape[i];
        }
    }

    /* The radius has to be known before the slip, the other contact effects need the slip. */
    void eccentric_radius(ContactTerm<S, 4> &term) const {
        active_.apply(kContact, [&](auto effect, const Values<S> &values) {
            using E = decltype(effect);
            if constexpr (std::is_same<E, WheelEccentricity>::value) {
                E::contact(term, values);
            }
        });
    }

    /* What a term of the user may depend on wherever it acts on the body or the sensors. */
    static UserInputs<S> motion(const S *x, const S &time_s) {
        UserInputs<S> inputs;
        inputs.at[kInT] = &time_s;
        inputs.at[kInW] = x + kSpeed;
        inputs.at[kInVx] = x + kVelocity;
        inputs.at[kInVy] = x + kVelocity + 1;
        inputs.at[kInOmega] = x + kVelocity + 2;
        inputs.at[kInX] = x + kPose;
        inputs.at[kInY] = x + kPose + 1;
        inputs.at[kInTheta] = x + kPose + 2;
        return inputs;
    }

    /* Forces from outside at the centre of gravity, and rolling resistance per load. */
    BodyTerm<S, 4> outside(const S *x, const S &time_s, const S &cos_theta, const S &sin_theta,
                           const RobotInternals<S> &in) const {
        BodyTerm<S, 4> term;
        term.force_x_n = term.force_y_n = term.torque_nm = S(0.0);
        term.acceleration_x_m_s2 = term.acceleration_y_m_s2 = S(0.0);
        term.cos_theta = cos_theta;
        term.sin_theta = sin_theta;
        for (int i = 0; i < 4; i += kLot)
            put(Lot(S(0.0)), term.force_along_drive_per_load + i);
        if (!active_.use(kBody))
            return term;
        for (int i = 0; i < 4; ++i)
            term.hub_speed_m_s[i] = in.hub_speed_m_s[i];
        term.vx_m_s = x[kVelocity];
        term.vy_m_s = x[kVelocity + 1];
        term.omega_rad_s = x[kVelocity + 2];
        term.x_m = x[kPose];
        term.y_m = x[kPose + 1];
        active_.apply(kBody, [&](auto effect, const Values<S> &values) {
            decltype(effect)::body(term, values);
        });
        const UserInputs<S> inputs = motion(x, time_s);
        user_.add(UserTarget::kForceX, inputs, 1, &term.force_x_n);
        user_.add(UserTarget::kForceY, inputs, 1, &term.force_y_n);
        user_.add(UserTarget::kBodyTorque, inputs, 1, &term.torque_nm);
        return term;
    }

    /* Wheel loads, contact forces and the body's acceleration (4). */
    void body(const S *x, RobotInternals<S> &in, const S *traction_per_load,
              const BodyTerm<S, 4> &external, S *dx) const {
        const auto along_per_load = [&](int i) {
            const Lot traction = lot(traction_per_load + i);
            return active_.use(kBody) ? traction + lot(external.force_along_drive_per_load + i)
                                      : traction;
        };
        for (int i = 0; i < 4; i += kLot)
            put(lot(static_load_n_ + i), in.load_n + i);
        if (load_moves_) {
            S along[4];
            for (int i = 0; i < 4; i += kLot)
                put(along_per_load(i), along + i);
            transfer_load(in, along, external);
        }
        Lot sum_x(S(0.0)), sum_y(S(0.0)), sum_moment(S(0.0));
        for (int i = 0; i < 4; i += kLot) {
            const Lot load_n = lot(in.load_n + i);
            const Lot roller_n = load_n * lot(in.roller_force_n + i);
            const Lot drive_x = lot(drive_x_ + i), drive_y = lot(drive_y_ + i);
            put(load_n * lot(traction_per_load + i), in.drive_force_n + i);
            put(roller_n, in.roller_force_n + i);
            /* What is known first is multiplied first: the forces along are waited for. */
            const Lot along = along_per_load(i);
            sum_x = sum_x + roller_n * drive_y + load_n * drive_x * along;
            sum_y = sum_y - roller_n * drive_x + load_n * drive_y * along;
            sum_moment = sum_moment + roller_n * lot(roller_lever_ + i) +
                         load_n * lot(drive_lever_ + i) * along;
        }
        S fx = total<S>(sum_x), fy = total<S>(sum_y), moment = total<S>(sum_moment);
        if (off_centre_)
            moment = moment - (c_.cog_x_m * fy - c_.cog_y_m * fx);
        in.external_force_x_n = in.external_force_y_n = in.external_torque_nm = S(0.0);
        if (active_.use(kBody)) {
            push(external, in);
            fx = fx + in.external_force_x_n;
            fy = fy + in.external_force_y_n;
            moment = moment + in.external_torque_nm;
        }

        const S &omega = x[kVelocity + 2];
        const S alpha = moment * per_inertia_;
        S ax = fx * per_mass_ + omega * x[kVelocity + 1];
        S ay = fy * per_mass_ - omega * x[kVelocity];
        if (off_centre_) {
            ax = ax + (omega * omega * c_.cog_x_m + alpha * c_.cog_y_m);
            ay = ay + (omega * omega * c_.cog_y_m - alpha * c_.cog_x_m);
        }
        dx[kVelocity] = ax;
        dx[kVelocity + 1] = ay;
        dx[kVelocity + 2] = alpha;
    }

    /* What the effects on the body push it with, in its frame. */
    void push(const BodyTerm<S, 4> &external, RobotInternals<S> &in) const {
        const S &ax = external.acceleration_x_m_s2, &ay = external.acceleration_y_m_s2;
        in.external_force_x_n =
            external.force_x_n + c_.mass_kg * (external.cos_theta * ax + external.sin_theta * ay);
        in.external_force_y_n =
            external.force_y_n + c_.mass_kg * (external.cos_theta * ay - external.sin_theta * ax);
        in.external_torque_nm = external.torque_nm;
    }

    /* N = N0 - m h (leg_x ax + leg_y ay) with m a = F_ext + sum(N_i g_i), solved for a (2 x 2). The
     * gravity-like part of F_ext (a slope) does not move load: it acts on the whole weight. More of
     * the free pattern in N0 changes the floor's force too, so N changes by more than that. */
    void transfer_load(RobotInternals<S> &in, const S *along,
                       const BodyTerm<S, 4> &external) const {
        const S &h = c_.cog_height_m;
        S fx = external.force_x_n, fy = external.force_y_n, free_x = S(0.0), free_y = S(0.0);
        S axx = S(1.0), axy = S(0.0), ayx = S(0.0), ayy = S(1.0);
        for (int i = 0; i < 4; ++i) {
            const S gx = along[i] * drive_x_[i] + in.roller_force_n[i] * drive_y_[i];
            const S gy = along[i] * drive_y_[i] - in.roller_force_n[i] * drive_x_[i];
            fx = fx + static_load_n_[i] * gx;
            fy = fy + static_load_n_[i] * gy;
            free_x = free_x + S(kFreeLoad[i]) * gx;
            free_y = free_y + S(kFreeLoad[i]) * gy;
            axx = axx + h * leg_x_[i] * gx;
            axy = axy + h * leg_y_[i] * gx;
            ayx = ayx + h * leg_x_[i] * gy;
            ayy = ayy + h * leg_y_[i] * gy;
        }
        const S per_determinant = S(1.0) / (axx * ayy - axy * ayx);
        /* h leg m a of a push, with the load that it moves */
        const auto lean = [&](const S &push_x, const S &push_y, int i) {
            const S ax = (ayy * push_x - axy * push_y) * per_determinant;
            const S ay = (axx * push_y - ayx * push_x) * per_determinant;
            return h * (leg_x_[i] * ax + leg_y_[i] * ay);
        };
        S free_load[4];
        for (int i = 0; i < 4; ++i) {
            in.load_n[i] = static_load_n_[i] - lean(fx, fy, i);
            free_load[i] = S(kFreeLoad[i]) - lean(free_x, free_y, i);
        }
        rest_on_the_floor(in.load_n, free_load);
    }

    /* Moves the loads along the free pattern until no wheel pulls at the floor. */
    template <class Load>
    static void rest_on_the_floor(S *load_n, const Load *free_load) {
        using std::max;
        constexpr double kLeast = 0.1; /* a pattern that hardly moves the wheel's load is no help */
        const auto needed_n = [&](int i) {
            return -load_n[i] / max(S(kFreeLoad[i]) * S(free_load[i]), S(kLeast));
        };
        const S gain_n = max(max(needed_n(0), needed_n(2)), S(0.0));
        const S loss_n = max(max(needed_n(1), needed_n(3)), S(0.0));
        const S moved_n = gain_n - loss_n;
        for (int i = 0; i < 4; ++i)
            load_n[i] = max(load_n[i] + moved_n * S(free_load[i]), S(0.0));
    }

    SensorTerm<S, 4> sensors(const S *x, const S &time_s, const S *way_since = nullptr) const {
        SensorTerm<S, 4> term;
        term.gyro_rad_s = x[kVelocity + 2];
        term.x_m = x[kPose];
        term.y_m = x[kPose + 1];
        term.theta_rad = x[kPose + 2];
        term.speed_rad_s = x + kSpeed;
        for (int i = 0; i < 4; ++i)
            term.encoder_rate[i] = S(1.0);
        if (shows_late_)
            turn_back(x, time_s, way_since, term);
        active_.apply(kSensor, [&](auto effect, const Values<S> &values) {
            decltype(effect)::sensor(term, values);
        });
        const UserInputs<S> inputs = motion(x, time_s);
        user_.add(UserTarget::kGyro, inputs, 1, &term.gyro_rad_s);
        user_.add(UserTarget::kPoseX, inputs, 1, &term.x_m);
        user_.add(UserTarget::kPoseY, inputs, 1, &term.y_m);
        user_.add(UserTarget::kPoseTheta, inputs, 1, &term.theta_rad);
        return term;
    }

    /* The pose to that of the moment which the camera shows. */
    void turn_back(const S *x, const S &time_s, const S *way_since, SensorTerm<S, 4> &term) const {
        const S late = late_s(time_s);
        S cos_theta, sin_theta;
        sine_cosine(x[kPose + 2], sin_theta, cos_theta);
        S way[3] = {late * (cos_theta * x[kVelocity] - sin_theta * x[kVelocity + 1]),
                    late * (sin_theta * x[kVelocity] + cos_theta * x[kVelocity + 1]),
                    late * x[kVelocity + 2]};
        if (way_since != nullptr) {
            for (int c = 0; c < 3; ++c)
                way[c] = select(late > S(0.0), way_since[c], way[c]);
        }
        term.x_m = term.x_m - way[0];
        term.y_m = term.y_m - way[1];
        term.theta_rad = term.theta_rad - way[2];
    }

    /* Angles of the shafts; `room` [4] for those that are not the encoders'. */
    const S *shaft_angles(const S *x, S *room) const {
        if (!unshown_)
            return x + kAngle;
        for (int i = 0; i < 4; ++i)
            room[i] = x[kAngle + i] + x[kUnshown + i];
        return room;
    }

    /* What encoders show of the speeds, and what not. An encoder's zero is its shaft's: what a log
     * begins with was counted as at rest. */
    void count(const S *x, const Step &step, S *dx) const {
        const S at_rest[4] = {S(0.0), S(0.0), S(0.0), S(0.0)};
        const bool begins = unshown_ && step.length_s == kForever_s;
        const SensorTerm<S, 4> term = counting(begins ? at_rest : x + kSpeed);
        for (int i = 0; i < 4; ++i) {
            const S &rate = term.encoder_rate[i], shown = dx[kAngle + i] * rate;
            if (begins)
                dx[kUnshown + i] = (x[kAngle + i] / rate - x[kAngle + i]) * S(step.inverse_s);
            else if (unshown_)
                dx[kUnshown + i] = dx[kAngle + i] - shown;
            dx[kAngle + i] = shown;
        }
    }

    /* Shares of their speeds [rad/s] that the encoders show. */
    SensorTerm<S, 4> counting(const S *speed) const {
        SensorTerm<S, 4> term;
        term.speed_rad_s = speed;
        for (int i = 0; i < 4; ++i)
            term.encoder_rate[i] = S(1.0);
        active_.apply(kCounts, [&](auto effect, const Values<S> &values) {
            decltype(effect)::sensor(term, values);
        });
        return term;
    }

    Constants<S, 4> c_;
    S wheel_x_[4], wheel_y_[4], leg_x_[4], leg_y_[4], static_load_n_[4], shaft_damping_[4];
    S drive_x_[4], drive_y_[4], drive_lever_[4], roller_lever_[4];
    UserTerms<S, 4> user_;
    ActiveEffects<S, kMotors, kRobot> active_;
    bool load_moves_ = false, off_centre_ = false, bus_sags_ = false;
    S per_mass_, per_inertia_, per_gear_ratio_, per_shaft_inertia_[4], conductance_s_;
    SoftGear<S> gear_[4];
    S per_driver_lag_s_[4], per_bristle_m_[4];
    MemoryPlaces<kAll - kStates> memory_;
    bool delays_ = false, remembers_ = false, lags_ = false, inductive_ = false;
    bool heats_ = false, bristles_ = false, slip_lags_ = false, soft_ = false, springs_ = false,
         shows_late_ = false;
    bool unshown_ = false;
};

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
