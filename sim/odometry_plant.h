/* odometry_plant.h - a robot followed by its wheel encoders alone: geometry, no forces, no motors.
 *
 * State x (3): pose (x, y, theta) in the world. Command u (8): rates of the encoder angles, rad/s
 * at the wheel, counted so that a positive rate turns the robot counter-clockwise; wheels the robot
 * does not have (angle NaN) are left out. Each wheel says how fast its hub moves along its drive
 * direction, row i of J (paper eq. (3) for any number of wheels):
 *
 *   d_i . v + (p_i x d_i) w = R_i cos(a) u_i / e_i,   d_i = (-sin(g_i + t_i), cos(g_i + t_i))
 *
 * p_i = L (cos g_i, sin g_i), R_i radius, e_i encoder scale, t_i mounting error, a the angle of the
 * rollers' axes off the wheel's rolling direction: 0 for an omni wheel; for a mecanum wheel 45
 * degrees, g_i and L then being bearing and distance of the line in which it can push. The body
 * moves as the least squares solution v = (J'J)^-1 J' (rim speeds) says, changed by the effects of
 * the hook `motion`. Where all wheels drive in parallel (two wheels, tracks) nothing says how fast
 * the body moves along their axle: J has one more row, (cos g_1, sin g_1, 0), with speed 0. A row
 * of the log is followed along an arc.
 *
 * A log begins where the camera shows the robot first, whichever way that is turned or its marker
 * sits. The camera's row at t shows the pose of t (1 - fraction) - delay (clock_skew,
 * pose_latency): the pose here is the one the camera shows, driven by the encoders of that moment.
 * That is exact also for delays over which the motion changes.
 */
#ifndef OMNISLIP_SIM_ODOMETRY_PLANT_H
#define OMNISLIP_SIM_ODOMETRY_PLANT_H

#include "memory.h"
#include "robot_plant.h"

namespace omnislip {
inline namespace OMNISLIP_INSTRUCTION_SET {

constexpr int kMostWheels = 8;
constexpr double kParallel = 1e-12; /* squares of the sines of the angles between the wheels */
constexpr double kRedundant = 0.05; /* share of a wheel's rate that shows beside the others' */

constexpr BaseParameter kOdometryBase[] = {
    {"odometry.wheel_radius_m", "m", 0.05},       {"odometry.wheel_distance_m", "m", 0.2},
    {"odometry.roller_angle_deg", "deg", 0.0},    {"odometry.wheel_angles_deg[0]", "deg", 0.0},
    {"odometry.wheel_angles_deg[1]", "deg", 0.0}, {"odometry.wheel_angles_deg[2]", "deg", 0.0},
    {"odometry.wheel_angles_deg[3]", "deg", 0.0}, {"odometry.wheel_angles_deg[4]", "deg", 0.0},
    {"odometry.wheel_angles_deg[5]", "deg", 0.0}, {"odometry.wheel_angles_deg[6]", "deg", 0.0},
    {"odometry.wheel_angles_deg[7]", "deg", 0.0},
};

struct OdometryInternals {};

template <class S>
class OdometryPlant {
  public:
    struct Step {
        S vx_m_s, vy_m_s, omega_rad_s; /* body frame */
    };
    static constexpr int kMotors = kMostWheels;
    static constexpr int kStates = 3;
    static constexpr int kAll = kStates;
    static constexpr int kOutputs = 3; /* x, y, theta as the camera shows them */
    static constexpr int kBase = static_cast<int>(sizeof(kOdometryBase) / sizeof(kOdometryBase[0]));
    static constexpr Kind kKind = kOdometry;
    static constexpr double kCommandJump = kUnbounded; /* no contact that slips */

    /* No effect of the user's acts on an odometry: there are no terms. */
    void prepare(const S *flat, const bool *active, const UserTermList & = {}) {
        using std::cos;
        const S degree(kPi / 180.0);
        c_.wheel_distance_m = flat[1];
        c_.pose_delay_s = c_.clock_fraction = S(0.0);
        const S rolling = flat[0] * cos(flat[2] * degree);
        for (int i = 0; i < kMostWheels; ++i) {
            c_.wheel_radius_m[i] = rolling;
            c_.wheel_angle_rad[i] = flat[3 + i] * degree;
            c_.roller_angle_offset_rad[i] = S(0.0);
            standing_[i] = S(0.0);
        }
        active_.prepare(flat + kBase, active, c_);
        const SensorTerm<S, kMotors> at_rest = shown(S(0.0), S(0.0), S(0.0));
        std::copy_n(at_rest.encoder_rate, kMotors, encoder_rate_);
        solve_geometry();
    }

    /* Velocity of the body over a step under the mean encoder rates u [kMotors]. */
    void begin_step(const S *, const S *u, double, Step &step) const {
        CountedTerm<S, kMotors> wheels;
        for (int i = 0; i < kMostWheels; ++i)
            wheels.rate_rad_s[i] = u[i] / encoder_rate_[i];
        if (active_.use(kCounted)) {
            tell_by_others(wheels);
            active_.apply(kCounted, [&](auto effect, const Values<S> &values) {
                decltype(effect)::counted(wheels, values);
            });
        }
        MotionTerm<S> term{S(0.0), S(0.0), S(0.0)};
        for (int i = 0; i < kMostWheels; ++i) {
            term.vx_m_s = term.vx_m_s + inverse_[0][i] * wheels.rate_rad_s[i];
            term.vy_m_s = term.vy_m_s + inverse_[1][i] * wheels.rate_rad_s[i];
            term.omega_rad_s = term.omega_rad_s + inverse_[2][i] * wheels.rate_rad_s[i];
        }
        active_.apply(kMotion, [&](auto effect, const Values<S> &values) {
            decltype(effect)::motion(term, values);
        });
        const S pace = S(1.0) - c_.clock_fraction;
        step = {pace * term.vx_m_s, pace * term.vy_m_s, pace * term.omega_rad_s};
    }

    void derivative(const S *x, const Step &step, const S &, S *dx, OdometryInternals &) const {
        using std::cos;
        using std::sin;
        const S c = cos(x[2]), s = sin(x[2]);
        dx[0] = c * step.vx_m_s - s * step.vy_m_s;
        dx[1] = s * step.vx_m_s + c * step.vy_m_s;
        dx[2] = step.omega_rad_s;
    }

    void output(const S *x, const S &, S *y) const {
        const SensorTerm<S, kMotors> term = shown(x[0], x[1], x[2]);
        y[0] = term.x_m;
        y[1] = term.y_m;
        y[2] = term.theta_rad;
    }

    /* Turn the pose x that the camera shows first into that of the robot. The camera shows
     * (A p + b(theta), theta + c): A and b as it shows the places (0, 0), (1, 0) and (0, 1). */
    void begin_where_shown(S *x) const {
        const S none(0.0);
        S shown[3];
        output(x, none, shown);
        x[2] = x[2] + x[2] - shown[2];
        const S places[3][3] = {{none, none, x[2]}, {S(1.0), none, x[2]}, {none, S(1.0), x[2]}};
        S seen[3][3];
        for (int i = 0; i < 3; ++i)
            output(places[i], none, seen[i]);
        const S a = seen[1][0] - seen[0][0], b = seen[2][0] - seen[0][0];
        const S c = seen[1][1] - seen[0][1], d = seen[2][1] - seen[0][1];
        const S along = x[0] - seen[0][0], across = x[1] - seen[0][1];
        const S determinant = a * d - b * c;
        x[0] = (d * along - b * across) / determinant;
        x[1] = (a * across - c * along) / determinant;
    }

    double fastest_rate_1_s() const {
        return 0.0;
    }
    const Constants<S, kMotors> &constants() const {
        return c_;
    }
    bool shifts_time() const {
        return any_lane_differs(c_.pose_delay_s, 0.0) || any_lane_differs(c_.clock_fraction, 0.0);
    }

  private:
    /* Rate of each wheel by the least squares solution of the others: with H = J (J'J)^-1 J' and
     * rim speeds r the residual r - H r of wheel i is 1 - H_ii times the one without it. */
    void tell_by_others(CountedTerm<S, kMotors> &wheels) const {
        for (int i = 0; i < kMostWheels; ++i) {
            S hub_rad_s(0.0), own(0.0);
            for (int k = 0; k < kMostWheels; ++k) {
                S share(0.0);
                for (int a = 0; a < 3; ++a)
                    share = share + jacobian_[i][a] * inverse_[a][k];
                hub_rad_s = hub_rad_s + share / c_.wheel_radius_m[i] * wheels.rate_rad_s[k];
                own = k == i ? share / c_.wheel_radius_m[i] : own;
            }
            const S left = S(1.0) - own;
            wheels.told_rad_s[i] =
                select(left > S(kRedundant), (hub_rad_s - own * wheels.rate_rad_s[i]) / left,
                       S(std::numeric_limits<double>::quiet_NaN()));
        }
    }

    /* What camera and encoders show of a pose; an odometry has no motors that turn. */
    SensorTerm<S, kMotors> shown(const S &x_m, const S &y_m, const S &theta_rad) const {
        SensorTerm<S, kMotors> term;
        term.x_m = x_m;
        term.y_m = y_m;
        term.theta_rad = theta_rad;
        term.gyro_rad_s = S(0.0);
        for (int i = 0; i < kMostWheels; ++i)
            term.encoder_rate[i] = S(1.0);
        term.speed_rad_s = standing_;
        active_.apply(kSensor, [&](auto effect, const Values<S> &values) {
            decltype(effect)::sensor(term, values);
        });
        return term;
    }

    /* inverse_ = (J'J)^-1 J' diag(rim speed per encoder rate); J'J by its adjugate. */
    void solve_geometry() {
        using std::cos;
        using std::sin;
        S(&j)[kMostWheels][3] = jacobian_;
        S m[3][3];
        for (auto &row : m)
            for (S &entry : row)
                entry = S(0.0);
        for (int i = 0; i < kMostWheels; ++i) {
            const S &bearing = c_.wheel_angle_rad[i];
            const auto there = bearing == bearing;
            const S direction = bearing + c_.roller_angle_offset_rad[i];
            j[i][0] = select(there, -sin(direction), S(0.0));
            j[i][1] = select(there, cos(direction), S(0.0));
            j[i][2] =
                select(there, c_.wheel_distance_m * cos(c_.roller_angle_offset_rad[i]), S(0.0));
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b)
                    m[a][b] = m[a][b] + j[i][a] * j[i][b];
        }
        add_axle(m);
        S adjugate[3][3];
        for (int a = 0; a < 3; ++a) {
            for (int b = 0; b < 3; ++b) {
                const int p = (b + 1) % 3, q = (b + 2) % 3, r = (a + 1) % 3, s = (a + 2) % 3;
                adjugate[a][b] = m[p][r] * m[q][s] - m[p][s] * m[q][r];
            }
        }
        const S determinant =
            m[0][0] * adjugate[0][0] + m[0][1] * adjugate[1][0] + m[0][2] * adjugate[2][0];
        for (int a = 0; a < 3; ++a) {
            for (int i = 0; i < kMostWheels; ++i) {
                const S row =
                    adjugate[a][0] * j[i][0] + adjugate[a][1] * j[i][1] + adjugate[a][2] * j[i][2];
                inverse_[a][i] = row / determinant * c_.wheel_radius_m[i];
            }
        }
    }

    void add_axle(S (&m)[3][3]) const {
        using std::cos;
        using std::sin;
        const S &first = c_.wheel_angle_rad[0];
        S across(0.0);
        for (const S &bearing : c_.wheel_angle_rad) {
            const S sine = sin(bearing - first);
            across = across + select(bearing == bearing, sine * sine, S(0.0));
        }
        const S axle[2] = {cos(first), sin(first)};
        for (int a = 0; a < 2; ++a)
            for (int b = 0; b < 2; ++b)
                m[a][b] = m[a][b] + select(across < S(kParallel), axle[a] * axle[b], S(0.0));
    }

    Constants<S, kMotors> c_;
    S encoder_rate_[kMotors], standing_[kMotors]; /* per wheel angle; speeds of motors */
    S jacobian_[kMostWheels][3], inverse_[3][kMostWheels];
    ActiveEffects<S, kMotors, kOdometry> active_;
};

/* Encoder rates of a log, each held from its row to the next (the first also before, the last also
 * after), on average over the moments that the camera shows between begin and end. */
template <class S>
class ShownCommands {
  public:
    ShownCommands(const OdometryPlant<S> &plant, const double *time_s, const double *command,
                  long row, long rows)
        : plant_(plant), time_s_(time_s), command_(command), row_(row), rows_(rows) {}

    void operator()(double begin_s, double end_s, S *command) const {
        const auto &c = plant_.constants();
        for (int i = 0; i < kMostWheels; ++i) {
            command[i] = S(command_[row_ * kMostWheels + i]);
            if (plant_.shifts_time()) {
                command[i] = from_lanes<S>([&](int k) {
                    const double delay_s = lane(c.pose_delay_s, k);
                    const double pace = 1.0 - lane(c.clock_fraction, k);
                    return mean(i, pace * begin_s - delay_s, pace * end_s - delay_s);
                });
            }
        }
    }

  private:
    double mean(int wheel, double begin_s, double end_s) const {
        long row = row_;
        while (row > 0 && time_s_[row] > begin_s)
            --row;
        while (row + 1 < rows_ && time_s_[row + 1] <= begin_s)
            ++row;
        double sum = 0.0;
        for (double from_s = begin_s; from_s < end_s; ++row) {
            const bool last = row + 1 >= rows_;
            const double to_s = last ? end_s : std::min(end_s, time_s_[row + 1]);
            sum += (to_s - from_s) * command_[row * kMostWheels + wheel];
            from_s = to_s;
        }
        return sum / (end_s - begin_s);
    }

    const OdometryPlant<S> &plant_;
    const double *time_s_, *command_;
    long row_, rows_;
};

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
