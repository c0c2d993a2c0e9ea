"""Where do logs begin that no camera sees?

Without a camera a robot is wherever it was put down, turned any way. What is fixed to the world (a
floor that slopes, the nap of a carpet, a spring that tethers) then pulls from another side in each
log: no one direction explains it. Where a log begins is a state of that log and tells nothing about
the robot; it is estimated from each log, also from one that is held out.

A slope of size A pulls with A (cos b, sin b), b its direction in the frame in which the log begins:
turned back by the log's first heading; that of the nap, a second harmonic, by twice that. A spring
of stiffness k pulls with k (p0 - p), whichever way the robot is turned, p0 where the log has it.
Linear in A cos b and A sin b, or in k and k p0, these are fitted for each log beside the keys. If
starts are all that differs, then one A (one k) serves all logs. That has to gain surely more than
logs that all begin alike. Then the model has the effect, and its filter follows the logs better:
starts are moved on until that makes it no likelier.

Nothing says where north is: the first log begins at x = y = heading = 0, or the others in the frame
of those that a camera sees.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from omnislip.gap.inference import Data, Fit, Hypothesis, absorbed, fit
from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise, RunawayError
from omnislip.gap.recordings import sees_pose
from omnislip.gap.screen import half_turn
from omnislip.gap.settle import FEW_TUNINGS, settle
from omnislip.gap.split import all_runs
from omnislip.gap.zeros import LEAST_OFF, least_of, phases, sure_gain
from omnislip.log_file import Log

Array = npt.NDArray[np.float64]
Pose = tuple[float, float, float]

DIRECTED = {"floor_slope": (("x_m_s2", "y_m_s2"), 1), "carpet_anisotropy": (("cos2", "sin2"), 2)}
"""Effects with a direction in the world: their cosine and sine, and how often these go round while
the robot turns once."""
TETHER, STIFFNESS, PLACE = "tether_spring", "stiffness_n_m", ("x_m", "y_m")
SHARE, TRIED, ROUNDS = 0.85, 3, 8
"""Of what sizes of each log's own explain, what one for all must; how often starts are moved at
most."""
LIKELIER, SURELY_LIKELIER = 5.0, 20.0
"""Log-likelihood that it takes to move them on, and to begin with that anew."""
STIFFER = 1.1
"""Factor by which to see what a stiffer tether does."""


@dataclass(frozen=True)
class _Found:
    """Where logs begin, what that explains, and the effect that tells it with its sizes."""

    explained: float
    starts: dict[str, Pose]
    effect: str
    sizes: Array


def find_starts(
    machine: Machine,
    logs: Sequence[Log],
    pushes: Sequence[tuple[str, float]],
    noise: Noise,
    model: Hypothesis,
) -> dict[str, Pose]:
    """Return where each log begins that no camera sees; nothing if none surely begins elsewhere.

    `pushes` (run, time) cut the logs, `model` is one that is near enough to follow them. Where logs
    begin elsewhere already they are moved on by what of the model tells more of it, if surely.
    """
    unseen = [log.name for log in logs if not sees_pose(log)]
    starts: dict[str, Pose] = {}
    asked = {*DIRECTED, TETHER}
    known = any(any(log.begun_at) for log in logs)
    if known:
        asked &= {effect.effect for effect in model.effects}
    if machine.kind != "robot" or not unseen or not asked:
        return starts

    def ask(data: Data, fitted: Fit, effects: Collection[str], tried: int) -> _Found | None:
        there = [begun(log, starts) for log in logs if log.name in unseen]
        return _Starts(data, fitted, there, len(there) < len(logs), tried).best(effects)

    try:
        runs = all_runs(machine, logs, pushes)
        if known:
            data, fitted = settle(machine, runs, model, noise, FEW_TUNINGS)
            likeliest = _likelihood(data) + SURELY_LIKELIER
        else:
            data = Data(machine, runs, noise, model)
            fitted, likeliest = fit(data, model), -np.inf
        found = ask(data, fitted, asked, 0 if known else TRIED)
        for _ in range(ROUNDS):
            if found is None:
                break
            runs = all_runs(machine, [begun(log, found.starts) for log in logs], pushes)
            with_it = _with(machine, fitted.hypothesis, found)
            data, fitted = settle(machine, runs, with_it, data.noise, FEW_TUNINGS)
            likelihood = _likelihood(data)
            if likelihood < likeliest + LIKELIER:
                break
            likeliest, starts = likelihood, found.starts
            found = ask(data, fitted, {found.effect}, 0)
    except RunawayError:
        pass
    return starts


def _likelihood(data: Data) -> float:
    return float(sum(track.log_likelihood for track in data.tracks))


def _with(machine: Machine, model: Hypothesis, found: _Found) -> Hypothesis:
    """Return a model with the effect that tells where logs begin."""
    [candidate] = [c for c in machine.candidates() if c.effect == found.effect]
    known = machine.believed[list(candidate.parameters[0].places)].any()
    if known or any(one.effect == found.effect for one in model.effects):
        return model
    return model.with_effect(candidate, found.sizes)


def begun(log: Log, starts: Mapping[str, Pose]) -> Log:
    """Return the log as one that begins where it was found to."""
    return replace(log, begun_at=starts.get(log.name, log.begun_at))


def _explained(without: Array, left: Array) -> float:
    return float(without @ without - left @ left)


class _Starts:
    """What is fixed to the world, of each log that no camera sees by itself."""

    def __init__(
        self,
        data: Data,
        fitted: Fit,
        unseen: Sequence[Log],
        some_seen: bool,
        tried: int,
    ) -> None:
        """`tried` effects, or 0: that logs begin elsewhere is sure, the question is where."""
        self._data, self._fitted, self._unseen = data, fitted, unseen
        self._tried, self._least_off = tried, LEAST_OFF if tried else 0.0
        self._alike = [0.0]
        """What effects explain if all logs begin alike."""
        self._first = int(some_seen)
        names = [log.name for log in unseen]
        place = {name: self._first + k for k, name in enumerate(names)}
        rows = [len(part) for part in data.per_run(fitted.residual)]
        self._place = np.repeat([place.get(run.name, 0) for run in data.runs], rows)
        """Of each residual (m,): 0 for logs that a camera sees, if any, then log by log."""
        self._count = self._first + len(names)

    def best(self, effects: Collection[str]) -> _Found | None:
        """Return the starts that explain surely most by some effects, if any do.

        More than any effect does of logs that begin alike: a spring that pulls all logs to one
        place pulls each of them another way.
        """
        found = [self._turned(*one) for one in DIRECTED.items() if one[0] in effects]
        if TETHER in effects:
            found.append(self._moved())
        best = max(filter(None, found), key=lambda one: one.explained, default=None)
        if best is None or best.explained < (1.0 + self._least_off) * max(self._alike):
            return None
        return best

    def _turned(self, effect: str, how: tuple[tuple[str, str], int]) -> _Found | None:
        """Return what other headings explain by an effect with a direction."""
        labels, rounds = how
        known, has = (self._sizes(effect, labels, found) for found in (False, True))
        scale = self._scale(effect)
        here, *probed = self._residuals(effect, labels, has + scale * np.eye(3, 2, -1))
        columns = (np.array(probed) - here).T / scale
        each = self._free(effect, self._each(columns)).reshape(len(here), -1, 2)
        without = here - each.sum(axis=1) @ has
        fixed = bool(known.any())
        angle = np.arctan2(*known[::-1])
        along = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        each = each @ along
        same = each.sum(axis=1)[:, : 1 if fixed else 2]
        self._alike.append(_explained(without, least_of(same, without)[1]))
        found = phases(self._data, each, without, not fixed, SHARE, self._tried, self._least_off)
        if found is None:
            return None
        turned, explained = found
        if self._first or not fixed:
            turned = turned - turned[0]
        starts = {}
        for log, own in zip(self._unseen, turned[self._first :], strict=True):
            heading = half_turn(log.begun_at[2] - half_turn(float(own)) / rounds)
            starts[log.name] = (*log.begun_at[:2], heading)
        turns = np.exp(1j * turned)
        one = np.einsum("mpk,pk->m", each, np.stack([turns.real, turns.imag], axis=1))
        other = np.einsum("mpk,pk->m", each, np.stack([-turns.imag, turns.real], axis=1))
        sizes, _ = least_of(np.stack([one, other], axis=1), without)
        return _Found(explained, starts, effect, along @ sizes)

    def _moved(self) -> _Found | None:
        """Return what other places explain by a tether."""
        labels = (STIFFNESS, *PLACE)
        stiffness, *place_m = self._sizes(TETHER, labels, False)
        has = self._sizes(TETHER, labels, True)
        near = has if has[0] else np.array([self._scale(TETHER), 0.0, 0.0])
        more = STIFFER if has[0] else 0.0  # with the same pull where x = y = 0
        at = np.array([near, [more * near[0], *near[1:] / (more or 1.0)], near, near])
        at[2:, 1:] += np.eye(2)
        here, *probed = self._residuals(TETHER, labels, at)
        columns = (np.array(probed) - here).T / near[0]
        columns[:, 0] /= more - 1.0
        common = self._free(TETHER, columns)
        without = here - common @ (near[0] * np.append(1.0, near[1:]))
        pulls = self._free(TETHER, self._each(columns[:, 1:]))
        sizes, left = least_of(np.hstack([common[:, :1], pulls]), without)
        _, left_by_pulls = least_of(pulls, without)
        _, left_by_each = least_of(self._free(TETHER, self._each(columns)), without)
        same = common @ np.append(1.0, place_m)[:, None] if stiffness else common
        _, left_by_same = least_of(same, without)
        explained, by_each, alike = (
            _explained(without, r) for r in (left, left_by_each, left_by_same)
        )
        self._alike.append(alike)
        freedom = 2 * (self._count - (not stiffness))
        gain = sure_gain(self._data, left, left_by_same, freedom, self._tried)
        sure = sizes[0] > 0.0 and sure_gain(self._data, left, left_by_pulls, 1, self._tried) > 0.0
        if not sure or gain <= self._least_off * explained or explained < SHARE * by_each:
            return None
        held_m = sizes[1:].reshape(-1, 2) / sizes[0]
        wanted_m = held_m[0] if self._first or not stiffness else np.array(place_m)
        starts = {}
        for log, own_m in zip(self._unseen, held_m[self._first :], strict=True):
            x_m, y_m = log.begun_at[:2] + wanted_m - own_m
            starts[log.name] = (float(x_m), float(y_m), log.begun_at[2])
        return _Found(explained, starts, TETHER, np.append(sizes[0], wanted_m))

    def _places(self, effect: str, labels: Sequence[str]) -> list[int]:
        return [self._data.machine.place(effect, label, None)[0] for label in labels]

    def _sizes(self, effect: str, labels: Sequence[str], found: bool) -> Array:
        """Return the sizes of an effect in the model, as `found` or in the file."""
        believed = self._data.believed
        flat = self._fitted.hypothesis.flat(believed) if found else believed
        return flat[self._places(effect, labels)]

    def _scale(self, effect: str) -> float:
        """Return what size of an effect is worth looking for."""
        [candidate] = [c for c in self._data.machine.candidates() if c.effect == effect]
        return candidate.parameters[0].scale

    def _residuals(self, effect: str, labels: Sequence[str], sizes: Array) -> Array:
        """Return the residuals (sets, m) with sizes (sets, labels) of an effect."""
        flat = self._fitted.hypothesis.flat(self._data.believed)
        sets = np.tile(flat, (len(sizes), 1))
        sets[:, self._places(effect, labels)] = sizes
        return self._data.residuals(sets)

    def _each(self, columns: Array) -> Array:
        """Return columns (m, k) as one of each place (m, places k), 0 elsewhere."""
        each = np.zeros((len(columns), self._count, columns.shape[1]))
        each[np.arange(len(columns)), self._place] = columns
        return each.reshape(len(columns), -1)

    def _free(self, effect: str, columns: Array) -> Array:
        """Return columns without what the parameters of the model explain but the effect's."""
        hypothesis = self._fitted.hypothesis
        numbers = [k for k, one in enumerate(hypothesis.effects) if one.effect == effect]
        own = [i for k in numbers for i in range(*hypothesis.own(k).indices(len(hypothesis.x)))]
        return absorbed(self._fitted, columns, own)[0]
