"""BAM XL330: a position servo with a pendulum, 16 records of 6 s at about 190 Hz.

Source: Rhoban, "Better Actuator Models"; M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended
Friction Models for the Physics Simulation of Servo Actuators", ICRA 2025 (arXiv 2410.08650).
Four gains of the position loop (100 to 800) times four trajectories; in `lift_and_drop` the drive
is switched off and the pendulum falls: a blank command.

The servo shows the duty it applies (`load`, +-885 = all) and its supply in steps of 0.1 V; their
product is the command in volt.

The model is what the maker's data sheet (Robotis XL330-M288) and the rig say: stall torque 0.52 N m
and no-load speed 10.8 rad/s at 5 V, pendulum of 0.49 kg at 0.1 m, and for the gear train's inertia
a fifth of the pendulum's; no friction.
"""

import gzip
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from omnislip.errors import InputError
from omnislip.log_file import Log, write_log
from omnislip.model_file import Effect, Model, write_model

Array = npt.NDArray[np.float64]

MASS_KG, LENGTH_M = 0.49, 0.1
STALL_NM, NO_LOAD_RAD_S, RATED_V = 0.52, 10.8, 5.0
FULL_DUTY = 885.0
COUNTS_PER_RAD = 4096 / (2 * np.pi)
DUTY_PER_COUNT_AND_GAIN = 1 / (256 * FULL_DUTY)
BELIEVED = Model(
    kind="axis",
    name="bam_xl330",
    values={
        "axis.inertia_kg_m2": 1.2 * MASS_KG * LENGTH_M**2,
        "axis.input_gain_nm_v": STALL_NM / RATED_V,
        "axis.back_emf_nm_s_rad": STALL_NM / NO_LOAD_RAD_S,
        "axis.pendulum_mass_kg": MASS_KG,
        "axis.pendulum_length_m": LENGTH_M,
    },
    tolerance={
        "default": 0.15,
        "axis.pendulum_mass_kg": 0.005,
        "axis.pendulum_length_m": 0.01,
    },
)


# bam/params/xl330/m1.json of the authors' repository, commit 1b5a1ce.
PUBLISHED_M1 = {
    "kt": 0.3866957639281311,
    "R": 4.017129222290597,
    "armature": 0.0018141672784458866,
    "q_offset": 0.030871000250528358,
    "friction_base": 0.01283272036582759,
    "friction_viscous": 0.003661672282824312,
}


@dataclass(frozen=True)
class Record:
    """One record; every array (n,): `on` says whether the drive was switched on."""

    name: str
    gain: float
    t_s: Array
    position_rad: Array
    goal_rad: Array
    duty: Array
    supply_v: Array
    on: npt.NDArray[np.bool_]


def servo_duty(gain: float, error_rad: Array) -> Array:
    """Return the duty that the servo's position loop makes of an error, |duty| <= 1."""
    return np.clip(gain * COUNTS_PER_RAD * DUTY_PER_COUNT_AND_GAIN * error_rad, -1.0, 1.0)


def read_records(data: Path) -> list[Record]:
    """Return the records in `data`/bam_xl330 in the order in which they were taken."""
    paths = sorted((data / "bam_xl330").glob("raw_*.json.gz"))
    if not paths:
        raise InputError(
            f"{data / 'bam_xl330'}: no raw_*.json.gz there; fetch them with tools/fetch-data, or "
            "name their folder with --data"
        )
    return [_read_record(path) for path in paths]


def import_bam(data: Path, out: Path) -> list[Path]:
    """Write one log per record and bam_xl330.toml to `out`; returns the paths written.

    InputError if a file is missing or not as the authors publish it; nothing is written then.
    """
    written = []
    for number, record in enumerate(read_records(data), 1):
        log = _to_log(record, number)
        written.append(out / f"{log.name}.csv")
        write_log(log, written[-1])
    written.append(out / "bam_xl330.toml")
    write_model(BELIEVED, written[-1])
    return written


def published_model() -> Model:
    """Return the authors' model M1: Coulomb and viscous friction."""
    found = PUBLISHED_M1
    gain = found["kt"] / found["R"]
    values = {
        "axis.inertia_kg_m2": found["armature"] + MASS_KG * LENGTH_M**2,
        "axis.input_gain_nm_v": gain,
        "axis.back_emf_nm_s_rad": found["kt"] * gain,
        "axis.viscous_friction_nm_s_rad": found["friction_viscous"],
        "axis.pendulum_mass_kg": MASS_KG,
        "axis.pendulum_length_m": LENGTH_M,
    }
    effects = [
        Effect("coulomb_friction", {"torque_nm": found["friction_base"]}),
        Effect("pendulum_zero_error", {"angle_rad": -found["q_offset"]}),
    ]
    return Model("axis", values, effects=effects)


def _to_log(record: Record, number: int) -> Log:
    volts = np.where(record.on, record.duty * record.supply_v, np.nan)
    columns = {"axis/command": volts, "axis/position_rad": record.position_rad}
    return Log(f"{number:02d}_{record.name}", record.t_s, columns)


def _read_record(path: Path) -> Record:
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            content = json.load(file)
        entries = content["entries"]
        if (content["mass"], content["length"]) != (MASS_KG, LENGTH_M):
            raise ValueError(f"mass and length are not {MASS_KG} kg and {LENGTH_M} m")

        def column(key: str) -> Array:
            return np.array([entry[key] for entry in entries], dtype=np.float64)

        load = column("load")
        record = Record(
            f"kp{content['kp']}_{content['trajectory']}",
            float(content["kp"]),
            column("timestamp"),
            column("position"),
            column("goal_position"),
            np.where(load > 32767, load - 65536, load) / FULL_DUTY,  # two's complement
            column("input_volts"),
            column("torque_enable") > 0,
        )
    except (OSError, EOFError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not a record of BAM: {error}") from None
    if np.abs(record.duty).max() > 1.01 or not 3.0 < record.supply_v.mean() < 12.0:
        raise InputError(f"{path}: not a record of the XL330: load or supply out of range")
    return record
