/* rigid_model.h - the robot whose wheels do not slip: eqs. (2)-(10), corrected. The model "before".
 *
 * State x (6): body velocity V = (vx, vy, w) [m/s, m/s, rad/s] in the body frame; world pose
 * (x, y, theta) [m, m, rad]. Input u (4): motor voltages [V].
 *
 *   wheels    V_w = J V, row i of J = (d_i, lever of d_i)                                (3)
 *             nominal geometry: J'J = diag(1, 3, 4 L^2), J+ = (J'J)^-1 J', J' n = 0 for
 *             n = (1, -1, 1, -1)
 *   shafts    no slip: W = G V, G = diag(n / R_i) J
 *   body      A V' + m w (-vy, vx, 0) = J' f,  A = diag(m, m, Iz)                     (4), (5)
 *   motor     J0 W' + b0 W + (R/n) f = k2 i,   i = (u - k3 W) / Ra                    (7), (8)
 *   world     (x, y)' = T(theta) (vx, vy), theta' = w                                    (2)
 *
 * The motor equation gives f = (n/R) (k2 i - b0 W - J0 W'). With J' diag(n/R) = G' and W' = G V'
 *
 *   (A + G' J0 G) V' + G' (b0 + k2 k3 / Ra) G V + m w (-vy, vx, 0) = G' (k2 / Ra) u      (10)
 *
 * For equal wheels that is n^2 J0 / R^2 J'J, n^2 / R^2 (b0 + k2 k3 / Ra) J'J and k2 n / (Ra R) J'
 * u. The paper prints n for n^2, a rotation T in front of H = J' and m for Iz: see sim/README.md.
 * The rotors' inertia is in V', not in the velocity product: only the body's momentum turns with
 * the frame. Rollers are free; the centre of gravity is the centre of the wheels.
 */
#ifndef OMNISLIP_SIM_RIGID_MODEL_H
#define OMNISLIP_SIM_RIGID_MODEL_H

#include <Eigen/Dense>

#include "effects.h"

namespace omnislip {

using WheelMap = Eigen::Matrix<double, 4, 3>;

/* J of (3): speed of the wheel hubs along their drive directions per body velocity. */
inline WheelMap wheel_jacobian(const Constants<double, 4> &c) {
    WheelMap jacobian;
    for (int i = 0; i < 4; ++i) {
        const double direction = c.wheel_angle_rad[i] + c.roller_angle_offset_rad[i];
        const double lever_m = c.wheel_distance_m * std::cos(c.roller_angle_offset_rad[i]);
        jacobian.row(i) << -std::sin(direction), std::cos(direction), lever_m;
    }
    return jacobian;
}

/* Body velocity that fits four wheel speeds best: the left inverse of a matrix of rank 3. */
inline Eigen::Matrix<double, 3, 4> pseudo_inverse(const WheelMap &jacobian) {
    return (jacobian.transpose() * jacobian).ldlt().solve(jacobian.transpose());
}

struct RigidInternals {
    Eigen::Vector4d shaft_speed_rad_s, current_a;
    Eigen::Vector4d traction_n; /* force along d_i that keeps wheel i from slipping */
};

/* A plant for integrator.h whose command is the motor voltages. */
class RigidModel {
  public:
    static constexpr int kMotors = 4;
    static constexpr int kStates = 6;
    enum StateIndex { kVelocity = 0, kPose = 3 };

    explicit RigidModel(const Constants<double, 4> &c) : c_(c), jacobian_(wheel_jacobian(c)) {
        using Eigen::Map;
        using Eigen::Vector4d;
        gear_1_m_ = c.gear_ratio / Map<const Vector4d>(c.wheel_radius_m).array();
        shaft_map_ = gear_1_m_.asDiagonal() * jacobian_;
        const Map<const Vector4d> rotor_kg_m2(c.shaft_inertia_kg_m2);
        const Map<const Vector4d> torque_constant_nm_a(c.torque_constant_nm_a);
        const Map<const Vector4d> back_emf_v_s_rad(c.back_emf_constant_v_s_rad);
        const Vector4d drag_nm_s =
            Map<const Vector4d>(c.viscous_friction_nm_s) +
            torque_constant_nm_a.cwiseProduct(back_emf_v_s_rad) / c.resistance_ohm;
        mass_ = shaft_map_.transpose() * rotor_kg_m2.asDiagonal() * shaft_map_;
        mass_.diagonal() += Eigen::Vector3d(c.mass_kg, c.mass_kg, c.inertia_kg_m2);
        damping_ = shaft_map_.transpose() * drag_nm_s.asDiagonal() * shaft_map_;
        input_ = shaft_map_.transpose() * (torque_constant_nm_a / c.resistance_ohm).asDiagonal();
        inverse_mass_ = mass_.inverse();
    }

    const WheelMap &jacobian() const {
        return jacobian_;
    }
    /* A + G' J0 G: kg, kg, kg m^2 on the diagonal. */
    const Eigen::Matrix3d &mass_matrix() const {
        return mass_;
    }
    /* G' (b0 + k2 k3 / Ra) G: force per velocity. */
    const Eigen::Matrix3d &damping_matrix() const {
        return damping_;
    }
    /* G' k2 / Ra: force per volt. */
    const Eigen::Matrix<double, 3, 4> &input_map() const {
        return input_;
    }

    /* m w (-vy, vx, 0): what the turning of the body frame adds to m V'. */
    Eigen::Vector3d velocity_product(const Eigen::Vector3d &v) const {
        return c_.mass_kg * v[2] * Eigen::Vector3d(-v[1], v[0], 0.0);
    }

    Eigen::Vector3d acceleration(const Eigen::Vector3d &v, const Eigen::Vector4d &voltage_v) const {
        return inverse_mass_ * (input_ * voltage_v - damping_ * v - velocity_product(v));
    }

    void command(const double *voltage_v, double *driven) const {
        for (int i = 0; i < kMotors; ++i) {
            driven[i] = voltage_v[i];
        }
    }

    void derivative(const double *x, const double *voltage_v, const double &, double *dx,
                    RigidInternals &in) const {
        const Eigen::Map<const Eigen::Vector3d> v(x + kVelocity);
        const Eigen::Map<const Eigen::Vector4d> u(voltage_v);
        const double theta = x[kPose + 2];
        const Eigen::Vector3d change = acceleration(v, u);
        Eigen::Map<Eigen::Vector3d>(dx + kVelocity) = change;
        dx[kPose] = std::cos(theta) * v[0] - std::sin(theta) * v[1];
        dx[kPose + 1] = std::sin(theta) * v[0] + std::cos(theta) * v[1];
        dx[kPose + 2] = v[2];
        motors(v, u, change, in);
    }

  private:
    /* (7) and (8) solved for what the constraint hides. */
    void motors(const Eigen::Vector3d &v, const Eigen::Vector4d &u, const Eigen::Vector3d &change,
                RigidInternals &in) const {
        in.shaft_speed_rad_s = shaft_map_ * v;
        const Eigen::Vector4d shaft_change_rad_s2 = shaft_map_ * change;
        for (int i = 0; i < kMotors; ++i) {
            const double speed = in.shaft_speed_rad_s[i];
            in.current_a[i] = (u[i] - c_.back_emf_constant_v_s_rad[i] * speed) / c_.resistance_ohm;
            in.traction_n[i] = gear_1_m_[i] * (c_.torque_constant_nm_a[i] * in.current_a[i] -
                                               c_.viscous_friction_nm_s[i] * speed -
                                               c_.shaft_inertia_kg_m2[i] * shaft_change_rad_s2[i]);
        }
    }

    Constants<double, 4> c_;
    WheelMap jacobian_, shaft_map_;
    Eigen::Vector4d gear_1_m_; /* n / R: shaft speed per speed of the rim */
    Eigen::Matrix3d mass_, inverse_mass_, damping_;
    Eigen::Matrix<double, 3, 4> input_;
};

}  // namespace omnislip

#endif
