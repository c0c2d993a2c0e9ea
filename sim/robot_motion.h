/* robot_motion.h - the plant of one robot and its integrator, compiled for several instruction
 * sets.
 *
 * With wide registers a step computes the four wheels at once. Results of two instruction sets
 * differ by rounding only; on one processor all runs take the same.
 *
 * State x: RobotLayout::kAll numbers (robot_plant.h).
 */
#ifndef OMNISLIP_SIM_ROBOT_MOTION_H
#define OMNISLIP_SIM_ROBOT_MOTION_H

#include <memory>

#include "robot_plant.h"

namespace omnislip {

/* The duties up to the present one, `row`: four each from its time on. */
struct DutyHistory {
    const double *time_s, *duty;
    long row;
};

/* The way that the body went up to each time, the present one at `row`: x, y, theta each. */
struct WayHistory {
    const double *time_s, *way;
    long row;
};

enum class Rule { kRk4, kMerson }; /* integrator.h */

class RobotMotion {
  public:
    virtual ~RobotMotion() = default;
    /* Whether the memory behind the states is in use, and whether commands act late. */
    virtual bool remembers() const = 0;
    virtual bool delays() const = 0;
    /* Whether the camera shows the pose of another moment. */
    virtual bool shows_late() const = 0;
    /* Fills the memory as if the duty had lasted for long. */
    virtual void settle(double *x, const double *duty, RobotInternals<double> &in) const = 0;
    /* Internals at an instant. */
    virtual void look(const double *x, const DutyHistory &duties, double time_s,
                      RobotInternals<double> &in) = 0;
    /* What the sensors show, y [RobotLayout::kOutputs]; the way is read by a late camera only. */
    virtual void output(const double *x, double time_s, const WayHistory &way, double *y) const = 0;
    /* Runs x on in steps of at most step_s. `looked`: `look` was at this instant, and not yet used
     * so; not with memory or delays. */
    virtual void advance(double *x, const DutyHistory &duties, double time_s, double duration_s,
                         double step_s, Rule rule, bool looked, RobotInternals<double> &in) = 0;
    /* Adds an impulse, given in the world frame at the centre of gravity, to the velocity. */
    virtual void push(double *x, double x_n_s, double y_n_s, double theta_n_m_s) const = 0;
};

/* The widest that this processor and `widest_lanes` doubles allow. `values`: parameter set of
 * RobotPlant; both must outlive the result. Throws std::invalid_argument for a robot too stiff to
 * simulate. */
std::unique_ptr<RobotMotion> make_robot_motion(const double *values, int size,
                                               const UserTermList &terms, int widest_lanes = 4);

}  // namespace omnislip

#endif
