/* user_terms.h - effects that a user defines in a file: expressions evaluated inside the plant.
 *
 * tools/omnislip/user_effects.py turns an expression into a program for a stack machine; the plant
 * runs it in SIMD lanes, where the effects of effects.h with the same hook act, after them. A term
 * whose parameters all have their neutral values is switched off and costs nothing.
 *
 *   target              added to                               inputs
 *   duty                duty of each motor (axis: command)     d
 *   supply_v            open-circuit voltage                   t
 *   shaft_torque_nm     torque on each motor shaft             t W th_m tau
 *   mu_drive            grip of each wheel                     t W th_m s VT VF vx vy w x y theta
 *   body_force_x_n, body_force_y_n, body_torque_nm             t vx vy w x y theta
 *   gyro_rad_s, pose_x_m, pose_y_m, pose_theta_rad             t vx vy w x y theta
 *
 * Symbols and units as in effects.h; body velocities in the body frame, place in the world.
 */
#ifndef OMNISLIP_SIM_USER_TERMS_H
#define OMNISLIP_SIM_USER_TERMS_H

#include <vector>

#include "effects.h"

namespace omnislip {

constexpr int kMaxUserTerms = 16;
constexpr int kUserStack = 16;

enum class UserTarget {
    kDuty,
    kSupply,
    kShaftTorque,
    kGrip,
    kForceX,
    kForceY,
    kBodyTorque,
    kGyro,
    kPoseX,
    kPoseY,
    kPoseTheta,
    kCount
};
constexpr const char *kUserTargets[] = {"duty",           "supply_v",       "shaft_torque_nm",
                                        "mu_drive",       "body_force_x_n", "body_force_y_n",
                                        "body_torque_nm", "gyro_rad_s",     "pose_x_m",
                                        "pose_y_m",       "pose_theta_rad"};
constexpr unsigned kUserHooks[] = {kCommand, kSupply, kShaft,  kContact, kBody,  kBody,
                                   kBody,    kSensor, kSensor, kSensor,  kSensor};

/* The first seven have a value per motor. */
enum UserInput {
    kInD,
    kInW,
    kInThM,
    kInTau,
    kInS,
    kInVT,
    kInVF,
    kInT,
    kInVx,
    kInVy,
    kInOmega,
    kInX,
    kInY,
    kInTheta,
    kUserInputCount
};
constexpr int kInputsPerMotor = 7;
constexpr const char *kUserInputs[] = {"d", "W",  "th_m", "tau", "s", "VT", "VF",
                                       "t", "vx", "vy",   "w",   "x", "y",  "theta"};

enum class UserOperation {
    kConstant,
    kParameter,
    kInput,
    kIntegerPower, /* by `argument` */
    kNegate,
    kAbs,
    kSign,
    kSqrt,
    kExp,
    kLog,
    kSin,
    kCos,
    kTan,
    kAtan,
    kTanh,
    kAdd,
    kSubtract,
    kMultiply,
    kDivide,
    kPower,
    kMin,
    kMax,
    kLess,
    kWhere, /* condition, value if not 0, value if 0 */
    kCount
};
constexpr const char *kUserOperations[] = {
    "constant", "parameter", "input",  "integer_power", "negate", "abs",  "sign", "sqrt",
    "exp",      "log",       "sin",    "cos",           "tan",    "atan", "tanh", "add",
    "subtract", "multiply",  "divide", "power",         "min",    "max",  "less", "where"};

struct UserInstruction {
    UserOperation operation;
    int argument; /* number of the parameter or input, or the exponent */
    double constant;
};

struct UserTerm {
    UserTarget target;
    int stride; /* N when each wheel has its own parameters, else 1 */
    std::vector<double> neutral;
    std::vector<UserInstruction> program;
    int slots() const {
        return stride * static_cast<int>(neutral.size());
    }
};

/* Terms that their owner keeps alive. */
struct UserTermList {
    const UserTerm *first = nullptr;
    int count = 0;
    int slots() const {
        int total = 0;
        for (int k = 0; k < count; ++k)
            total += first[k].slots();
        return total;
    }
};

inline namespace OMNISLIP_INSTRUCTION_SET {

/* Pointers to the values of the inputs: per motor, or one. */
template <class S>
struct UserInputs {
    const S *at[kUserInputCount] = {};
};

/* The user's terms of one parameter set (lane group). */
template <class S, int N>
class UserTerms {
  public:
    /* `values`: the parameters of all terms, term by term. Returns the hooks in use. */
    unsigned prepare(const UserTermList &terms, const S *values) {
        terms_ = terms;
        unsigned hooks = 0;
        for (int k = 0; k < terms.count; ++k) {
            const UserTerm &term = terms.first[k];
            values_[k] = values;
            active_[k] = false;
            for (int slot = 0; slot < term.slots(); ++slot) {
                const double neutral = term.neutral[static_cast<std::size_t>(slot / term.stride)];
                for (int i = 0; i < LaneCount<S>::value; ++i)
                    active_[k] = active_[k] || lane(values[slot], i) != neutral;
            }
            if (active_[k])
                hooks |= kUserHooks[static_cast<int>(term.target)];
            if (active_[k] && reads(term, kInThM))
                hooks |= kByAngle;
            values += term.slots();
        }
        return hooks;
    }

    /* Adds the active terms of `target` to to[0..width-1], width N or 1. */
    void add(UserTarget target, const UserInputs<S> &inputs, int width, S *to) const {
        for (int k = 0; k < terms_.count; ++k) {
            const UserTerm &term = terms_.first[k];
            if (!active_[k] || term.target != target)
                continue;
            const Values<S> parameters = {values_[k], term.stride};
            for (int i = 0; i < width; ++i)
                to[i] = to[i] + evaluate(term, parameters, inputs, i);
        }
    }

  private:
    static bool reads(const UserTerm &term, UserInput input) {
        bool found = false;
        for (const UserInstruction &step : term.program)
            found = found || (step.operation == UserOperation::kInput && step.argument == input);
        return found;
    }

    static S evaluate(const UserTerm &term, const Values<S> &parameters,
                      const UserInputs<S> &inputs, int wheel) {
        S stack[kUserStack];
        stack[0] = S(0.0); /* a program is never empty, which no compiler knows */
        int top = -1;
        for (const UserInstruction &step : term.program) {
            if (step.operation == UserOperation::kConstant) {
                stack[++top] = S(step.constant);
            } else if (step.operation == UserOperation::kParameter) {
                stack[++top] = parameters(step.argument, wheel);
            } else if (step.operation == UserOperation::kInput) {
                stack[++top] =
                    inputs.at[step.argument][step.argument < kInputsPerMotor ? wheel : 0];
            } else if (step.operation < UserOperation::kAdd) {
                stack[top] = of_one(step, stack[top]);
            } else if (step.operation < UserOperation::kWhere) {
                --top;
                stack[top] = of_two(step.operation, stack[top], stack[top + 1]);
            } else {
                top -= 2;
                stack[top] = select(stack[top] != S(0.0), stack[top + 1], stack[top + 2]);
            }
        }
        return stack[0];
    }

    static S of_one(const UserInstruction &step, const S &x) {
        using std::abs;
        using std::atan;
        using std::cos;
        using std::exp;
        using std::log;
        using std::sin;
        using std::sqrt;
        using std::tan;
        using std::tanh;
        switch (step.operation) {
            case UserOperation::kIntegerPower: {
                S power = S(1.0);
                for (int k = 0; k < step.argument; ++k)
                    power = power * x;
                return power;
            }
            case UserOperation::kNegate:
                return -x;
            case UserOperation::kAbs:
                return abs(x);
            case UserOperation::kSign:
                return sign_of(x);
            case UserOperation::kSqrt:
                return sqrt(x);
            case UserOperation::kExp:
                return exp(x);
            case UserOperation::kLog:
                return log(x);
            case UserOperation::kSin:
                return sin(x);
            case UserOperation::kCos:
                return cos(x);
            case UserOperation::kTan:
                return tan(x);
            case UserOperation::kAtan:
                return atan(x);
            default:
                return tanh(x);
        }
    }

    static S of_two(UserOperation operation, const S &a, const S &b) {
        using std::max;
        using std::min;
        using std::pow;
        switch (operation) {
            case UserOperation::kAdd:
                return a + b;
            case UserOperation::kSubtract:
                return a - b;
            case UserOperation::kMultiply:
                return a * b;
            case UserOperation::kDivide:
                return a / b;
            case UserOperation::kPower:
                return pow(a, b);
            case UserOperation::kMin:
                return min(a, b);
            case UserOperation::kMax:
                return max(a, b);
            default:
                return select(a < b, S(1.0), S(0.0));
        }
    }

    UserTermList terms_;
    const S *values_[kMaxUserTerms] = {};
    bool active_[kMaxUserTerms] = {};
};

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
