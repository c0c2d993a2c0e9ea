/* axis_plant.h - one driven axis: a motor with a load, linear (m, N) or rotary (rad, N m).
 *
 * State x (2): speed v, position q. Command u in volt, ampere or duty; NaN while the drive is off.
 *
 *   M dv/dt = tau - b v + effects - m_p g0 l sin(q - q0)           dq/dt = v
 *   tau = g u - e v, and 0 while the drive is off: no current flows, so nothing brakes
 *
 * M inertia or mass, g input gain, e back-EMF as viscous equivalent, b viscous friction,
 * m_p and l pendulum mass and length (0: none), q0 where it hangs. M is all that moves, m_p l^2 of
 * the pendulum among it; a payload hangs at its end. The same friction effects act as on the
 * robot's shafts; "torque" is force on a linear axis. A pendulum loads the gear also while
 * the motor gives nothing: load dependent friction takes the larger of tau and its torque.
 * Behind the state the memory (3) of memory.h: command that has left the driver, slack and twist of
 * a soft gear or drive (two masses); friction is then on the motor's side, the pendulum behind the
 * gear, and the position is that of the motor.
 */
#ifndef OMNISLIP_SIM_AXIS_PLANT_H
#define OMNISLIP_SIM_AXIS_PLANT_H

#include "robot_plant.h"

namespace omnislip {
inline namespace OMNISLIP_INSTRUCTION_SET {

constexpr BaseParameter kAxisBase[] = {
    {"axis.inertia", "kg or kg m^2", 1.0},
    {"axis.input_gain", "N or N m per unit of command", 1.0},
    {"axis.back_emf", "N s/m or N m s", 0.0},
    {"axis.viscous_friction", "N s/m or N m s", 0.0},
    {"axis.pendulum_mass_kg", "kg", 0.0},
    {"axis.pendulum_length_m", "m", 0.1},
    {"axis.gravity_m_s2", "m/s^2", 9.81},
    {"axis.friction_speed", "m/s or rad/s", 0.02},
};

template <class S>
struct AxisInternals {
    S force, friction;
};

template <class S>
struct AxisStep {
    double length_s, inverse_s;
    S command, command_rate_1_s, powered;
};

template <class S>
class AxisPlant {
  public:
    using Step = AxisStep<S>;
    static constexpr int kMotors = 1;
    static constexpr int kStates = 2;
    static constexpr int kAll = kStates + 3; /* with memory */
    enum MemoryIndex { kCommanded = 2, kSlack = 3, kTwist = 4 };
    static constexpr int kOutputs = 1; /* position */
    static constexpr int kBase = static_cast<int>(sizeof(kAxisBase) / sizeof(kAxisBase[0]));
    static constexpr Kind kKind = kAxis;
    static constexpr double kCommandJump = kUnbounded; /* no contact that slips */

    void prepare(const S *flat, const bool *active, const UserTermList &terms = {}) {
        c_.mass_kg = flat[0];
        c_.inertia_kg_m2 = S(0.0);
        c_.viscous_friction_nm_s[0] = flat[3];
        c_.zero_angle_rad = S(0.0);
        c_.friction_speed = flat[7];
        input_gain_ = flat[1];
        back_emf_ = flat[2];
        forget(c_);
        active_.prepare(flat + kBase, active, c_);
        active_.add_hooks(user_.prepare(terms, flat + kBase + effect_slot_count(kMotors)));
        const S payload_kg = c_.mass_kg - flat[0];
        const S at_the_end = payload_kg * flat[5] * flat[5];
        inertia_ = flat[0] + c_.inertia_kg_m2 + select(flat[4] > S(0.0), at_the_end, payload_kg);
        gravity_torque_ =
            select(flat[4] > S(0.0), flat[4] + payload_kg, S(0.0)) * flat[5] * flat[6];
        hangs_ = any_differs(&gravity_torque_, 1, 0.0);
        gear_.prepare(c_, 0, inertia_);
        delays_ = any_differs(c_.delay_s, 1, 0.0);
        soft_ = any_differs(c_.play_rad, 1, 0.0) || any_differs(c_.stiffness_nm_rad, 1, kUnbounded);
        lags_ = any_differs(c_.driver_lag_s, 1, 0.0);
        per_driver_lag_s_ = Relaxation<S>::per(c_.driver_lag_s[0]);
        memory_.clear();
        if (lags_)
            memory_.add(kCommanded, 1);
        if (soft_)
            memory_.add(kSlack, 2);
    }

    /* The driver over a step from x [kAll] under a constant command. */
    void begin_step(const S *x, const S *u, double length_s, Step &step) const {
        CommandTerm<S, 1> term;
        step.powered = select(u[0] == u[0], S(1.0), S(0.0));
        term.duty[0] = select(u[0] == u[0], u[0], S(0.0));
        active_.apply(kCommand, [&](auto effect, const Values<S> &values) {
            decltype(effect)::command(term, values);
        });
        step.command = term.duty[0];
        if (active_.use(kCommand)) {
            UserInputs<S> inputs;
            inputs.at[kInD] = term.duty;
            user_.add(UserTarget::kDuty, inputs, 1, &step.command);
        }
        step.length_s = length_s;
        step.inverse_s = length_s > 0.0 ? 1.0 / length_s : 0.0;
        if (!lags_)
            return;
        const auto driver = Relaxation<S>::over(S(length_s), per_driver_lag_s_);
        const S ahead = step.command - x[kCommanded];
        step.command_rate_1_s = driver.gained * S(step.inverse_s) * ahead;
        step.command = step.command - driver.left * ahead;
    }

    /* dx [kStates], with memory [kAll]. */
    void derivative(const S *x, const Step &step, const S &time_s, S *dx,
                    AxisInternals<S> &in) const {
        using std::abs;
        using std::max;
        in.force = step.powered * drive(step.command, x);
        const S gravity = gravity_at(x[1]);
        in.friction = friction(x, in.force, max(abs(in.force), abs(gravity)), time_s);
        dx[0] = (in.force + in.friction - gravity) / inertia_;
        dx[1] = x[0];
        if (lags_)
            dx[kCommanded] = step.command_rate_1_s;
        if (soft_)
            twist_gear(x, step, in, dx);
    }

    void output(const S *x, const S &, S *y) const {
        y[0] = x[1];
    }

    double fastest_rate_1_s() const {
        using std::max;
        S moving[2] = {S(1e-3) * c_.friction_speed, S(0.0)};
        S still[2] = {S(0.0), S(0.0)};
        const S none = S(0.0);
        const S slope =
            (friction(still, none, none, none) - friction(moving, none, none, none)) / moving[0];
        const S ripple = ripple_rate_1_s(c_.ripple_nm[0], inertia_, least_way_rad(c_));
        const S rate =
            max(gear_.rate_1_s(back_emf_ / inertia_, slope / inertia_), S(kRatePerRipple) * ripple);
        double worst = 0.0;
        for (int i = 0; i < LaneCount<S>::value; ++i)
            worst = std::max(worst, lane(rate, i));
        return worst;
    }

    const Constants<S, 1> &constants() const {
        return c_;
    }
    bool remembers() const {
        return lags_ || soft_;
    }
    const MemoryPlaces<kAll - kStates> &memory() const {
        return memory_;
    }
    bool delays() const {
        return delays_;
    }

  private:
    /* Torque with which a pendulum pulls back at this angle; without one the sine is saved. */
    S gravity_at(const S &angle_rad) const {
        using std::sin;
        return hangs_ ? gravity_torque_ * sin(angle_rad - c_.zero_angle_rad) : S(0.0);
    }

    void twist_gear(const S *x, const Step &step, const AxisInternals<S> &in, S *dx) const {
        const S motor = in.force + in.friction;
        const S road = gravity_at(x[1] - x[kTwist]);
        if (step.length_s == kForever_s) {
            dx[kTwist] = gear_.settled_twist(motor, road, dx[0]) * S(step.inverse_s);
            dx[kSlack] = S(0.0);
        } else {
            gear_.accelerate(motor, road, x[kTwist], x[kSlack], dx[0], dx[kSlack]);
            dx[kTwist] = -x[kSlack];
        }
    }

    /* tau; the effects see it as the current of a motor of unit torque constant. */
    S drive(const S &command, const S *x) const {
        CurrentTerm<S, 1> term;
        term.current_a[0] = input_gain_ * command - back_emf_ * x[0];
        term.duty = &command;
        term.speed_rad_s = x;
        active_.apply(kCurrent, [&](auto effect, const Values<S> &values) {
            decltype(effect)::current(term, values);
        });
        return term.current_a[0];
    }

    /* `carried`: torque that the gear transmits, from the motor or from the load. */
    S friction(const S *x, const S &motor_force, const S &carried, const S &time_s) const {
        using std::tanh;
        S total = -c_.viscous_friction_nm_s[0] * x[0];
        if (!active_.use(kShaft))
            return total;
        ShaftTerm<S, 1> term;
        term.speed_rad_s = x;
        term.angle_rad = x + 1;
        term.motor_torque_nm = &carried;
        term.inertia_kg_m2 = &inertia_;
        term.least_way_rad = least_way_rad(c_);
        term.torque_nm[0] = S(0.0);
        term.sign[0] = tanh(x[0] / c_.friction_speed);
        active_.apply(kShaft, [&](auto effect, const Values<S> &values) {
            decltype(effect)::shaft(term, values);
        });
        UserInputs<S> inputs;
        inputs.at[kInW] = x;
        inputs.at[kInThM] = x + 1;
        inputs.at[kInTau] = &motor_force;
        inputs.at[kInT] = &time_s;
        user_.add(UserTarget::kShaftTorque, inputs, 1, term.torque_nm);
        return total + term.torque_nm[0];
    }

    Constants<S, 1> c_;
    S inertia_, input_gain_, back_emf_, gravity_torque_;
    SoftGear<S> gear_;
    S per_driver_lag_s_;
    MemoryPlaces<kAll - kStates> memory_;
    bool delays_ = false, lags_ = false, soft_ = false, hangs_ = false;
    UserTerms<S, 1> user_;
    ActiveEffects<S, kMotors, kAxis> active_;
};

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
