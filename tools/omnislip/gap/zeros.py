"""Where do encoders count from?

An encoder without an index counts from wherever its shaft was when it was switched on. What turns
with shafts or wheels and is no round thing (cogging, a wheel out of round, rollers) then has
another phase in each log and at each wheel: no one phase explains it. A zero is a state of a log,
like where a robot starts, and tells nothing about the robot; it is estimated from each log, also
from one that is held out, and the counts are moved by it.

An effect of amplitude A that repeats n times per radian of the shaft changes the residuals by

    A (cos(a) s + sin(a) c),    a = n times the zero, s = what it does from zero 0, c = a quarter on

which is linear in A cos(a) and A sin(a). These are fitted for each log and wheel, beside the keys.
If zeros are all that differs, then one amplitude serves all of them. That has to gain surely more
than what zeros that are all the same explain.

What to ask so is told by the filter's disturbances of the shafts: their power at n over the angle,
whatever the phases, beside that of numbers between, at which nothing repeats.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from omnislip import _core
from omnislip.gap.inference import Data, Hypothesis, fit, free_of_fitted, inflation_of
from omnislip.gap.leftover import sizes_of
from omnislip.gap.machine import PHASE, SHAPE_GRIDS, Machine, count_rad
from omnislip.gap.noise import DISTURBANCES, SHAFT, Noise, RunawayError, track_all
from omnislip.gap.recordings import Run
from omnislip.gap.screen import half_turn
from omnislip.gap.split import all_runs
from omnislip.log_file import Log

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

BESIDE = np.array([-0.5, 0.5])
"""Beside what repeats once, twice, ...: nothing does so often."""
STANDS_OUT = 1.5
"""Factor by which the power of what repeats exceeds that of what does not: worth asking."""
ENCODER_OUTPUTS, ROW_S, FOLLOWS_S = slice(0, 4), 0.01, 0.008
"""The last: time constant with which the filter's disturbances follow what is there."""
ALL_OF_IT, LEAST_OFF = 0.9, 0.03
"""Share of what amplitudes of each log and wheel explain that one must, zeros being all that
differs; and of this what zeros that are the same must leave: those that are off by a sixth of a
radian of what repeats. (By 0.06 they seemed to be where grip was off, too.)"""
ANGLES = np.linspace(-np.pi, np.pi, 720, endpoint=False)
ROUND = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
MOST_SWEEPS = 50
"""Phases that are tried, to half a degree, and how often each."""
WAVES, P_VALUE = 60, 1e-6
"""What is asked for, and chance that zeros which are the same do so much worse."""


@dataclass(frozen=True)
class _Wave:
    """An effect that repeats so often per radian of a shaft, on some wheels."""

    effect: str
    shape: dict[str, float]
    """What it is, beside amplitude and phase."""
    per_rad: float
    wheels: tuple[int, ...]
    power: float
    """Over that of what does not repeat."""


def find_zeros(
    machine: Machine,
    logs: Sequence[Log],
    pushes: Sequence[tuple[str, float]],
    noise: Noise,
    model: Hypothesis,
) -> dict[str, Counts]:
    """Return by how many counts (4,) to move the encoders of each log; nothing if none surely is.

    `pushes` (run, time) cut the logs, `model` is one that is near enough to follow them.
    """
    if machine.kind != "robot":
        return {}
    runs = all_runs(machine, logs, pushes)
    try:
        tracks = track_all(machine, runs, model.flat(machine.believed), noise)
        wave = _strongest(machine, runs, tracks)
        return _zeros(machine, logs, pushes, runs, noise, model, wave) if wave else {}
    except RunawayError:
        return {}


def moved(log: Log, zeros: Mapping[str, Counts]) -> Log:
    """Return the log as if its encoders had counted from elsewhere."""
    if log.name not in zeros:
        return log
    columns = dict(log.columns)
    for wheel, counts in enumerate(zeros[log.name], start=1):
        columns[f"wheel/{wheel}/encoder_counts"] = columns[f"wheel/{wheel}/encoder_counts"] + counts
    return replace(log, columns=columns)


def _strongest(
    machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track]
) -> _Wave | None:
    """Return what repeats most clearly with the angle of shafts, if anything does."""
    found = []
    for effect, label, amplitude, per_turn in (
        ("cogging", "cycles_per_rev", "torque_nm", 1.0),
        ("roller_ripple", "rollers", "amplitude", 1.0 / _gear_ratio(machine)),
        ("wheel_eccentricity", None, "amplitude", 1.0 / _gear_ratio(machine)),
    ):
        numbers = np.array(SHAPE_GRIDS[effect, label] if label else [1.0])
        if label and machine.believed[machine.place(effect, amplitude, 1)[0]]:  # the model has it
            numbers = machine.believed[list(machine.place(effect, label, 1))]
        beside = np.unique(np.round(numbers[:, None] + BESIDE, 2))
        power, other = (
            _powers(machine, runs, tracks, effect, per_turn * each) for each in (numbers, beside)
        )
        each_wheel = [(wheel,) for wheel in range(1, 5)]
        for wheels in [(1, 2, 3, 4)] if label else each_wheel:
            own = [wheel - 1 for wheel in wheels]
            least = max(float(other[:, own].sum(axis=1).max()), 1e-300)
            ratio = power[:, own].sum(axis=1) / least
            best = int(np.argmax(ratio))
            shape = {label: float(numbers[best])} if label else {}
            per_rad = per_turn * float(numbers[best])
            found.append(_Wave(effect, shape, per_rad, wheels, float(ratio[best])))
    strongest = max(found, key=lambda wave: wave.power)
    return strongest if strongest.power > STANDS_OUT else None


def _gear_ratio(machine: Machine) -> float:
    return float(machine.model.values["motor.gear_ratio"])


def _powers(
    machine: Machine,
    runs: Sequence[Run],
    tracks: Sequence[_core.Track],
    effect: str,
    per_rad: Array,
) -> Array:
    """Return the power (numbers, wheels) of disturbances of the shafts that repeat so often.

    Over the angle, in proportion to what the effect goes with, each log with its own phase; in
    units of what white noise has.
    """
    values = machine.model.values
    names = list(dict.fromkeys(run.name for run in runs))
    sums = np.zeros((len(names), len(per_rad), 4), complex)
    white = np.zeros((len(names), len(per_rad), 4))
    for run, track in zip(runs, tracks, strict=True):
        shown = ~np.isnan(run.outputs[:, ENCODER_OUTPUTS]).any(axis=1)
        rows = np.flatnonzero(shown & (run.t_s >= run.settled_s))
        rows = rows[:: max(1, round(ROW_S / run.row_s))]
        state = track.state.reshape(len(run.t_s), -1)[rows]
        disturbance, speed = state[:, DISTURBANCES][:, :4], state[:, SHAFT]
        weight = np.ones_like(speed)
        if effect == "wheel_eccentricity":
            weight = speed
        elif effect == "roller_ripple":  # what drives the wheel
            driving_v = float(values["motor.supply_v"]) * run.command[rows]
            weight = driving_v - float(values["motor.back_emf_constant_v_s_rad"]) * speed
        own, per_rad_of = names.index(run.name), per_rad[:, None, None]
        angle = per_rad_of * run.outputs[rows, ENCODER_OUTPUTS]
        followed = weight / (1.0 + 1j * FOLLOWS_S * per_rad_of * speed)
        sums[own] += np.sum(disturbance * np.exp(-1j * angle) * followed.conj(), axis=1)
        white[own] += np.mean(disturbance**2, axis=0) * np.sum(np.abs(followed) ** 2, axis=1)
    power: Array = np.sum(np.abs(sums) ** 2 / np.maximum(white, 1e-300), axis=0)
    return power


def _zeros(
    machine: Machine,
    logs: Sequence[Log],
    pushes: Sequence[tuple[str, float]],
    runs: Sequence[Run],
    noise: Noise,
    model: Hypothesis,
    wave: _Wave,
) -> dict[str, Counts]:
    """Return the zeros by which a wave explains surely more than by zeros that are the same."""
    candidate = next(
        c
        for c in machine.candidates()
        if c.effect == wave.effect and c.wheel in (None, wave.wheels[0])
    )
    with_it = model.flat(machine.believed)
    for parameter in candidate.parameters:
        places = list(parameter.places)
        if parameter.label in wave.shape:
            with_it[places] = wave.shape[parameter.label]
        elif parameter.label != PHASE and not with_it[places].any():
            with_it[places] = parameter.scale
    has_it = np.array_equal(with_it, model.flat(machine.believed))
    has_phase = any(parameter.label == PHASE for parameter in candidate.parameters)
    per_count = wave.per_rad * count_rad(machine)
    quarter = round(0.5 * np.pi / per_count)

    data = Data(machine, runs, noise, model)
    fitted = fit(data, model)

    def shown(wheel: int, counts: int) -> Array:
        """Residuals with the wave, the encoder of a wheel counting from elsewhere."""
        by = np.where(np.arange(1, 5) == wheel, counts, 0)
        elsewhere = [moved(log, {log.name: by}) for log in logs]
        [residual] = data.shown_as(all_runs(machine, elsewhere, pushes)).residuals(with_it[None])
        return residual

    here = shown(1, 0)
    names = list(dict.fromkeys(run.name for run in data.runs))
    parts = data.per_run(fitted.residual)
    owner = np.repeat([names.index(run.name) for run in data.runs], [len(part) for part in parts])
    columns = np.zeros((len(owner), len(names), len(wave.wheels), 2))
    for place, wheel in enumerate(wave.wheels):
        quarter_on, half_on = (shown(wheel, k * quarter) - here for k in (1, 2))
        sine = -0.5 * half_on
        columns[np.arange(len(owner)), owner, place] = np.stack([sine, quarter_on + sine], axis=1)
    each = free_of_fitted(fitted, columns.reshape(len(owner), -1)).reshape(len(owner), -1, 2)
    without = fitted.residual - has_it * each[..., 0].sum(axis=1)
    found = phases(data, each, without, has_phase, ALL_OF_IT, WAVES)
    if found is None:
        return {}
    angle, _ = found
    first = angle[0] if has_phase and not has_it else 0.0
    by = np.array([half_turn(own) for own in angle - first])
    counts = np.zeros((len(names), 4), np.int64)
    own = [wheel - 1 for wheel in wave.wheels]
    counts[:, own] = np.round(by / per_count).reshape(len(names), -1)
    return dict(zip(names, counts, strict=True))


def phases(
    data: Data,
    each: Array,
    without: Array,
    any_phase: bool,
    share: float,
    tried: int,
    least_off: float = LEAST_OFF,
) -> tuple[Array, float] | None:
    """Return the phase (places,) of a wave in each place and what it explains so; None if one does.

    `each` (m, places, 2) are its sine and cosine there, `without` (m,) the residuals without it. An
    effect that may have `any_phase` explains any one for all, another only that of zero. One
    amplitude has to explain a `share` of what one of each place's own does, phases that are the
    same must leave `least_off` of it, and of so many that are `tried` none may be chance.
    """
    sizes, left_by_each = least_of(each.reshape(len(without), -1), without)
    angle = _of_one_amplitude(each, without, np.arctan2(*sizes.reshape(-1, 2)[:, ::-1].T))
    turned = each[..., 0] @ np.cos(angle) + each[..., 1] @ np.sin(angle)
    _, left_by_one = least_of(turned[:, None], without)
    _, left_by_same = least_of(each.sum(axis=1)[:, : 2 if any_phase else 1], without)
    whole, of_each, of_one = (float(left @ left) for left in (without, left_by_each, left_by_one))
    if whole - of_one < share * (whole - of_each):
        return None
    gain = sure_gain(data, left_by_one, left_by_same, len(angle) - any_phase, tried)
    sure = gain > 0.0 and gain >= least_off * (whole - of_one)
    return (angle, whole - of_one) if sure else None


def _of_one_amplitude(each: Array, without: Array, angle: Array) -> Array:
    """Return the phases (places,) by which one amplitude explains most, from some near those.

    Phase by phase. (A log that hardly tells one of its two sizes has them at any angle.)
    """
    columns = each.reshape(len(without), -1)
    gram = (columns.T @ columns).reshape(len(angle), 2, len(angle), 2)
    pull = (columns.T @ without).reshape(-1, 2)
    for _ in range(MOST_SWEEPS):
        before = angle
        for place in range(len(angle)):
            now = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            square = np.einsum("pi,piqj,qj", now, gram, now)
            amplitude = -np.sum(pull * now) / max(float(square), 1e-300)
            now[place] = 0.0
            own = pull[place] + amplitude * np.einsum("ipj,pj->i", gram[place], now)
            costs = amplitude * np.einsum("ai,ij,aj->a", ROUND, gram[place, :, place], ROUND)
            costs = amplitude * (costs + 2.0 * ROUND @ own)
            angle = np.where(np.arange(len(angle)) == place, ANGLES[np.argmin(costs)], angle)
        if np.array_equal(angle, before):
            break
    return angle


def sure_gain(data: Data, left: Array, left_by_same: Array, freedom: int, tried: int) -> float:
    """Return by how much residuals (m,) are less than others by so many sizes more.

    0 if that may be chance.
    """
    gain = float(left_by_same @ left_by_same - left @ left)
    change = left - left_by_same
    inflation = inflation_of(data, change[:, None], left, np.array([[change @ change]]))
    chance = float(chi2.sf(gain / inflation, freedom)) * tried
    return gain if chance < P_VALUE else 0.0


def least_of(columns: Array, residual: Array) -> tuple[Array, Array]:
    """Return sizes (k,) of columns (m, k) that leave least of a residual (m,), and what they do."""
    sizes = sizes_of(columns, residual)
    return sizes, residual + columns @ sizes
