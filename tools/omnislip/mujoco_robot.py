"""The robot of a model file in MuJoCo: an independent engine, for tests and `tools/bench`.

An omnidirectional wheel is a thin capsule that turns about its axle. MuJoCo aligns the first
friction axis of a capsule's contact with a plane with the capsule's axis, so its anisotropic
friction is: the rollers' friction along the axle, the drive's friction across it. The chassis'
centre of gravity lies on the floor, as the plant without load transfer has it, and carries all the
mass. A motor is an actuator with gain n k2 V / Ra and bias -n^2 k2 k3 / Ra per wheel speed; the
rotor's inertia n^2 J0 and friction n^2 b0 are the joint's.

Not the same physics: MuJoCo's friction is Coulomb's on an ellipse, almost without creep, where the
plant's saturates as (2/pi) atan(k s) in each direction.
"""

from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Mass and inertia of a wheel's capsule: MuJoCo wants some; a millionth of the robot's.
_SPECK = 'mass="1e-5" diaginertia="1e-8 1e-8 1e-8"'
_HALF_WIDTH_M = 1e-3
# A robot that slides on MuJoCo's soft contacts hops; this keeps it down and carries no weight.
_VERTICAL_DAMPING_N_S_M = 1e5


def robot_xml(values: Mapping[str, float], step_s: float) -> str:
    """Return the MJCF text; values: model file keys of a robot, as Model.to_core() gives them."""
    gear, resistance = values["motor.gear_ratio"], values["motor.resistance_ohm"]
    torque_constant = values["motor.torque_constant_nm_a"]
    gain = gear * torque_constant * values["motor.supply_v"] / resistance
    bias = -(gear**2) * torque_constant * values["motor.back_emf_constant_v_s_rad"] / resistance
    radius = values["robot.wheel_radius_m"]
    wheels, pairs, motors = [], [], []
    for i in range(4):
        angle = np.radians(values[f"robot.wheel_angles_deg[{i}]"])
        axle = np.array([np.cos(angle), np.sin(angle)])
        x, y = values["robot.wheel_distance_m"] * axle
        end_x, end_y = _HALF_WIDTH_M * axle
        wheels.append(
            f'<body pos="{x} {y} {radius}"><inertial pos="0 0 0" {_SPECK}/>'
            f'<joint name="w{i}" type="hinge" axis="{-axle[0]} {-axle[1]} 0"'
            f' armature="{gear**2 * values["motor.inertia_kg_m2"]}"'
            f' damping="{gear**2 * values["motor.viscous_friction_nm_s"]}"/>'
            f'<geom name="g{i}" type="capsule" size="{radius}"'
            f' fromto="{-end_x} {-end_y} 0 {end_x} {end_y} 0" contype="0" conaffinity="0"/></body>'
        )
        pairs.append(
            f'<pair geom1="floor" geom2="g{i}" condim="3" solref="0.02 1"'
            f' friction="{values["contact.mu_roller"]} {values["contact.mu_drive"]} 0 0 0"/>'
        )
        motors.append(
            f'<general joint="w{i}" gainprm="{gain}" biastype="affine" biasprm="0 0 {bias}"'
            ' ctrllimited="true" ctrlrange="-1 1"/>'
        )
    inertia = values["robot.inertia_kg_m2"]
    return f"""<mujoco>
      <option timestep="{step_s}" gravity="0 0 {-values["contact.gravity_m_s2"]}"
              integrator="implicitfast" cone="elliptic" impratio="10"/>
      <worldbody>
        <geom name="floor" type="plane" size="50 50 1" contype="0" conaffinity="0"/>
        <body name="robot">
          <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
          <joint type="slide" axis="0 0 1" damping="{_VERTICAL_DAMPING_N_S_M}"/>
          <joint type="hinge" axis="0 0 1"/>
          <inertial pos="0 0 0" mass="{values["robot.mass_kg"]}"
                    diaginertia="{inertia} {inertia} {inertia}"/>
          {"".join(wheels)}
        </body>
      </worldbody>
      <contact>{"".join(pairs)}</contact>
      <actuator>{"".join(motors)}</actuator>
    </mujoco>"""


class MujocoRobot:
    """The robot at the origin, at rest."""

    def __init__(self, values: Mapping[str, float], step_s: float = 1e-3) -> None:
        self.step_s = step_s
        self.gear_ratio = values["motor.gear_ratio"]
        self.model = mujoco.MjModel.from_xml_string(robot_xml(values, step_s))
        self.data = mujoco.MjData(self.model)

    def move(self, velocity_m_s: tuple[float, float]) -> None:
        """Set the velocity of the body in the world frame."""
        self.data.qvel[:2] = velocity_m_s

    def drive(self, duty: Array, duration_s: float) -> None:
        """Run under a constant duty (4,)."""
        self.data.ctrl[:] = duty
        mujoco.mj_step(self.model, self.data, round(duration_s / self.step_s))

    def pose(self) -> Array:
        """Return x [m], y [m], heading [rad]."""
        return self.data.qpos[[0, 1, 3]].copy()

    def velocity(self) -> Array:
        """Return vx, vy in the world frame [m/s] and the turn rate [rad/s]."""
        return self.data.qvel[[0, 1, 3]].copy()

    def shaft_speed_rad_s(self) -> Array:
        """Return the shaft speeds (4,)."""
        return self.gear_ratio * self.data.qvel[4:8]
