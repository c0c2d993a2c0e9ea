/* robot_motion.cpp - robot_motion.h for one instruction set, OMNISLIP_ARCH (an xsimd architecture).
 */
#include "robot_motion.h"

#include <cmath>

#include "integrator.h"

namespace omnislip {
namespace {

class Motion final : public RobotMotion {
    using Plant = RobotPlant<double>;
    using Internals = RobotInternals<double>;

  public:
    Motion(const double *values, int size, const UserTermList &terms) {
        bool active[kEffectCount];
        mark_active<Plant>(values, 1, size, active);
        plant_.prepare(values, active, terms);
        rate_1_s_ = plant_.fastest_rate_1_s();
        require_rate(rate_1_s_);
    }

    bool remembers() const override {
        return plant_.remembers();
    }
    bool delays() const override {
        return plant_.delays();
    }
    bool shows_late() const override {
        return plant_.shows_late();
    }

    void settle(double *x, const double *duty, Internals &in) const override {
        omnislip::settle(plant_, x, duty, 0.0, in);
    }

    void look(const double *x, const DutyHistory &duties, double time_s, Internals &in) override {
        double duty[Plant::kMotors];
        commands(duties)(time_s, time_s, duty);
        plant_.begin_step(x, duty, 0.0, begin_.step);
        plant_.derivative(x, begin_.step, time_s, begin_.derivative, in);
    }

    void output(const double *x, double time_s, const WayHistory &way, double *y) const override {
        double since[3];
        if (plant_.shows_late())
            way_since(way.time_s, way.way, way.row, plant_.late_s(time_s), since);
        plant_.output(x, time_s, y, since);
    }

    void advance(double *x, const DutyHistory &duties, double time_s, double duration_s,
                 double step_s, Rule rule, bool looked, Internals &in) override {
        Begin<Plant, double> *begun = looked ? &begin_ : nullptr;
        if (rule == Rule::kRk4)
            omnislip::advance<Rk4>(plant_, x, commands(duties), time_s, duration_s, step_s,
                                   rate_1_s_, in, begun);
        else
            omnislip::advance<Merson>(plant_, x, commands(duties), time_s, duration_s, step_s,
                                      rate_1_s_, in, begun);
    }

    void push(double *x, double x_n_s, double y_n_s, double theta_n_m_s) const override {
        const auto &c = plant_.constants();
        const double theta = x[Plant::kPose + 2];
        const double cos_theta = std::cos(theta), sin_theta = std::sin(theta);
        const double jx = cos_theta * x_n_s + sin_theta * y_n_s;
        const double jy = cos_theta * y_n_s - sin_theta * x_n_s;
        const double turn = theta_n_m_s / c.inertia_kg_m2;
        double *v = x + Plant::kVelocity;
        v[0] += jx / c.mass_kg + turn * c.cog_y_m;
        v[1] += jy / c.mass_kg - turn * c.cog_x_m;
        v[2] += turn;
    }

  private:
    LoggedCommands<Plant> commands(const DutyHistory &duties) const {
        return {plant_, duties.time_s, duties.duty, duties.row};
    }

    Plant plant_;
    Begin<Plant, double> begin_;
    double rate_1_s_;
};

}  // namespace

#define OMNISLIP_JOIN2(a, b) a##b
#define OMNISLIP_JOIN(a, b) OMNISLIP_JOIN2(a, b)

RobotMotion *OMNISLIP_JOIN(make_robot_motion_, OMNISLIP_ARCH)(const double *values, int size,
                                                              const UserTermList &terms) {
    return new Motion(values, size, terms);
}

}  // namespace omnislip
