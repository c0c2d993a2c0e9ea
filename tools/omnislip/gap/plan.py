"""`omnislip gap plan`: the manoeuvre that tells apart effects which the logs so far cannot.

Every manoeuvre of a library is driven by the firmware in the simulator, in closed loop, with one of
the rivals as truth, its size cut until it keeps to the room and the speed limit. On the log without
sensor noise the other rivals are fitted. With r the whitened innovations and z_believed the
deviations of the believed keys, as in inference.py,

    separation  L_jk = min over z of |r_k(z) - r_j|^2 + |z_believed|^2

is the expected lead of the truth j over k: noise adds the same to both. Measured, the lead is
normal with mean L and variance 4 L (twice the projection of white noise on a difference of length
sqrt(L)), so the right one comes out ahead with probability Phi(sqrt(L) / 2). (T-optimality:
Atkinson and Fedorov, Biometrika 1975.) Where logs are at hand, what they say of the rival's
parameters stays known: with J its derivative there, |J z|^2 is added, and one linear step is
enough.

The best manoeuvre is the one with the largest separation per second of those that are as good as
certain, else the one with the largest separation.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space
from scipy.stats import norm

from omnislip.errors import InputError
from omnislip.files import nearest, write_text
from omnislip.gap.inference import Data, Fit, Hypothesis, fit, linearise, objective
from omnislip.gap.machine import PATCH, Candidate, Machine, effect_and_wheel, name_on_wheel
from omnislip.gap.noise import Noise, first_guess
from omnislip.gap.recordings import (
    ELECTRIC_CHANNELS,
    ROBOT_CHANNELS,
    Run,
    make_run,
    robot_channels,
    wheel_jacobian,
)
from omnislip.log_file import Log
from omnislip.model_file import WIRING, Model, read_model
from omnislip.scenario import CONTROL_RATE_HZ, Scenario, Sensors, format_scenario
from omnislip.simulate import make_log, simulate_truth

Array = npt.NDArray[np.float64]
Part = tuple[float, str, Sequence[float]]
"""Seconds, kind of command, value."""

NOT_DRIVEN = (*WIRING, "impact")
"""What no manoeuvre is for: mistakes of wiring, and pushes."""
CERTAIN = 100.0
"""Separation from which on more is not better: the wrong one is ahead once in four million."""
LEAST_SEPARATION = 4.0
"""Separation below which a manoeuvre is no answer: the wrong one is ahead once in six times."""
ENOUGH = 0.99
"""Probability of the right answer that settles it."""
REST_S = 0.4
MOST_TURN_RAD_S = 6.0
FIT_ITERATIONS = 5
TRIES_TO_FIT_THE_ROOM = 4
TYPICAL_SENSORS = Sensors(
    gyro_noise_rad_s=0.003,
    pose_noise_m=0.001,
    pose_noise_rad=0.002,
    supply_noise_v=0.02,
    current_noise_a=0.1,
)
MOVED_IN_ROWS = 0.1
"""Share of what commands change from row to row, squared, that moves them within rows unknown to
their means: logs driven smoothly in open loop show 0.05 to 0.1, steps where rows begin nothing."""


@dataclass(frozen=True)
class Limits:
    """Where the robot may go: a square room it starts in the middle of, and its speed."""

    room_m: float = 3.0
    speed_m_s: float = 1.0


@dataclass(frozen=True)
class Question:
    """Effects to tell apart, by the names of their candidates.

    `sizes`: {effect: {parameter: value}} as found in logs; the others get typical ones. `channels`:
    what the robot logs.
    """

    names: list[str]
    sizes: dict[str, dict[str, float]] = field(default_factory=dict)
    channels: tuple[str, ...] = ROBOT_CHANNELS


@dataclass(frozen=True)
class Manoeuvre:
    """Commands for the firmware, as a scenario has them."""

    name: str
    summary: str
    duration_s: float
    commands: list[dict[str, Any]]


@dataclass(frozen=True)
class Separation:
    """What one manoeuvre would tell: L of the pair that it tells apart worst."""

    manoeuvre: Manoeuvre
    separation: float
    reach_m: float
    """Farthest from the start along x or y."""

    @property
    def tells(self) -> bool:
        """Whether it is worth driving."""
        return self.separation >= LEAST_SEPARATION

    @property
    def probability(self) -> float:
        """Probability that the right one of two rivals comes out ahead."""
        return float(norm.cdf(np.sqrt(max(self.separation, 0.0)) / 2))

    @property
    def drives(self) -> float:
        """How often to drive it until the right one is `ENOUGH` probable: separations add."""
        asked = (2.0 * norm.ppf(ENOUGH)) ** 2
        return float(np.ceil(asked / self.separation)) if self.separation > 0 else np.inf

    def as_json(self) -> dict[str, Any]:
        """Return it as gap.json has it."""
        return {
            "name": self.manoeuvre.name,
            "duration_s": self.manoeuvre.duration_s,
            "expected_separation": self.separation,
            "probability_of_right": self.probability,
        }


def library(machine: Machine, limits: Limits, size: float = 1.0) -> list[Manoeuvre]:
    """Return the manoeuvres, speeds and duties times `size`."""
    v = size * limits.speed_m_s
    distance_m = float(machine.model.values["robot.wheel_distance_m"])
    turn = min(v / distance_m, MOST_TURN_RAD_S)
    leg_s = min(1.0, 0.35 * limits.room_m / limits.speed_m_s)
    x, y, spin = np.eye(3) * (v, v, turn)
    compass = [np.array([v * np.cos(a), v * np.sin(a), 0.0]) for a in np.arange(8) * np.pi / 4]
    jacobian = wheel_jacobian(machine)
    push = [column / np.abs(column).max() for column in jacobian.T]
    twist = null_space(jacobian.T)[:, 0]
    twist = twist / np.abs(twist).max()

    def drive(velocity: Array, seconds: float) -> list[Part]:
        return [(seconds, "velocity", velocity)]

    def to_and_fro(velocity: Array, seconds: float) -> list[Part]:
        return drive(velocity, seconds) + drive(-velocity, seconds)

    def duty(direction: Array, amount: float, seconds: float) -> list[Part]:
        return [(seconds, "duty", size * amount * direction)]

    def staircase(
        velocities: Iterable[Array], steps: Sequence[float], seconds: float
    ) -> list[Part]:
        return [p for one in velocities for s in steps for p in to_and_fro(s * one, seconds)]

    stop: list[Part] = [(0.6, "duty", np.zeros(4))]
    half = 0.4 * limits.room_m
    rows = [(-half, -half), (half, -half), (half, 0), (-half, 0), (-half, half), (half, half)]
    generator = np.random.default_rng(1)
    chips = [generator.choice([-0.15, 0.15]) for _ in range(60)]
    made = {
        "staircase": ("straight on, slowly and fast", staircase([x, y], (0.1, 0.3, 1.0), leg_s)),
        "headings": ("to and fro in eight directions", staircase(compass[:4], (0.6,), leg_s)),
        "turned_headings": (
            "the same with the body turned half round",
            drive(spin / 2, 2 * np.pi / turn) + staircase(compass[:4], (0.6,), leg_s),
        ),
        "spins": ("turning on the spot, slowly and fast", staircase([spin], (0.1, 0.3, 1.0), 0.8)),
        "twist": (
            "wheels against each other, growing: slip without motion",
            [
                p
                for d in (0.05, 0.1, 0.2, 0.3, 0.45)
                for s in (1, -1)
                for p in duty(twist, s * d, 0.3)
            ],
        ),
        "multisine": ("all directions at once, many frequencies", _multisine((v, v, turn))),
        "reversals": (
            "hard reversals that grow",
            [p for a in (0.25, 0.5, 1.0) for one in (x, y, spin) for p in to_and_fro(a * one, 0.4)],
        ),
        "slip_steps": (
            "duty steps beyond the grip along x, y and round",
            [
                p
                for d in push
                for a in (0.1, -0.1, 0.35, -0.35)
                for p in duty(d, a, 0.5 if abs(a) < 0.2 else 0.25)
            ],
        ),
        "coast_down": (
            "up to speed, then the command 0",
            [p for one in (x, -x, y, -y, spin, -spin) for p in drive(one, leg_s) + stop],
        ),
        "circles": (
            "circles, growing speed",
            [
                p
                for s in (0.3, 0.6, 1.0)
                for sense in (1, -1)
                for p in drive(s * (x + sense * spin / 2), 1.6)
            ],
        ),
        "lanes": (
            "lanes over the whole room",
            [(2 + 0.8 * half / v, "pose", [px * size, py * size, 0.0]) for px, py in rows],
        ),
        "chips": (
            "small sharp steps of the duty at random",
            [p for k, c in enumerate(chips) for p in duty(push[k % 3], c, 0.04 + 0.02 * (k % 4))],
        ),
        "creep": ("crawling, many reversals", staircase([x, y, spin], (0.03, 0.06, 0.1), 0.35)),
        "endurance": (
            "half a minute at full speed, then a rest",
            [p for _ in range(8) for one in (x, y) for p in to_and_fro(one, leg_s)] + stop,
        ),
    }
    return [_manoeuvre(name, summary, parts) for name, (summary, parts) in made.items()]


def _multisine(most: Sequence[float]) -> list[Part]:
    """Odd harmonics of 0.25 Hz with random phases, another set for each direction; 8 s."""
    generator = np.random.default_rng(0)
    t_s = np.arange(0.0, 8.0, 0.05)
    wave = np.zeros((len(t_s), 3))
    for k in range(3):
        for harmonic in (1 + 2 * k, 7 + 2 * k, 13 + 2 * k):
            phase = generator.uniform(0, 2 * np.pi)
            wave[:, k] += np.sin(2 * np.pi * 0.25 * harmonic * t_s + phase) / 3
    return [(0.05, "velocity", row) for row in wave * np.asarray(most)]


def _manoeuvre(name: str, summary: str, parts: Sequence[Part]) -> Manoeuvre:
    """Put the parts between a rest before and a rest behind them."""
    commands: list[dict[str, Any]] = []
    begin_s = REST_S
    for seconds, kind, value in parts:
        numbers = [round(float(number), 6) for number in value]
        if kind == "pose":
            numbers += [0.0, 0.0, 0.0]
        commands.append({"t_s": round(begin_s, 3), "kind": kind, "value": numbers})
        begin_s += seconds
    commands.append({"t_s": round(begin_s, 3), "kind": "stop", "value": []})
    return Manoeuvre(name, summary, round(begin_s + REST_S, 2), commands)


class Expected(Data):
    """A log without noise: residuals in units of the noise, less those of the truth.

    The truth's own are not quite 0: rows hold mean duties and counts are whole.
    """

    _tells_rises = False  # that of a robot without noise is no promise
    _own: Array | float = 0.0

    def __init__(self, machine: Machine, run: Run, noise: Noise, truth: Hypothesis) -> None:
        super().__init__(machine, [run], noise, truth, scale=1.0)
        self._own = super().residuals(truth.flat(machine.believed)[None])[0]

    def residuals(self, sets: Array) -> Array:
        """Return residuals (sets, m) less the truth's."""
        return super().residuals(sets) - self._own


class Rehearsal:
    """The library as this robot can drive it within the limits, and what its sensors would show."""

    def __init__(
        self, machine: Machine, limits: Limits, blank: Sequence[int] = (), rate_hz: int = 200
    ) -> None:
        self._machine, self._limits = machine, limits
        self._blank = list(blank)
        self._rate_hz = rate_hz

    def manoeuvres(self, model: Model) -> list[tuple[Manoeuvre, float]]:
        """Return the manoeuvres that fit, with their reach (m), as the robot of `model` drives."""
        found = []
        for number in range(len(library(self._machine, self._limits))):
            size = 1.0
            for _ in range(TRIES_TO_FIT_THE_ROOM):
                one = library(self._machine, self._limits, size)[number]
                truth = self._drive(model, one)
                reach = float(np.abs(truth["pose"][:, :2]).max())
                speed = float(np.hypot(*truth["velocity"][:, :2].T).max())
                excess = max(2 * reach / self._limits.room_m, speed / self._limits.speed_m_s / 1.1)
                if excess <= 1.0:
                    found.append((one, reach))
                    break
                size *= max(0.9 / excess, 0.3)
        return found

    def run(self, model: Model, manoeuvre: Manoeuvre, sensors: Sensors | None = None) -> Run:
        """Return what the sensors show (without noise unless `sensors` say so)."""
        scenario = self.scenario(model, manoeuvre)
        log = make_log(
            replace(scenario, sensors=sensors or Sensors()), self._drive(model, manoeuvre)
        )
        run = make_run(self._machine, log)
        if not self._blank:
            return run
        columns = {
            name: np.full(len(log.t_s), np.nan) if c in self._blank else log.columns[name]
            for c, name in enumerate(run.channels)
        }
        return make_run(self._machine, Log(log.name, log.t_s, log.columns | columns))

    def scenario(self, model: Model, manoeuvre: Manoeuvre) -> Scenario:
        """Return the scenario in which the robot of `model` drives the manoeuvre."""
        return Scenario(
            manoeuvre.name,
            manoeuvre.duration_s,
            model,
            manoeuvre.commands,
            rate_hz=self._rate_hz,
            pose_rate_hz=next(hz for hz in (50, 40, 25, 20, 10, 5, 1) if self._rate_hz % hz == 0),
        )

    def _drive(self, model: Model, manoeuvre: Manoeuvre) -> dict[str, Array]:
        """The firmware keeps the believed robot's parameters, whatever the robot is like."""
        return simulate_truth(self.scenario(model, manoeuvre), firmware_robot=self._machine.model)


def separating_manoeuvre(
    machine: Machine,
    data: Data,
    final: Hypothesis,
    name: str,
    rivals: Sequence[str],
) -> Separation | None:
    """Return the manoeuvre that tells an effect of the final model from its rivals.

    Uses what the logs of `data` say of the rivals. It may tell them no better than a coin. None if
    nothing can be driven: for other machines, against a patch in the floor that may be anywhere, or
    if this robot's numbers do not fit the firmware's formats.
    """
    if machine.kind != "robot" or PATCH in rivals:
        return None
    blank = [
        c
        for c in range(machine.engine.outputs)
        if all(np.isnan(run.outputs[:, c]).all() for run in data.runs)
    ]
    # The firmware is fast.
    machine = machine.of(machine.model, holds_commands=False)
    rehearsal = Rehearsal(machine, Limits(), blank, _rate_of(data.runs[0]))
    truth = _model_of(machine, final)
    without = final.without(final.place_of(name))
    fitted = [fit_rival(data, without, _named(machine, rival)) for rival in rivals]
    found = []
    try:
        manoeuvres = rehearsal.manoeuvres(truth)
    except InputError:
        return None
    for manoeuvre, reach in manoeuvres:
        new = Expected(machine, rehearsal.run(truth, manoeuvre), data.noise, final)
        leads = [_lead_with_logs(new, rival) for rival in fitted]
        found.append(Separation(manoeuvre, min(leads), reach))
    return next(iter(_ranked(found)), None)


def plan(
    model: Model, question: Question, limits: Limits, progress: Callable[[str], None]
) -> list[Separation]:
    """Rank the library by how well it answers the question, best first."""
    if model.kind != "robot":
        raise InputError(f"{model.path}: gap plan needs a model of kind 'robot'")
    names, sizes = list(dict.fromkeys(question.names)), question.sizes
    if len(names) < 2:
        raise InputError("gap plan needs at least two effects to tell apart")
    if PATCH in names and PATCH not in sizes:
        raise InputError(
            f"{PATCH}: nobody knows where to drive for a patch that may be anywhere; it can be "
            "planned for with a gap.json whose effects name it with its place (--gap)"
        )
    plain = Machine(model)
    taken = {(c.effect, c.wheel) for c in (_named(plain, name) for name in names)}
    kept = [e for e in model.effects if (e.name, e.wheel) not in taken]
    electric = any(channel in question.channels for channel in ELECTRIC_CHANNELS)
    machine = Machine(replace(model, effects=kept), electric)
    channels = robot_channels(machine)
    blank = [k for k, channel in enumerate(channels) if channel not in question.channels]
    if len(blank) == len(channels):
        raise InputError("the logs of the gap.json have none of the channels of a robot")
    rehearsal = Rehearsal(machine, limits, blank)
    truths = [_truth(machine, name, sizes.get(name)) for name in names]
    progress("fitting the manoeuvres into the room")
    models = [_model_of(machine, truth) for truth in truths]
    manoeuvres = rehearsal.manoeuvres(models[0])
    if not manoeuvres:
        raise InputError("no manoeuvre fits into this room at this speed")
    noise = typical_noise(machine, rehearsal.run(models[0], manoeuvres[0][0], TYPICAL_SENSORS))
    known = [name for name in names if name in sizes] or names
    found = []
    for number, (manoeuvre, reach) in enumerate(manoeuvres, 1):
        progress(f"rehearsing {manoeuvre.name} ({number} of {len(manoeuvres)})")
        leads = []
        for truth, own, name in zip(truths, models, names, strict=True):
            if name not in known:
                continue
            data = Expected(machine, rehearsal.run(own, manoeuvre), noise, truth)
            base = truth.without(0)
            rivals = [_named(machine, other) for other in names if other != name]
            leads += [fit_rival(data, base, rival).objective for rival in rivals]
        found.append(Separation(manoeuvre, min(leads), reach))
    return _ranked(found)


def typical_noise(machine: Machine, run: Run) -> Noise:
    """Return the noise that a rehearsed run suggests, where rows tell as much as they mostly do."""
    guess, share = first_guess(machine, [run]), MOVED_IN_ROWS
    return replace(
        guess,
        unresolved=share * guess.unresolved,
        unresolved_current=share * guess.unresolved_current,
    )


def read_gap(path: Path) -> Question:
    """Return the question of the first ambiguous effect of a gap.json, with its size there.

    What no manoeuvre is for is passed over, as an effect and as a rival.
    """
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        effects = [*result["effects"], *result.get("nearest", [])]
        channels = tuple((result.get("gap") or {}).get("channels") or ROBOT_CHANNELS)
        unsure = [effect for effect in effects if effect.get("ambiguous_with")]
        for effect in unsure:
            rivals = [_name_of(rival) for rival in _rivals_of(effect) if _can_be_driven(rival)]
            if rivals and effect["name"] not in NOT_DRIVEN:
                sizes = {k: float(v["value"]) for k, v in effect["parameters"].items()}
                return Question([_name_of(effect), *rivals], {_name_of(effect): sizes}, channels)
        sets = [" from ".join(map(_name_of, (e, *_rivals_of(e)))) for e in unsure]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"{path}: not a gap.json as gap find writes it") from None
    if sets:
        raise InputError(f"{path}: no manoeuvre in the library separates {sets[0]}")
    raise InputError(f"{path}: names no effect that cannot be told from another")


def _rivals_of(effect: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Rivals with their wheels, where the file has them."""
    return effect.get("rivals") or [{"name": name} for name in effect["ambiguous_with"]]


def _name_of(effect: Mapping[str, Any]) -> str:
    if not isinstance(effect["name"], str):
        raise TypeError
    return name_on_wheel(effect["name"], effect.get("wheel"))


def _can_be_driven(rival: Mapping[str, Any]) -> bool:
    """A patch has its place only in a gap.json that names it as an effect."""
    return rival["name"] not in (*NOT_DRIVEN, PATCH)


def write_plan(best: Separation, directory: Path, robot: Path) -> Path:
    """Write the manoeuvre as a scenario for the robot file `robot`; returns its path."""
    path = directory / f"{best.manoeuvre.name}.toml"
    relative = os.path.relpath(robot, directory)
    scenario = Scenario(
        best.manoeuvre.name,
        best.manoeuvre.duration_s,
        read_model(robot),
        best.manoeuvre.commands,
        sensors=TYPICAL_SENSORS,
    )
    write_text(path, format_scenario(scenario, relative, best.manoeuvre.summary))
    return path


def _ranked(found: Sequence[Separation]) -> list[Separation]:
    def key(one: Separation) -> tuple[bool, float]:
        certain = one.separation >= CERTAIN
        return (certain, one.separation / one.manoeuvre.duration_s if certain else one.separation)

    return sorted(found, key=key, reverse=True)


def _rate_of(run: Run) -> int:
    """Row rate (Hz) nearest to that of a run among those that a scenario can have."""
    wanted = 1.0 / run.row_s
    rates = [hz for hz in range(50, CONTROL_RATE_HZ + 1) if CONTROL_RATE_HZ % hz == 0]
    return min(rates, key=lambda hz: abs(hz - wanted))


def _named(machine: Machine, name: str) -> Candidate:
    """The candidate of a name; of a patch in the floor the question says the place."""
    effect, _ = effect_and_wheel(name)
    if effect in NOT_DRIVEN:
        raise InputError(f"no manoeuvre is for {effect}: gap find tells it from any motion")
    candidates = [*machine.candidates(), machine.patch(np.zeros((1, 2)))]
    known = {candidate.name: candidate for candidate in candidates}
    if name in machine.catalogue and name not in known:
        wheels = f"'{name} (wheel 1)' to '{name} (wheel {machine.wheels})'"
        raise InputError(f"effect '{name}' acts on one wheel: {wheels}")
    if name not in known:
        own = "An effect of your own has to be defined in the robot file"
        raise InputError(f"unknown effect '{name}'{nearest(name, known)} {own}")
    return known[name]


def _truth(machine: Machine, name: str, sizes: dict[str, float] | None) -> Hypothesis:
    """The believed robot with one effect, at the sizes found or typical ones."""
    candidate = _named(machine, name)
    if candidate.edges_m and "y_min_m" not in (sizes or {}):
        candidate = candidate.along_x()
    base = tuple(machine.base_parameters())
    x = np.array([machine.believed[p.places[0]] for p in base])
    values = _sizes_to_try(machine, candidate)[0]
    for k, parameter in enumerate(candidate.parameters):
        values[k] = (sizes or {}).get(machine.file_parameter(parameter.label), values[k])
    return Hypothesis(base, (), x).with_effect(candidate, values)


def _sizes_to_try(machine: Machine, candidate: Candidate) -> list[Array]:
    """Typical sizes, then the other direction, then hardly there; for every start of the shape."""
    tried = []
    for amount in (1.0, -1.0, 0.05):
        for start in candidate.starts:
            sizes = np.array([machine.believed[p.places[0]] for p in candidate.parameters])
            for k, value in start.items():
                sizes[k] = value
            for k in candidate.amplitudes:
                parameter = candidate.parameters[k]
                sign = machine.sign_of(candidate.effect, parameter.label)
                reach = amount * sign * parameter.scale
                sizes[k] = sizes[k] + reach if np.isfinite(sizes[k]) else parameter.scale
            low = [p.low for p in candidate.parameters]
            high = [p.high for p in candidate.parameters]
            tried.append(np.clip(sizes, low, high))
    return tried


def fit_rival(data: Data, base: Hypothesis, candidate: Candidate) -> Fit:
    """Return the best fit of `base` with one more effect."""
    starts = [base.with_effect(candidate, s) for s in _sizes_to_try(data.machine, candidate)]
    costs = objective(data, starts[0], np.stack([start.x for start in starts]))
    return fit(data, starts[int(np.argmin(costs))], FIT_ITERATIONS)


def _lead_with_logs(new: Expected, rival: Fit) -> float:
    """L on a new log beside old ones, on which the rival was fitted: one linear step."""
    residuals, rough = linearise(new, [rival.hypothesis])
    [difference], [jacobian] = linearise(new, [rival.hypothesis], 0, residuals, rough)
    known = rival.jacobian.T @ rival.jacobian
    count = len(rival.hypothesis.base)
    known[:count, :count] += np.eye(count)
    gram = jacobian.T @ jacobian + known
    gram += 1e-9 * np.trace(gram) / len(gram) * np.eye(len(gram))
    pull = jacobian.T @ difference
    return float(difference @ difference - pull @ np.linalg.solve(gram, pull))


def _model_of(machine: Machine, hypothesis: Hypothesis) -> Model:
    """The model file of a hypothesis, for the simulator."""
    base = {
        p.label: float(x) / float(machine.believed[p.places[0]])
        for p, x in zip(hypothesis.base, hypothesis.x, strict=False)
    }
    effects = [
        machine.effect_of(candidate, hypothesis.values_of(k))
        for k, candidate in enumerate(hypothesis.effects)
    ]
    return machine.amended_model(base, effects)
