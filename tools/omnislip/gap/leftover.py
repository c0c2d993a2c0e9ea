"""Is anything left that no effect of the catalogue explains?

A missing term is a force, moment or torque that depends on the state. Along the filtered states of
the final model every term of a small dictionary (equation x wheel pattern x dependence) is a known
function of time; what it would do to the innovations is linear in its size (`respond` in
sim/replay.h derives it); a term of a sensor is added to what it shows. Each term is tested like an
effect: gain T over what the fitted parameters leave, inflation by block sums, and the gain on each
run by the size that fits the others. What gains within one half second only is an incident and no
law. A term that passes says where something is missing and on what it depends, not what it is.

Waves in place, hills, beats and loads that swing have a length, a place or a frequency besides. The
filter's disturbances, or the responses themselves, are searched for the one that explains most; it
is tested like the others, among as many as it was chosen from. Two terms of an angle or a beat may
have sizes of every run's own, for a log counts from where it began: then one half of each run
judges the sizes of the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from omnislip import _core
from omnislip.gap.inference import (
    BLOCK_S,
    Check,
    Data,
    Fit,
    check_columns,
    free_of_fitted,
    inflation_of,
    left_by_shapes,
)
from omnislip.gap.machine import CURVE, Candidate
from omnislip.gap.noise import DISTURBANCES, SHAFT, track_all
from omnislip.gap.recordings import Run
from omnislip.gap.side_by_side import side_by_side
from omnislip.gap.terms import (
    BEATING,
    Term,
    beat_terms,
    beyond_terms,
    dictionary,
    hill_slope,
    hill_term,
    nameless,
    patterns,
    pull_term,
    pull_to,
    side_terms,
    swing_terms,
    turned,
    wave_term,
)

Array = npt.NDArray[np.float64]

P_VALUE = 1e-6
"""Over all terms. To say that no known effect is the cause takes more than to name one."""
UNKNOWN_SHARE, CURVE_SHARE = 0.01, 1e-3
"""Square of how far the plant may be off an effect's shape, and off the friction curve's, which has
parameters enough for it. A term that gains more than they leave makes the verdict unknown: names
are right in place perhaps, but wrong in shape."""
ALONG_BOTH = {
    "body/force_x": ("body/force", "body/force_y"),
    "floor/speed_x": ("floor/speed", "floor/speed_y"),
}
"""Equations along x that are tried together with those along y, and as what."""
MOVES = ("body/force_x", "body/force_y", "body/moment")
"""Equations of the body, along its x, its y, and round."""
IN_ITS_PLACE = 0.5
"""Share of an effect's gain that a term must take over to stand in its place."""
ALL_OF_IT, MOST_OF_IT = 0.95, 0.9
"""Shares of what several names explain that one term has to, and that no name of them may."""
MOST_SHAPES = 5
AT_ONCE = 16
"""Terms whose responses are computed together: two groups of lanes, arrays of some megabytes."""
SWINGS_HZ, SWING_DAMPING = 0.7 * 2.0 ** (np.arange(9) / 2.0), 0.1
FASTEST_HZ = {"world/force": 6.0, "body/moment": 6.0, "camera": 12.0}
NEARER, NEARER_DAMPINGS = 2.0 ** np.array([-0.25, -0.125, 0.0, 0.125, 0.25]), (0.03, 0.1)
"""0.7 to 11.2 Hz by a factor of 1.4; factors from the best of them, and damping ratios. A load that
is faster, or damped more, hardly swings: it answers acceleration, as soft shafts do whose shape is
a bit off (beside one it gained 700 at 8 Hz, damping ratio 0.3). Markers on masts are lighter."""
SURE_SIZE = 2.0
"""Standard deviations from which half a run knows a size of its own."""
MORE, MORE_P_VALUE = 1.1, 1e-3
"""Factor by which more sizes have to gain more, and chance that they do."""
BEATS_HZ = np.arange(0.5, 25.0, 0.08)
"""In 6 s a beat is a sixth of a hertz wide."""
WAVE_ROW_S, TINY = 0.01, 1e-6
WAVES_1_M, WAVES_STEP_1_M, PHASES = (3.0, 26.0), 1.0, 4
"""Wave numbers of a floor (waves of 2 m to 24 cm), and from one to the next (in 3 m a third of a
period)."""
HILL_STEP_M, MOST_HILLS, SEEN_SHARE = 0.15, 25.0, 0.1
"""Between hills and other places that are tried, how many of them along a side at most, and the
share of what they do that another run has to feel."""
SIDES = np.arange(12.5, 100.0, 12.5)
"""Shares of the way, in percent, on one side of where another camera may begin to see."""
NEARER_WAVES = np.stack(np.meshgrid(*[np.arange(-0.5, 0.75, 0.25)] * 2), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class About:
    """A force about a place: what it is there, the widths that are tried, how far off the way the
    place may be."""

    push: Callable[[Array], Array]
    """(..., 2) in widths from the place -> (..., 2)"""
    term: Callable[[Array, float], Term]
    widths_m: tuple[float, ...]
    around_m: float


PLACED = {
    "hill": About(hill_slope, hill_term, (0.1, 0.2, 0.35, 0.6), 0.0),
    "pull": About(pull_to, pull_term, (0.05,), 1.0),
}


@dataclass(frozen=True)
class Leftover:
    """A term that is missing: where, on what it depends, and how surely.

    `covered` is the gain that the effects of the model may leave to it by their shapes.
    """

    equation: str
    dependence: str
    gain: float
    inflation: float
    p_value: float
    validation_gain: float
    covered: float
    terms: tuple[Term, ...] = field(default=(), repr=False, compare=False)
    sizes: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    """(terms,), or (runs, terms) where each run has its own."""


@dataclass(frozen=True)
class Shape:
    """A nameless term, or one along both axes of the body, and its gain alone on some model."""

    equation: str
    dependence: str
    gain: float


def find_leftover(data: Data, fitted: Fit, free: Array) -> list[Leftover]:
    """Return the terms that pass, strongest first; `free` are the responses to the dictionary.

    Of a robot what no effect of the catalogue comes near, too, and what has to be looked for. Not
    in a direction in which nothing but disturbances moves it: one that lasts passes for a law.
    """
    terms, choices = dictionary(data.machine), 0
    if data.machine.kind == "robot":
        tracks = _tracks(data, fitted)
        looked_for, choices = _looked_for(data, tracks)
        more = [*nameless(data.machine), *looked_for]
        swings, swinging = _swings_looked_for(data, fitted, tracks)
        terms = [*terms, *more, *swings]
        free = np.hstack([free, responses(data, fitted, more, tracks), swinging])
    kept = [k for k, one in enumerate(terms) if is_driven(data, one.equation)]
    return _passing(data, fitted, [terms[k] for k in kept], free[:, kept], choices)


def is_driven(data: Data, equation: str) -> bool:
    """Whether what an equation moves is driven, by anything but disturbances."""
    return equation not in MOVES or data.driven[MOVES.index(equation)]


def find_shapes(data: Data, refit: Fit) -> list[Leftover]:
    """Return what the gap of a model without its effects looks like: the best term per equation.

    To see, not to judge: terms that tell parity, order of the shaft, frame and null space apart.
    """
    best: dict[str, Leftover] = {}
    terms = [*dictionary(data.machine), *patterns(data.machine)]
    for found in _passing(data, refit, terms, responses(data, refit, terms), 0):
        best.setdefault(found.equation, found)
    return list(best.values())[:MOST_SHAPES]


def shapes_instead(
    data: Data, final: Fit, free: Array, without: Sequence[Fit]
) -> list[Shape | None]:
    """Return for each model without one effect what explains most in the place of that.

    `free` are the final model's responses to the dictionary. A term counts that loses most of its
    own gain beside the effect, and gains it without: what is missing besides is no matter of the
    name. None where no term does.
    """
    terms = dictionary(data.machine)
    beside = _gains_of_shapes(final, free, terms)
    gains = side_by_side(
        lambda one: _gains_of_shapes(one, responses(data, one, terms), terms), without
    )
    found = []
    for one, alone in zip(without, gains, strict=True):
        named = one.objective - final.objective
        instead = [
            Shape(*name, gain)
            for name, gain in alone.items()
            if gain - beside[name] > IN_ITS_PLACE * named
        ]
        found.append(max(instead, key=lambda shape: shape.gain, default=None))
    return found


def one_law(data: Data, ladder: Sequence[Fit]) -> Shape | None:
    """Return the term that explains by itself what takes two names or more, neither most of it.

    `ladder` are fits of the base and of the first effect, the first two, ... A robot that moving
    sideways turns passed for radii of three wheels and a marker off its place, five numbers in all,
    which explained 1 % more than one.
    """
    base, final = ladder[0], ladder[-1]
    if sum(effect.effect != CURVE for effect in final.hypothesis.effects) < 2:
        return None
    terms = dictionary(data.machine)
    gains = _gains_of_shapes(base, responses(data, base, terms), terms)
    name = max(gains, key=gains.__getitem__)
    gain, whole = gains[name], base.objective - final.objective
    first = base.objective - ladder[1].objective
    return Shape(*name, gain) if gain > ALL_OF_IT * whole and first < MOST_OF_IT * gain else None


def _gains_of_shapes(
    fitted: Fit, free: Array, terms: Sequence[Term]
) -> dict[tuple[str, str], float]:
    """Gain of each term alone, and of each of the body along both of its axes."""
    gains = {}
    for name, own in _groups(terms).items():
        column = free[:, own]
        slope = column.T @ fitted.residual
        gains[name] = float(slope @ np.linalg.pinv(column.T @ column, hermitian=True) @ slope)
    return gains


def responses(
    data: Data,
    fitted: Fit,
    terms: Sequence[Term],
    tracks: Sequence[_core.Track] | None = None,
) -> Array:
    """Return what a unit of each term changes of residuals (m, terms) beside what was fitted.

    Along the `tracks` of the model, with their matrices, if they are known.
    """
    along = tracks or _tracks(data, fitted)

    def of_some(some: Sequence[Term]) -> Array:
        columns = data.responses(along, lambda _, run, *states: _pushes(*states, run, some))
        return free_of_fitted(fitted, columns)

    parts = [terms[first : first + AT_ONCE] for first in range(0, len(terms), AT_ONCE)]
    return np.hstack(side_by_side(of_some, parts))


def _tracks(data: Data, fitted: Fit) -> list[_core.Track]:
    values = fitted.hypothesis.flat(data.believed)
    return track_all(data.machine, data.runs, values, data.noise, keep_linear=True)


def _passing(
    data: Data, fitted: Fit, terms: Sequence[Term], free: Array, choices: int
) -> list[Leftover]:
    """Return the terms that pass, alone or jointly, best first.

    `free` (m, terms) are the responses to the terms, some of which were taken from so many
    `choices`. A wave over an angle is tried with a phase of every run's own, too.
    """
    groups = _groups(terms)
    tried = 2 * len(groups) + choices
    judge = _Judge(data, fitted, tried)
    gains = dict[tuple[str, str], float]()

    def passing(name: tuple[str, str]) -> list[Leftover | None]:
        own = groups[name]
        members, columns = tuple(terms[k] for k in own), free[:, own]
        several = len(own) > 1
        alone = max(gains[term.name] for term in members) if several else 0.0
        gains[name], one = judge.alike(name, members, columns, alone)
        if several and members[0].turning:
            return [one, judge.of_each_run(name, members, columns, gains[name])]
        return [one]

    found = []
    for together in (False, True):  # each alone first
        names = [name for name, own in groups.items() if (len(own) > 1) == together]
        found += [one for own in side_by_side(passing, names) for one in own if one is not None]
    return sorted(found, key=lambda leftover: -leftover.gain)


def sizes_of(columns: Array, residual: Array) -> Array:
    """Sizes (k,) of what explains most of a residual (m,), by least squares."""
    return -np.linalg.pinv(columns.T @ columns, hermitian=True) @ (columns.T @ residual)


@dataclass(frozen=True)
class _Judge:
    """Decides whether terms are missing, among so many that are tried."""

    data: Data
    fitted: Fit
    tried: int

    def alike(
        self, name: tuple[str, str], terms: tuple[Term, ...], columns: Array, simpler: float
    ) -> tuple[float, Leftover | None]:
        """Return the gain of terms of the same sizes in all runs, and the leftover if they pass."""
        residual = self.fitted.residual
        sizes = sizes_of(columns, residual)
        change = columns @ sizes
        check = partial(check_columns, self.data, residual, columns)
        found = self._passing(name, change, len(sizes), simpler, 1, check)
        return float(change @ change), replace(found, terms=terms, sizes=sizes) if found else None

    def of_each_run(
        self, name: tuple[str, str], terms: tuple[Term, ...], columns: Array, simpler: float
    ) -> Leftover | None:
        """Return terms whose sizes are of each run, if they pass."""
        parts = list(
            zip(self.data.per_run(columns), self.data.per_run(self.fitted.residual), strict=True)
        )
        sizes = np.array([sizes_of(own, left) for own, left in parts])
        change = np.concatenate([own @ size for (own, _), size in zip(parts, sizes, strict=True)])
        own_name = (name[0], f"{name[1]}, with a phase of each run's own")
        spared = sizes.size - len(terms)
        check = partial(_check_halves, parts)
        found = self._passing(own_name, change, sizes.size, simpler, spared, check)
        return replace(found, terms=terms, sizes=sizes) if found else None

    def _passing(
        self,
        name: tuple[str, str],
        change: Array,
        freedom: int,
        simpler: float,
        spared: int,
        check: Callable[[], Check],
    ) -> Leftover | None:
        """Return a change of the residuals (m,), of so many sizes, as a leftover, if it passes.

        `simpler` is the gain without the last `spared` of these.
        """
        data, residual, gain = self.data, self.fitted.residual, float(change @ change)
        if not gain > 0 or gain < MORE * simpler:
            return None
        inflation = inflation_of(data, change[:, None], residual + change, np.array([[gain]]))

        def chance_of(told: float) -> float:
            return float(chi2.sf(told / inflation, freedom)) * self.tried

        p_value = chance_of(gain)
        if p_value >= P_VALUE or chi2.sf((gain - simpler) / inflation, spared) > MORE_P_VALUE:
            return None
        elsewhere = _without_one_place(data, -change * (2.0 * residual + change))
        if chance_of(elsewhere) >= P_VALUE:
            return None
        checked = check()
        if not checked.helps:
            return None
        covered = left_by_shapes(data, self.fitted, change, residual, _covered_share)
        return Leftover(*name, gain, inflation, min(p_value, 1.0), checked.gain, covered)


def _without_one_place(data: Data, gains: Array) -> float:
    """Return the gain of all residuals (m,) but those of the half second that gains most.

    Whatever is largest then can stand for a single incident. A controller at 1 kHz turned wheels
    round within one row; the cube of the current took 299 of its 305 from there.
    """
    most = 0.0
    for run, own in zip(data.runs, data.per_run(gains), strict=True):
        time_s = run.t_s[data.kept_rows(run)]
        up_to = np.append(0.0, np.cumsum(own.reshape(len(time_s), -1).sum(axis=1)))
        ends = np.searchsorted(time_s, time_s + BLOCK_S)
        most = max(most, float(np.max(up_to[ends] - up_to[:-1], initial=0.0)))
    return float(gains.sum()) - most


def _check_halves(runs: Sequence[tuple[Array, Array]]) -> Check:
    """Judge columns (rows, k) beside the residual of each run: one half by sizes of the other.

    Where that half knows them: many wheels hardly turn in it.
    """
    judged = []
    for both in runs:
        halves = list(zip(*(np.array_split(part, 2) for part in both), strict=True))
        for (own, left), (other, others_left) in (halves, halves[::-1]):
            sizes = sizes_of(other, others_left)
            inverse = np.linalg.pinv(other.T @ other, hermitian=True)
            stake = float(np.sum((own @ sizes) ** 2))
            unsure = float(np.trace(inverse @ own.T @ own))
            judged.append((-2.0 * (own @ sizes) @ left - stake, stake, unsure))
    gains, stakes, unsure = np.array(judged).T
    known = stakes > SURE_SIZE**2 * unsure
    return Check(gains[known], stakes[known], unsure[known])


def _groups(terms: Sequence[Term]) -> dict[tuple[str, str], list[int]]:
    """Return the numbers of what is tried together: each alone, what goes jointly, both axes."""
    groups = {term.name: [k] for k, term in enumerate(terms)}
    for k, term in enumerate(terms):
        if term.jointly:
            groups.setdefault((term.equation, term.jointly), []).append(k)
        both, other = ALONG_BOTH.get(term.equation, ("", ""))
        if (other, term.dependence) in groups:
            groups[both, term.dependence] = [k, *groups[other, term.dependence]]
    return groups


def _swings_looked_for(
    data: Data, fitted: Fit, tracks: Sequence[_core.Track]
) -> tuple[list[Term], Array]:
    """Return the load or marker that swings and explains most, of each kind: terms, responses.

    The best of all frequencies, then of those and of dampings beside it.
    """
    offered = [
        (kind, hz, SWING_DAMPING)
        for kind in FASTEST_HZ
        for hz in SWINGS_HZ[FASTEST_HZ[kind] > SWINGS_HZ]
    ]
    for nearer in (True, False):
        terms = [term for one in offered for term in swing_terms(*one)]
        free = responses(data, fitted, terms, tracks)
        pairs = np.split(free, len(offered), axis=1)
        gains = [float(np.sum((pair @ sizes_of(pair, fitted.residual)) ** 2)) for pair in pairs]
        best = [
            max((k for k, one in enumerate(offered) if one[0] == kind), key=gains.__getitem__)
            for kind in FASTEST_HZ
        ]
        if nearer:
            offered = [
                (offered[k][0], factor * offered[k][1], damping)
                for k in best
                for factor in NEARER
                for damping in NEARER_DAMPINGS
            ]
    own = [j for k in best for j in (2 * k, 2 * k + 1)]
    return [terms[j] for j in own], free[:, own]


def _looked_for(data: Data, tracks: Sequence[_core.Track]) -> tuple[list[Term], int]:
    """Return waves that the filter's disturbances hold most of, and among how many they are found.

    Of waves in place a cos(k r) + b sin(k r) by least squares; beats in time have another phase in
    every run, and their powers add. Besides, forces about a place, and what sets in beyond lines
    and thresholds that the runs pass.
    """
    states, places, forces = [], [], []
    in_time = np.zeros((len(BEATING), len(BEATS_HZ)))
    for run, track in zip(data.runs, tracks, strict=True):
        state = track.state.reshape(len(run.t_s), -1)
        states.append(state)
        seen = state[:, DISTURBANCES]
        force = turned(state[:, 13], seen[:, 4:6])
        force -= force.mean(axis=0)
        stride = max(1, round(WAVE_ROW_S / run.row_s))
        forces.append(force[::stride])
        places.append(state[::stride, 11:13])
        by_command = np.sum(seen[:, SHAFT] * run.command, axis=1)
        beating = np.column_stack([force, by_command - by_command.mean()])
        beats = np.exp(-2j * np.pi * np.outer(BEATS_HZ, run.time_s))
        in_time += np.abs(beats @ beating).T ** 2

    def best_of(numbers_1_m: Array, axis: int) -> tuple[Array, float]:
        """Return the wave vector that explains most of the forces, and its phase."""
        sums = np.zeros((3, len(numbers_1_m)), np.complex128)
        for r, force in zip(places, forces, strict=True):
            turn = np.exp(-1j * (numbers_1_m @ r.T))
            sums += [turn @ force[:, axis], np.sum(turn**2, axis=1), np.full(len(turn), len(r))]
        wave, twice, rows = sums
        grams = 0.5 * np.array(
            [[rows.real + twice.real, -twice.imag], [-twice.imag, rows.real - twice.real]]
        )
        slopes = np.stack([wave.real, -wave.imag], axis=1)
        still = TINY * rows.real[:, None, None] * np.eye(2)  # a robot that stays in a place
        sizes = np.linalg.solve(grams.transpose(2, 0, 1) + still, slopes[..., None])[..., 0]
        best = int(np.argmax(np.sum(sizes * slopes, axis=1)))
        return numbers_1_m[best], float(np.arctan2(-sizes[best, 1], sizes[best, 0]))

    terms, numbers = [], _wave_numbers_1_m()
    for axis, name in enumerate("xy"):
        nearest, _ = best_of(numbers, axis)
        terms.append(wave_term(name, *best_of(nearest + NEARER_WAVES * WAVES_STEP_1_M, axis)))
    placed = 0
    for about in PLACED.values():
        found, tried = _placed(places, forces, about)
        terms, placed = terms + found, placed + tried
    for equation, power in zip(BEATING, in_time, strict=True):
        terms += beat_terms(equation, float(BEATS_HZ[np.argmax(power)]))
    for axis, along in enumerate(np.concatenate(places).T):
        for edge_m in np.percentile(along, SIDES):
            terms += side_terms(axis, float(edge_m))
    commands = np.concatenate([run.command for run in data.runs])
    terms += beyond_terms(data.machine, np.concatenate(states), commands)
    waves = 2 * PHASES * (len(numbers) + len(NEARER_WAVES))
    return terms, waves + in_time.size + placed


def _placed(
    places: Sequence[Array], forces: Sequence[Array], about: About
) -> tuple[list[Term], int]:
    """Return what explains most of forces in the world about a place, and how many are tried.

    A hill or hollow, or a pull to the place. Of those that two runs feel: where one does, nothing
    could check it.
    """

    def best_of(offered: Array) -> Array | None:
        """The best of centres and widths (offered, 3)."""
        gains, seen = np.zeros((2, len(offered), len(places)))
        for k, (place, force) in enumerate(zip(places, forces, strict=True)):
            pushes = about.push((place[None] - offered[:, None, :2]) / offered[:, None, 2:])
            pushes -= pushes.mean(axis=1, keepdims=True)
            gains[:, k] = np.einsum("hri,ri->h", pushes, force)
            seen[:, k] = np.einsum("hri,hri->h", pushes, pushes)
        whole = seen.sum(axis=1)
        shared = np.sum(seen > SEEN_SHARE * whole[:, None], axis=1) > 1
        gain = np.where(shared, gains.sum(axis=1) ** 2 / np.maximum(whole, TINY), 0.0)
        best = int(np.argmax(gain))
        return offered[best] if gain[best] > 0 else None

    low, high = np.percentile(np.concatenate(places), (1.0, 99.0), axis=0)
    low, high = low - about.around_m, high + about.around_m
    step_m = max(HILL_STEP_M, float(np.max(high - low)) / MOST_HILLS)
    axes = [np.arange(a, b + step_m, step_m) for a, b in zip(low, high, strict=True)]
    offered = np.stack(np.meshgrid(*axes, about.widths_m), axis=-1).reshape(-1, 3)
    best = best_of(offered)
    if best is None:
        return [], len(offered)
    moved = np.stack(np.meshgrid(*[[-0.5, 0.0, 0.5]] * 3), axis=-1).reshape(-1, 3)
    near = best + moved * [step_m, step_m, 0.4 * best[2]]
    best = best_of(near)
    found = [] if best is None else [about.term(best[:2], float(best[2]))]
    return found, len(offered) + len(near)


def _wave_numbers_1_m() -> Array:
    """Return wave vectors (waves, 2) of all directions; the opposite one is the same wave."""
    least, most = WAVES_1_M
    along = np.arange(-most, most + WAVES_STEP_1_M, WAVES_STEP_1_M)
    numbers = np.stack(np.meshgrid(along[along >= 0], along), axis=-1).reshape(-1, 2)
    size = np.hypot(*numbers.T)
    return numbers[(size >= least) & (size <= most)]


def _covered_share(effect: Candidate) -> float:
    return CURVE_SHARE if effect.effect == CURVE else UNKNOWN_SHARE


def _pushes(state: Array, seen: Array, run: Run, terms: Sequence[Term]) -> tuple[Array, Array]:
    """What a unit of each term adds: rates of the states (rows, states, terms), and outputs.

    The rates go with the state, what sensors show with that before they corrected it.
    """
    push = np.zeros((*state.shape, len(terms)))
    shown = np.zeros((*run.outputs.shape, len(terms)))
    time_s = run.time_s
    for index, term in enumerate(terms):
        for pushed in term.states:
            push[:, pushed, index] = term.shape(state, run.command, time_s, pushed)
        for output in term.outputs:
            shown[:, output, index] = term.shape(seen, run.command, time_s, output)
    shown[np.isnan(run.outputs)] = 0.0
    return push, shown
