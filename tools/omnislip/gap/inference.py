"""Fits and tests on whitened innovations: what does the data say for an effect, beyond chance?

With r(z) the innovations of the frozen-gain predictor, whitened so that they are white with unit
variance when the model is right, the objective of a hypothesis is

    Q(z) = |r(z)|^2 / s^2 + sum over believed keys of z_i^2,     z_i = (value - believed) / sd_i

with |z_i| <= 2 for believed keys (a key that needs more is an effect of its own) and the physical
bounds for effects; s^2 is the mean square of r at the best model so far. Gauss-Newton with bounds;
derivatives are secants of the batched replay, so one iteration costs two batches.

The gain of a candidate is T = Q(without) - Q(with), both refitted. If r were white T would be
chi-squared; a model that is a little wrong leaves r correlated, which inflates T. The inflation is
measured, not assumed: c = variance of the block sums of the candidate's score over its white value,
blocks of half a second, and T / max(1, c) / parameters is compared with Fisher's F. Its second
number is that of the blocks that make c, times c / (c - 1): a gain and a variance out of the same
few seconds prove little, but c = 1 needs no estimate. (Score test with cluster-robust variance:
White, Econometrica 1982; Liang and Zeger 1986; few clusters: Bell and McCaffrey, Survey Methodology
2002.)
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.stats import f as f_distribution
from scipy.stats import t as student

from omnislip import _core
from omnislip.gap.answers import Foreseen, foreseen, news_of
from omnislip.gap.machine import Candidate, Machine, Parameter
from omnislip.gap.noise import STEP_S, Noise, corrections, require_following, track_all
from omnislip.gap.recordings import Run
from omnislip.gap.rows import Projection, hidden_columns

Array = npt.NDArray[np.float64]

BLOCK_S = 0.5
VISIBLE_GAIN, EQUAL = 25.0, 1.0
"""Gain that stands out from chance; gains that differ by less are the same."""
BATCH = 64
STEPS = (1.0, 0.5, 0.2, 0.05)
FEW_STEPS = (1.0, 0.3)
KEY_SECANT, SECANT = 0.002, 0.05
"""Length of the secants of keys, and of the first of effects, in units of their scales."""
FINE_SECANT = 0.1
"""By how much in norm the fine secants change the residuals: that of chance is the root of their
number, some hundreds."""
ALIKE, SMOOTH = 4.0, 2.0
"""Factor within which a fine secant has the size of the one before it, if there is a derivative;
and within which one that is larger has the size of one ALIKE times as fine, or finer: across a jump
that grows as much."""
STIFFEST_1_S, STIFFER = 2e4, 2.0
"""Rate of a model up to which it is followed, or times that of the model beside which it is tried:
a gear so stiff is rigid to any log, and some are a thousand times as slow to follow."""
LEAST_OFF = 0.03
"""How far off in shape every effect may be."""
STEPS_ALIKE, RUNG = 1.1, 1.3
"""Sets faster than the first by up to this take its steps, and such as are faster by up to some
rungs those of the highest: what steps change is no derivative. Nor may they be those of whatever
sets are followed beside: beside a stiff gear a motor 0.03 % weak gained 221, by its finer steps."""
DIVERGED = 1e3
"""Whitened residual of a model with which the frozen predictor is not stable."""
CONVERGED, NEAR_THE_END = 0.05, 1.0
"""Gain of Q below which a fit ends; the same of a step that kept what it promised: what the next
one gains is of second order in it."""
FAR_CONVERGED = 1e-4
"""The first as a share of what a fit leaves beyond chance: of a model that is far off, such as one
without an effect that is there, nobody asks how far to a hundredth."""
LEAST_INFORMATION = 1e-6
FEW_BLOCKS = 3
"""Blocks that make an inflation, up to which they may be left out."""
NO_ACCIDENT = 200.0
"""Gain beyond chance that no block has by accident: what moves a robot so is found as a push."""
ROUGH = 0.1
"""Share of what a step promises below which its gain is no way further: where teeth meet or wheels
break loose a moment sooner or later, Q is rough, and its derivative is not its course."""
WORTH_A_ROUND = 2.0
"""Gain of Q below which a quick fit ends."""
MOST_ERROR = 8.0
LEAST_STAKE = 4.0
"""Of a vote: the gain of a change that is right is then as large as its deviation."""
WEAK = 0.02
"""Of the mean stake of a run, up to which a run has no vote: it shows the effect a seventh as
strongly as the others, and what these take the effect for, a bit off in shape, decides the sign.
(Beside a friction curve of which four runs gain 5,300 two have 12 at stake each and lose 39. Of a
delay that four of twelve measured runs confirm each of the others has 10 % and more.)"""
HELPED_SHARE = 0.75
SCATTER_P_VALUE = 0.01


@dataclass(frozen=True)
class Hypothesis:
    """A model: which effects are added, and the values of all free parameters.

    `x` holds believed keys first, then the parameters of `effects` in order.
    """

    base: tuple[Parameter, ...]
    effects: tuple[Candidate, ...]
    x: Array

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All free parameters in the order of `x`."""
        return self.base + tuple(p for effect in self.effects for p in effect.parameters)

    def flat(self, believed: Array, x: Array | None = None) -> Array:
        """Return the flat parameter set of the engine: all wheels first, then single ones."""
        values = believed.copy()
        numbers = zip(self.parameters, self.x if x is None else x, strict=True)
        for parameter, number in sorted(numbers, key=lambda one: -len(one[0].places)):
            values[list(parameter.places)] = number
        return values

    def place_of(self, name: str) -> int:
        """Return the number of the effect of a name."""
        return [effect.name for effect in self.effects].index(name)

    def own(self, index: int) -> slice:
        """Return where in `x` the parameters of effect number `index` (-1: the last) are."""
        first = len(self.base) + sum(len(e.parameters) for e in self.effects[:index])
        return slice(first, first + len(self.effects[index].parameters))

    def room(self) -> tuple[Array, Array]:
        """Return how far each parameter may move down and up, in units of its scale."""
        scale = np.array([p.scale for p in self.parameters])
        low = np.array([p.low for p in self.parameters])
        high = np.array([p.high for p in self.parameters])
        return (low - self.x) / scale, (high - self.x) / scale

    def with_effect(self, candidate: Candidate, sizes: Sequence[float]) -> "Hypothesis":
        """Return this model with one more effect, its parameters at `sizes`."""
        return replace(self, effects=(*self.effects, candidate), x=np.concatenate([self.x, sizes]))

    def without(self, index: int) -> "Hypothesis":
        """Return this model without its effect number `index`."""
        effects = self.effects[:index] + self.effects[index + 1 :]
        return replace(self, effects=effects, x=np.delete(self.x, self.own(index)))

    def without_effects(self) -> "Hypothesis":
        """Return the believed keys alone."""
        return replace(self, effects=(), x=self.x[: len(self.base)])

    def moved_last(self, index: int) -> "Hypothesis":
        """Return this model with its effect number `index` named last."""
        values = self.values_of(index)
        return self.without(index).with_effect(self.effects[index], values)

    def holding(self, index: int, number: int, value: float) -> "Hypothesis":
        """Return this model with parameter `number` of effect number `index` held at a value."""
        effects, x = list(self.effects), self.x.copy()
        parameters = list(effects[index].parameters)
        parameters[number] = replace(parameters[number], low=value, high=value)
        effects[index] = replace(effects[index], parameters=tuple(parameters))
        x[self.own(index).start + number] = value
        return replace(self, effects=tuple(effects), x=x)

    def last_two_joined(self) -> "Hypothesis":
        """Return this model with its last two effects, parts of one effect, as one."""
        first, second = self.effects[-2:]
        shift = len(first.parameters)
        joined = replace(
            first,
            parameters=first.parameters + second.parameters,
            amplitudes=first.amplitudes + tuple(shift + i for i in second.amplitudes),
        )
        return replace(self, effects=(*self.effects[:-2], joined))

    def values_of(self, index: int) -> Array:
        """Return the parameter values of effect number `index`."""
        return self.x[self.own(index)]


@dataclass(frozen=True)
class Fit:
    """A fitted hypothesis: objective, residual and derivative at the optimum (whitened, by s)."""

    hypothesis: Hypothesis
    objective: float
    residual: Array
    jacobian: Array = field(repr=False)

    @cached_property
    def information(self) -> Array:
        """Half the second derivative of Q by the parameters in units of their scales."""
        gram = self.jacobian.T @ self.jacobian
        count = len(self.hypothesis.base)
        gram[:count, :count] += np.eye(count)
        return gram

    def covariance(self, index: int, inflation: float) -> Array:
        """Return the covariance of effect number `index` in its units.

        The scores of what was logged vary by `inflation` more than if residuals were white; what
        is believed of keys does not. What rests on a bound is no better known for that, here and
        for what goes with it.
        """
        hypothesis = self.hypothesis
        free = np.flatnonzero([p.low < p.high for p in hypothesis.parameters])
        logged = self.jacobian[:, free].T @ self.jacobian[:, free]
        variance = inflation * logged + self.information[np.ix_(free, free)] - logged
        inverse = np.linalg.pinv(self.information[np.ix_(free, free)], hermitian=True)
        whole = np.zeros_like(self.information)
        whole[np.ix_(free, free)] = inverse @ variance @ inverse
        own = hypothesis.own(index)
        scale = np.array([p.scale for p in hypothesis.parameters[own]])
        return whole[own, own] * np.outer(scale, scale)

    def refitted_without(self, data: "Data", index: int) -> "Fit":
        """Return the fit without effect number `index`, to the data of this fit."""
        if index not in self._refits:
            last = np.delete(self.jacobian, self.hypothesis.own(index), axis=1)
            self._refits[index] = fit(data, self.hypothesis.without(index), last=last)
        return self._refits[index]

    @cached_property
    def _refits(self) -> dict[int, "Fit"]:
        return {}

    def actions(self, data: "Data") -> Array:
        """Return what each effect of the model does to the residuals (effects, m).

        By taking it out whole: of play or stiff gears the derivative times the size is many times
        that, for it holds at one size only.
        """
        if not self._actions:
            hypothesis, without = self.hypothesis, []
            for index, effect in enumerate(hypothesis.effects):
                x, first = hypothesis.x.copy(), hypothesis.own(index).start
                for k in effect.amplitudes:
                    x[first + k] = data.believed[effect.parameters[k].places[0]]
                without.append(hypothesis.flat(data.believed, x))
            self._actions.append(self.residual - data.residuals(np.stack(without)))
        return self._actions[0]

    @cached_property
    def _actions(self) -> list[Array]:
        return []

    def sharing(self, index: int) -> "Fit":
        """Return this fit without the columns of effect number `index`; the others stay there."""
        shared = np.delete(self.jacobian, self.hypothesis.own(index), axis=1)
        return replace(self, hypothesis=self.hypothesis.without(index), jacobian=shared)

    def moved_last(self, index: int) -> "Fit":
        """Return this fit with its effect number `index` named last."""
        own = self.hypothesis.own(index)
        columns = np.arange(self.jacobian.shape[1])
        order = np.concatenate([np.delete(columns, own), columns[own]])
        hypothesis = self.hypothesis.moved_last(index)
        return replace(self, hypothesis=hypothesis, jacobian=self.jacobian[:, order])

    def slope(self, believed: Array) -> Array:
        """Return half the derivative of Q by the parameters in units of their scales."""
        slope = self.jacobian.T @ self.residual
        z = prior_penalty(self.hypothesis, believed, self.hypothesis.x)
        slope[: len(z)] += z
        return slope


class Data:
    """Runs with their frozen predictor: evaluates residuals of many parameter sets at once.

    They are whitened innovations; in closed loop those of `model`, and what could be foreseen of
    their change from there (answers.py). What rows hide is taken out of them (rows.py).
    """

    _tells_rises = True
    """Whether logs of a closed loop tell how far commands taken as held rise within rows."""

    def __init__(
        self,
        machine: Machine,
        runs: Sequence[Run],
        noise: Noise,
        model: Hypothesis,
        scale: float | None = None,
    ) -> None:
        self.machine = machine
        self.runs = list(runs)
        self.noise = noise
        values = model.flat(machine.believed)
        self.tracks = track_all(machine, runs, values, noise, keep_linear=True)
        require_following(runs, self.tracks)
        self.recordings = [run.recording for run in runs]
        self.believed = machine.believed
        self._kept = [self.kept_rows(run) for run in self.runs]
        self.blocks = self._block_numbers()
        units = list(dict.fromkeys(run.unit for run in self.runs))
        self.units = np.array([units.index(run.unit) for run in self.runs])
        """Number of the unit of each run (runs,)."""
        self.scale = 1.0
        rate_1_s = machine.engine.fastest_rate_1_s(values)
        self._least_rate_1_s = STEPS_ALIKE * rate_1_s
        self._most_rate_1_s = min(max(STIFFEST_1_S, STIFFER * rate_1_s), _core.FASTEST_RATE_1_S)
        news = news_of(machine, runs, self.tracks)
        self.feigned_gain = news.feigned_gain
        """Gain beyond chance below which an effect may be a controller's answer."""
        self.driven = news.along
        """Whether anything but disturbances, and answers to them, moves the robot along its x, its
        y, and round."""
        self._news = news.new if news.answers else None
        self._newsless = self._without_news()
        columns = np.zeros((sum(len(run.t_s) for run in runs) * machine.engine.outputs, 0))
        if machine.kind == "robot":
            columns = hidden_columns(machine, self._newsless, self.tracks, values)
        self._model = model
        self.answers = news.answers
        """Whether commands answer disturbances."""
        self._rises = self._kept_only(columns)
        told = 1 if news.answers and self._tells_rises and machine.holds_commands else 0
        self._hidden = Projection(self._rises[:, told:])
        [residual] = self.residuals(values[None])
        square = float(np.sum(residual**2)) / max(np.count_nonzero(residual), 1)
        self.scale = square**0.5 if scale is None else scale
        """Standard deviation of the innovations in units of what the noise says."""

    def shown_as(self, runs: Sequence[Run]) -> "Data":
        """Return these data with runs that differ in what nothing of the predictor depends on."""
        data = copy(self)
        data.runs, data.recordings = list(runs), [run.recording for run in runs]
        data._newsless = data._without_news()
        return data

    def _without_news(self) -> list[Run]:
        if self._news is None:
            return self.runs
        pairs = zip(self.runs, self._news, strict=True)
        return [run.commanded(run.command - new) for run, new in pairs]

    @cached_property
    def _foreseen(self) -> Foreseen | None:
        """What could be foreseen in a closed loop; nothing in an open one."""
        if not self.answers:
            return None
        values = self._model.flat(self.believed)
        rise, newsless_rise = np.zeros((2, len(self._rises)))
        if self.machine.holds_commands:
            logged = hidden_columns(self.machine, self.runs, self.tracks, values)
            rise, newsless_rise = self._kept_only(logged)[:, 0], self._rises[:, 0]
        [found] = self._innovations(self.recordings, values[None])
        [newsless], [derivatives] = _secants(
            self._innovations_newsless,
            self.believed,
            [self._model],
            0,
            [_longest(self._model, 0)],
            None,
        )
        return Foreseen(found, newsless, derivatives, rise, newsless_rise)

    def residuals(self, sets: Array) -> Array:
        """Return whitened residuals (sets, m) of flat parameter sets (sets, parameters)."""
        found = self._innovations(self.recordings, sets)
        if self._foreseen is not None:
            found = self._foreseen.residuals(found, self._innovations_newsless(sets))
        return self._scaled(found)

    def hidden_likelihood(self, values: Array) -> float:
        """Return what integrating over what rows hide adds to the log likelihood of a set.

        `values` (parameters,) is near the model by which the predictor was frozen.
        """
        [found] = self._innovations(self.recordings, values[None])
        fall = np.sum(found**2) - np.sum(self._hidden.apply(found[None].copy()) ** 2)
        return 0.5 * float(fall - self._hidden.log_determinant)

    def residuals_unseen(self, fits: Sequence["Fit"], sets: Array) -> Array:
        """Return residuals (fits, m) of fits where each unit of runs has a set of its own.

        `sets` is (fits, units, parameters). By so little are these off the fits that answers to
        disturbances do not matter.
        """
        flats = np.stack([one.hypothesis.flat(self.believed) for one in fits])
        own = self._innovations_of(self.recordings, sets, self.units)
        own -= self._innovations(self.recordings, flats)
        return np.stack([one.residual for one in fits]) + self._scaled(own)

    def responses(
        self,
        tracks: Sequence[_core.Track],
        pushes: Callable[[int, Run, Array, Array], tuple[Array, Array]],
    ) -> Array:
        """Return what pushes change of the residuals (m, n); `tracks` keep their matrices.

        `pushes` gives from the number of a run, the run, states (rows, filter states) and those
        before the sensors of their row corrected them, rates from each row to the next (rows,
        filter states, n) and what sensors show besides (rows, outputs, n): `respond` in
        sim/replay.h. What a sensor shows goes with the latter: the corrected state holds its noise
        of that row, and a gyro of a robot that hardly turned showed 0.16 more of slow turns by that
        (gain 323, nothing was missing).
        """

        def columns(
            runs: Sequence[Run], states: Sequence[Array], uncorrected: Sequence[Array]
        ) -> Array:
            found = []
            each = zip(runs, tracks, states, uncorrected, strict=True)
            for k, (run, track, state, seen) in enumerate(each):
                pushed, shown = pushes(k, run, state, seen)
                response = self.machine.engine.response(run.recording, track, pushed, shown)
                found.append(response[self.kept_rows(run)].reshape(-1, response.shape[2]))
            return np.concatenate(found).T

        pairs = list(zip(self.runs, tracks, strict=True))
        states = [track.state.reshape(len(run.t_s), -1) for run, track in pairs]
        uncorrected = [s - corrections(track) for s, track in zip(states, tracks, strict=True)]
        found = columns(self.runs, states, uncorrected)
        if self._foreseen is not None:
            before = [foreseen(run, track) for run, track in pairs]
            found = self._foreseen.part(found, columns(self._newsless, before, before))
        return self._scaled(found).T

    def _scaled(self, changes: Array) -> Array:
        """Residuals or changes (n, m) of innovations, used up, as they count."""
        scaled = self._hidden.apply(changes)
        scaled /= self.scale
        return scaled

    def _innovations_newsless(self, sets: Array) -> Array:
        """Whitened innovations (sets, m) by commands without their news."""
        return self._innovations([run.recording for run in self._newsless], sets)

    def _innovations(self, recordings: Sequence[_core.Recording], sets: Array) -> Array:
        """Whitened innovations (sets, m) of flat parameter sets."""
        return self._innovations_of(recordings, sets[:, None], np.zeros(len(self.runs), np.int64))

    def _innovations_of(
        self,
        recordings: Sequence[_core.Recording],
        sets: Array,
        owners: npt.NDArray[np.int64],
    ) -> Array:
        """Those of models (models, m); run k by the sets (models, parameters) of owners[k]."""
        edges = np.concatenate([[0], np.cumsum(self._sizes())])
        first_row = np.array([int(np.argmax(kept)) for kept in self._kept])
        rungs = [self._rungs(sets[:, owner]) for owner in range(sets.shape[1])]
        residuals = np.empty((len(sets), edges[-1]))
        if any(sum(map(len, own.values())) < len(sets) for own in rungs):
            residuals[:] = np.nan
        for owner, own in enumerate(rungs):
            runs = np.flatnonzero(owners == owner)
            for rate_1_s, places in own.items():
                self.machine.engine.innovations_into(
                    [recordings[k] for k in runs],
                    [self.tracks[k] for k in runs],
                    np.ascontiguousarray(sets[places, owner]),
                    residuals,
                    begin=edges[runs].tolist(),
                    first_row=first_row[runs].tolist(),
                    place=places.tolist(),
                    step_s=STEP_S,
                    least_rate_1_s=rate_1_s,
                )
        most = DIVERGED * self.scale
        if not max(residuals.max(), -residuals.min()) < most:  # not so with NaN either
            np.nan_to_num(residuals, copy=False, nan=most)
            np.clip(residuals, -most, most, out=residuals)
        return residuals

    def _rungs(self, sets: Array) -> dict[float, npt.NDArray[np.int64]]:
        """Sets (sets, parameters) that take the same steps, by the rate for which these are.

        A set's steps depend on itself alone. Without sets that are stiffer than worth following.
        """
        rates = np.array([self.machine.engine.fastest_rate_1_s(values) for values in sets])
        least_1_s = max(self._least_rate_1_s, 1e-9)  # an odometry has no rate
        above = np.log(np.maximum(rates / least_1_s, 1.0)) / np.log(RUNG)
        rungs = np.ceil(above - 1e-9)
        followed = rates <= self._most_rate_1_s
        return {
            self._least_rate_1_s * RUNG**rung: np.flatnonzero(followed & (rungs == rung))
            for rung in np.unique(rungs[followed])
        }

    def _kept_only(self, columns: Array) -> Array:
        """Rows that count of columns (all rows * outputs, n); 0 where these diverge."""
        kept = columns[np.repeat(np.concatenate(self._kept), self.machine.engine.outputs)]
        return np.where(np.abs(kept) < DIVERGED, kept, 0.0)

    def per_run(self, residual: Array) -> list[Array]:
        """Split one residual (m,) into runs."""
        return np.split(residual, np.cumsum(self._sizes())[:-1])

    def per_unit(self, of_runs: Array) -> Array:
        """Sum what runs have (runs, ...) over the runs of each unit (units, ...)."""
        return np.stack(
            [of_runs[self.units == unit].sum(0) for unit in range(self.units.max() + 1)]
        )

    def _sizes(self) -> list[int]:
        """Length of each run's part of a residual."""
        return [int(k.sum()) * self.machine.engine.outputs for k in self._kept]

    def kept_rows(self, run: Run) -> npt.NDArray[np.bool_]:
        """Rows after the filter has found the initial state."""
        return run.t_s >= run.settled_s

    def _block_numbers(self) -> npt.NDArray[np.int64]:
        numbers, offset = [], 0
        for run, kept in zip(self.runs, self._kept, strict=True):
            own = ((run.t_s[kept] - run.t_s[0]) / BLOCK_S).astype(np.int64)
            numbers.append(np.repeat(own + offset, self.machine.engine.outputs))
            offset += int(own[-1]) + 1 if own.size else 0
        return np.concatenate(numbers)


def prior_penalty(hypothesis: Hypothesis, believed: Array, x: Array) -> Array:
    """Return z (base parameters): deviation from the believed value in standard deviations."""
    centre = np.array([believed[p.places[0]] for p in hypothesis.base])
    scale = np.array([p.scale for p in hypothesis.base])
    return (x[: len(hypothesis.base)] - centre) / scale


def objective(data: Data, hypothesis: Hypothesis, x: Array) -> Array:
    """Return Q for each row of x (sets, parameters)."""
    flats = np.stack([hypothesis.flat(data.believed, row) for row in x])
    chance = np.sum(data.residuals(flats) ** 2, axis=1)
    z = np.stack([prior_penalty(hypothesis, data.believed, row) for row in x])
    return chance + np.sum(z**2, axis=1)


def linearise(
    data: Data,
    models: Sequence[Hypothesis],
    first: int = 0,
    residuals: Sequence[Array] | None = None,
    last: Sequence[Array] | None = None,
) -> tuple[Sequence[Array], list[Array]]:
    """Return each model's residual (m,) and derivative (m, own) by its parameters from `first` on.

    By z = change / scale. `residuals` and `last`, derivatives from nearby, are given if known: the
    secants of effects are then so short that the residuals change by FINE_SECANT. Strong effects
    need that: a column of norm n that is off by a share e feigns an information of (e n)^2 where
    two parameters cannot be told apart. What changes in steps (edges, thresholds, a limit that just
    does not act) has no derivative: its fine secant is of another size, and the long one stays. But
    where the long one goes far around (a number of cycles, over hundreds of turns), a finer one has
    the size of the fine one.
    """
    longest = [_longest(model, first) for model in models]
    if last is None:
        return _secants(data.residuals, data.believed, models, first, longest, residuals)
    sizes = [np.linalg.norm(one, axis=0) for one in last]
    fine = [
        np.minimum(most, FINE_SECANT / np.maximum(size, FINE_SECANT))
        for most, size in zip(longest, sizes, strict=True)
    ]
    residuals, columns = _secants(data.residuals, data.believed, models, first, fine, residuals)
    for k, (own, size) in enumerate(zip(columns, sizes, strict=True)):
        found = np.linalg.norm(own, axis=0)
        odd = (fine[k] < longest[k]) & ~((found < ALIKE * size) & (size < ALIKE * found))
        larger = odd & (found > size)
        if larger.any():
            finer = [np.where(larger, FINE_SECANT / np.maximum(found, FINE_SECANT), 0.0)]
            _, [finest] = _secants(
                data.residuals, data.believed, [models[k]], first, finer, [residuals[k]]
            )
            seen = np.linalg.norm(finest, axis=0)
            smooth = larger & (seen < SMOOTH * found) & (found < SMOOTH * seen)
            own[:, smooth] = finest[:, smooth]
            odd &= ~smooth
        if odd.any():
            long = [np.where(odd, longest[k], 0.0)]
            _, [again] = _secants(
                data.residuals, data.believed, [models[k]], first, long, [residuals[k]]
            )
            own[:, odd] = again[:, odd]
    return residuals, columns


def _longest(model: Hypothesis, first: int) -> Array:
    """Lengths of the secants by the parameters from `first` on."""
    return np.where(np.arange(first, len(model.x)) < len(model.base), KEY_SECANT, SECANT)


def _secants(
    residuals_of: Callable[[Array], Array],
    believed: Array,
    models: Sequence[Hypothesis],
    first: int,
    lengths: Sequence[Array],
    residuals: Sequence[Array] | None,
) -> tuple[Sequence[Array], list[Array]]:
    """Residuals and secants (m, own) of models by their parameters from `first` on; 0 if of 0."""
    points = [] if residuals is not None else [model.flat(believed) for model in models]
    steps = []
    for k, model in enumerate(models):
        for i in np.flatnonzero(lengths[k]):
            p, moved = model.parameters[first + i], model.x.copy()
            step = float(lengths[k][i])
            step = step if moved[first + i] + step * p.scale <= p.high else -step
            moved[first + i] += step * p.scale
            points.append(model.flat(believed, moved))
            steps.append((k, i, step))
    found = residuals_of(np.stack(points)) if points else np.empty((0, 0))
    if residuals is None:
        residuals, found = found[: len(models)], found[len(models) :]
    columns = [np.zeros((len(r), len(s))) for r, s in zip(residuals, lengths, strict=True)]
    for (k, i, step), residual in zip(steps, found, strict=True):
        columns[k][:, i] = (residual - residuals[k]) / step
    return residuals, columns


def fit(data: Data, hypothesis: Hypothesis, iterations: int = 10, last: Array | None = None) -> Fit:
    """Minimise Q by Gauss-Newton within bounds.

    `last` is the derivative (m, parameters) of a model nearby, which sizes the secants.
    """
    scale = np.array([p.scale for p in hypothesis.parameters])
    low = np.array([p.low for p in hypothesis.parameters])
    high = np.array([p.high for p in hypothesis.parameters])
    current, fine = hypothesis, last is not None or not hypothesis.effects
    [residual], [jacobian] = linearise(data, [current], last=None if last is None else [last])
    best = _cost(data, current, residual)
    chance = np.count_nonzero(residual)
    for _ in range(iterations):
        converged = max(CONVERGED, FAR_CONVERGED * (best - chance))
        here = Fit(current, best, residual, jacobian)
        slope = here.slope(data.believed)
        step = solve_within(here.information, slope, *current.room())
        promised = float(-2.0 * slope @ step - step @ here.information @ step)
        if promised < converged and fine:
            break
        rows = np.clip(current.x + np.outer(STEPS, step * scale), low, high)
        trials = [replace(current, x=row) for row in rows]
        found = data.residuals(np.stack([t.flat(data.believed) for t in trials]))
        costs = [_cost(data, t, r) for t, r in zip(trials, found, strict=True)]
        pick = int(np.argmin(costs))
        gained = best - costs[pick]
        if gained > 0:
            current, best, residual = trials[pick], costs[pick], found[pick]
        kept = gained < NEAR_THE_END and abs(gained - promised) < CONVERGED
        if fine and (kept or gained < max(converged, ROUGH * promised)):
            break  # so near that the derivative is still that of the optimum, or rough
        first = 0 if gained >= converged else len(current.base)
        _, [own] = linearise(data, [current], first, [residual], [jacobian[:, first:]])
        jacobian, fine = np.hstack([jacobian[:, :first], own]), True
    return Fit(current, best, residual, jacobian)


def fit_more(
    data: Data, current: Fit, starts: Sequence[Hypothesis], iterations: int = 6
) -> list[Fit]:
    """Fit many models at once that hold one effect more than `current`.

    The derivative by what they share with `current` is taken from there, which costs nothing and
    ranks them; the fit of a large effect is only near its optimum and `fit` goes on from it.
    """
    count = current.jacobian.shape[1]
    shared = current.information
    models = list(starts)
    residuals, columns = linearise(data, models, count)
    costs = np.array([_cost(data, m, r) for m, r in zip(models, residuals, strict=True)])
    live = set(range(len(models)))
    for _ in range(iterations):
        order = sorted(live)
        trials = []
        for k in order:
            step = _shared_step(data, current, shared, models[k], residuals[k], columns[k])
            trials += [replace(models[k], x=_within(models[k], step * s)) for s in FEW_STEPS]
        if not trials:
            break
        found = data.residuals(np.stack([t.flat(data.believed) for t in trials]))
        reached = np.array([_cost(data, t, r) for t, r in zip(trials, found, strict=True)])
        for place, k in enumerate(order):
            own = slice(place * len(FEW_STEPS), (place + 1) * len(FEW_STEPS))
            pick = own.start + int(np.argmin(reached[own]))
            gained = costs[k] - reached[pick]
            if gained > 0:
                models[k], costs[k], residuals[k] = trials[pick], reached[pick], found[pick]
            if gained < WORTH_A_ROUND:
                live.discard(k)
        moved = sorted(live)
        last = [columns[k] for k in moved]
        _, fresh = linearise(data, [models[k] for k in moved], count, residuals[moved], last)
        for k, own_columns in zip(moved, fresh, strict=True):
            columns[k] = own_columns
    return [
        Fit(m, float(q), r, np.hstack([current.jacobian, c]))
        for m, q, r, c in zip(models, costs, residuals, columns, strict=True)
    ]


def costs_refitted(data: Data, current: Fit, models: Sequence[Hypothesis]) -> Array:
    """Return Q (models,) after one linear step of what the models share with `current`.

    A start has to be judged so: the keys of a model without an effect have gone far to replace it.
    """
    shared, room = current.information, current.hypothesis.room()
    base = len(current.hypothesis.base)
    costs = np.empty(len(models))
    for first in range(0, len(models), BATCH):
        batch = models[first : first + BATCH]
        residuals = data.residuals(np.stack([m.flat(data.believed) for m in batch]))
        slopes = residuals @ current.jacobian
        for k, (model, residual) in enumerate(zip(batch, residuals, strict=True)):
            z = prior_penalty(model, data.believed, model.x)
            slope = slopes[k]
            slope[:base] += z
            step = solve_within(shared, slope, *room)
            costs[first + k] = residual @ residual + z @ z + 2 * step @ slope + step @ shared @ step
    return costs


def fitted_without_each_unit(data: Data, fitted: Fit) -> Array:
    """Return flat values (units, parameters) of the model fitted without one unit of runs each.

    One Gauss-Newton step from the fit to all of them (leave-one-out by the normal matrix).
    """
    hypothesis = fitted.hypothesis
    scale = np.array([p.scale for p in hypothesis.parameters])
    parts = zip(data.per_run(fitted.jacobian), data.per_run(fitted.residual), strict=True)
    slopes = data.per_unit(np.array([j.T @ r for j, r in parts]))
    gram, slope = fitted.information, fitted.slope(data.believed)
    values = []
    for own_gram, own_slope in zip(_grams(data, fitted), slopes, strict=True):
        step = solve_within(gram - own_gram, slope - own_slope, *hypothesis.room())
        values.append(hypothesis.flat(data.believed, hypothesis.x + step * scale))
    return np.stack(values)


def _grams(data: Data, fitted: Fit) -> Array:
    """Information (units, parameters, parameters) that each unit of runs holds."""
    return data.per_unit(np.array([j.T @ j for j in data.per_run(fitted.jacobian)]))


def left_by_shapes(
    data: Data,
    fitted: Fit,
    change: Array,
    left: Array,
    share_of: Callable[[Candidate], float],
    unrelated: Callable[[Candidate], bool] = lambda _: False,
) -> float:
    """Return the gain along a change of the residuals (m,) that shapes of effects may leave.

    `left` are the residuals (m,) without the change, `unrelated` tells effects that know nothing of
    what the change goes with, as a limit of the current does of angles: they are off as they are,
    with one sign in a block as in the next by chance only.

    No plant has an effect's shape exactly. One that is off by a share e_i of what the effect does
    in residual i, a_i, leaves e_i a_i there. With |e_i| <= e that gives a change k a gain of up to
    e^2 (sum |a_i k_i|)^2 / sum k_i^2: nothing where they act in other rows or other channels,
    e^2 sum a_i^2 where they act alike. Errors of different effects are independent, their gains
    add. `share_of` is e^2 of an effect of the model. Where all residuals hold less than an effect
    would leave that is 3 % off, it is less off, by as much.
    """
    if not change.any():
        return 0.0
    shares = np.array([share_of(effect) for effect in fitted.hypothesis.effects])
    if not shares.any():
        return 0.0
    actions = fitted.actions(data)
    by_least = np.maximum(LEAST_OFF**2 * np.sum(actions**2, axis=1), 1e-12)
    shares = shares * np.minimum(1.0, float(left @ left) / by_least)
    along = most_along(actions, change)
    by_chance = [unrelated(effect) for effect in fitted.hypothesis.effects]
    if any(by_chance):
        along = np.where(by_chance, most_along(actions, change, data.blocks), along)
    return float(shares @ along)


def most_along(actions: Array, change: Array, blocks: npt.NDArray[np.int64] | None = None) -> Array:
    """Return the most gain (n,) along a change (m,) that actions (n, m) leave if all off.

    `blocks` (m,): in each of these with a sign of its own.
    """
    square = float(change @ change)
    if not square:
        return np.zeros(len(actions))
    if blocks is None:
        return (np.abs(actions) @ np.abs(change)) ** 2 / square
    each = [np.bincount(blocks, np.abs(action * change)) for action in actions]
    return np.sum(np.square(each), axis=1) / square


@dataclass(frozen=True)
class Check:
    """What a change of the model does to each unit of runs (units,) by sizes fitted without it.

    `gains` is the fall of the square error, `stakes` the square of the change in the fits to all
    runs. Where the change is right, a gain is its stake +- twice its root, less what the sizes are
    off by chance: `unsure`, the square error to be expected of that.
    """

    gains: Array
    stakes: Array
    unsure: Array

    @property
    def judges(self) -> npt.NDArray[np.bool_]:
        """Units about which the others tell enough: not one that holds nearly all that is known."""
        return self.unsure < np.maximum(self.stakes, LEAST_STAKE)

    @property
    def gain(self) -> float:
        """Sum over the units that judge."""
        return float(np.sum(self.gains[self.judges]))

    @property
    def voters(self) -> npt.NDArray[np.bool_]:
        """Of these those in which enough is at stake for the sign of the gain to tell anything."""
        least = max(LEAST_STAKE, WEAK * float(np.mean(self.stakes)))
        return self.judges & (self.stakes > least)

    @property
    def helped(self) -> int:
        """How many of these gain."""
        return int(np.sum(self.gains[self.voters] > 0))

    @property
    def helps(self) -> bool:
        """Whether the sum is positive, and 3 of 4 units gain or the mean beyond their scatter.

        The second is a t-test.
        """
        if not self.gain > 0 or not self.voters.any():
            return False
        if self.helped >= HELPED_SHARE * np.sum(self.voters):
            return True
        gains = self.gains[self.judges]
        count = len(gains)
        error = np.std(gains, ddof=1) / np.sqrt(count) if count > 1 else np.inf
        return self.gain / count > error * student.isf(SCATTER_P_VALUE, max(count - 1, 1))


def check_unseen(data: Data, without: Fit, fits: Sequence[Fit]) -> list[Check]:
    """Judge each of the fits against `without` on units of runs that were left out of both.

    An error counts up to `MOST_ERROR` standard deviations: where wheels spin out, a model that is
    nearly right may be further off in a few rows than one that never lets them spin. And a unit
    gains no more than it does where it was fitted: a linear step that is too long for the model
    without the effect is no merit of the effect.
    """
    if not fits:
        return []
    models = [without, *fits]
    sets = np.stack([fitted_without_each_unit(data, one) for one in models])
    unseen = _bounded_squares(data, data.residuals_unseen(models, sets))
    seen = _bounded_squares(data, np.stack([one.residual for one in models]))
    unsure_without = _unsure(data, without)
    return [
        Check(
            np.minimum(unseen[0] - unseen[k], seen[0] - seen[k]),
            _bounded_squares(data, (one.residual - without.residual)[None])[0],
            _unsure(data, one) - unsure_without,
        )
        for k, one in enumerate(fits, 1)
    ]


def _unsure(data: Data, fitted: Fit) -> Array:
    """Square error (units,) to be expected of sizes that were fitted without a unit."""
    whole = fitted.information
    # Something for sizes of which no other run, or none at all, tells anything.
    least = 1e-9 * np.diag(np.maximum(np.diag(whole), 1.0))
    return np.array(
        [np.trace(np.linalg.solve(whole - own + least, own)) for own in _grams(data, fitted)]
    )


def _bounded_squares(data: Data, residuals: Array) -> Array:
    """Square error (models, units) of residuals (models, m), each bounded."""
    bounded = np.clip(residuals, -MOST_ERROR, MOST_ERROR)
    squares = [[np.sum(part**2) for part in data.per_run(one)] for one in bounded]
    return data.per_unit(np.array(squares).T).T


def check_columns(data: Data, residual: Array, columns: Array) -> Check:
    """Judge a linear change of a residual (m,) by columns (m, k), sizes by least squares."""
    parts = list(zip(data.per_run(columns), data.per_run(residual), strict=True))
    grams = data.per_unit(np.array([c.T @ c for c, _ in parts]))
    slopes = data.per_unit(np.array([c.T @ r for c, r in parts]))
    gains, stakes, unsure = (np.empty(len(grams)) for _ in range(3))
    for unit in range(len(grams)):
        others = np.arange(len(grams)) != unit
        inverse = np.linalg.pinv(grams[others].sum(0), rcond=1e-9, hermitian=True)
        sizes = -inverse @ slopes[others].sum(0)
        stakes[unit] = sizes @ grams[unit] @ sizes
        gains[unit] = -2.0 * sizes @ slopes[unit] - stakes[unit]
        unsure[unit] = np.trace(inverse @ grams[unit])
    return Check(gains, stakes, unsure)


def _cost(data: Data, hypothesis: Hypothesis, residual: Array) -> float:
    z = prior_penalty(hypothesis, data.believed, hypothesis.x)
    return float(residual @ residual + z @ z)


def _within(hypothesis: Hypothesis, step: Array) -> Array:
    """Parameters moved by a step in units of their scales, kept within their bounds."""
    parameters = hypothesis.parameters
    moved = hypothesis.x + step * np.array([p.scale for p in parameters])
    return np.clip(moved, [p.low for p in parameters], [p.high for p in parameters])


def _shared_step(
    data: Data,
    current: Fit,
    shared: Array,
    model: Hypothesis,
    residual: Array,
    own: Array,
) -> Array:
    """Bounded Gauss-Newton step of a model, the derivative of the shared parameters given."""
    cross = current.jacobian.T @ own
    gram = np.block([[shared, cross], [cross.T, own.T @ own]])
    slope = np.concatenate([current.jacobian.T @ residual, own.T @ residual])
    base = len(model.base)
    slope[:base] += prior_penalty(model, data.believed, model.x)
    return solve_within(gram, slope, *model.room())


def solve_within(gram: Array, slope: Array, low: Array, high: Array) -> Array:
    """Least-squares step within bounds from the normal matrix (columns are few).

    What nothing depends on, the edge of a patch that no run crosses, stays where it is.
    """
    if not len(gram):
        return np.zeros(0)
    seen = np.diag(gram) > LEAST_INFORMATION
    low, high = np.where(seen, low, 0.0), np.where(seen, high, 0.0)
    ridge = 1e-9 * np.trace(gram) / len(gram) + LEAST_INFORMATION
    factor = np.linalg.cholesky(gram + ridge * np.eye(len(gram))).T
    target = np.linalg.solve(factor.T, -slope)
    low, high = np.minimum(low, 0.0) - 1e-9, np.maximum(high, 0.0) + 1e-9
    return lsq_linear(factor, target, (low, high), method="bvls").x


@dataclass(frozen=True)
class Evidence:
    """How strongly the data speak for the last effect of a fitted model.

    `gain` is T, `inflation` c, `p_value` that of the F-test for one candidate; `covariance` of the
    effect's parameters in their units, inflated by the same factor.

    `variation` is how much the effect's size changes from block to block, relative to itself: with
    I_b the information of a block and a size x (1 + v_b) in it, the block sums of the score vary by
    c - 1 = x^2 var(v) sum I_b^2 / sum I_b beyond what white residuals would, and T = x^2 sum I_b.
    """

    gain: float
    inflation: float
    p_value: float
    covariance: Array
    variation: float = 0.0

    @property
    def beyond_chance(self) -> float:
        """T / c."""
        return self.gain / self.inflation


def weigh(data: Data, without: Fit, with_effect: Fit, index: int) -> Evidence:
    """Judge effect number `index` of a fit against the fitted model `without` it.

    The edges of a patch are left out of the inflation: the few rows where they are crossed say
    where the patch is, not whether. Where few blocks of all make the inflation (wheels that spin
    out once, a little too late in the model), what the other blocks say without them may suffice;
    they are then one of so many choices of blocks. But what gains little has to be no chance
    without the block that gains most, too: of rows that are off for reasons of their own, a pebble
    or a lost stamp, some effect can make something. (Of the 43 that a current limit gained beside a
    grip that falls off 37 were those of a few rows.) So has a patch, however much it gains: one of
    3 mm lies wherever a reading is off (and gained 278, in one row).
    """
    hypothesis = with_effect.hypothesis
    effect = hypothesis.effects[index]
    places = hypothesis.own(index)
    own = list(range(places.start, places.stop))
    score, information = _projected(with_effect, own)
    scale = np.array([hypothesis.parameters[i].scale for i in own])
    tested = score, information
    if effect.edges_m:
        tested = _projected(with_effect, [own[i] for i in effect.amplitudes])
    scatter = scatter_of(data, tested[0], with_effect.residual, tested[1])
    gain = without.objective - with_effect.objective
    gains = np.bincount(data.blocks, without.residual**2 - with_effect.residual**2)

    def chance_without(blocks: Array) -> float:
        """Return the p-value without blocks, or without few of those that make c as well."""
        most = FEW_BLOCKS if scatter.blocks < FEW_BLOCKS + 1 else 0
        chances = []
        for few in range(most + 1):
            gone = np.union1d(blocks, scatter.worst[:few])
            rest = scatter
            if gone.size:
                kept = tested[0] * ~np.isin(data.blocks, gone)[:, None]
                rest = scatter_of(data, kept, with_effect.residual, kept.T @ kept)
            chance = _chance(gain - float(np.sum(gains[gone])), rest, len(own))
            chances.append(chance * comb(len(gains), few))
        return min(chances)

    p_value = chance_without(np.zeros(0, np.int64))
    if effect.edges_m or gain / scatter.inflation < NO_ACCIDENT:
        p_value = max(p_value, chance_without(np.argsort(-gains)[:1]))
    free = np.ix_(*2 * [[k for k, p in enumerate(effect.parameters) if p.low < p.high]])
    covariance = np.zeros_like(information)
    covariance[free] = np.linalg.pinv(information[free])
    covariance *= np.outer(scale, scale) * scatter.inflation
    variation = _variation(data, *tested, gain, scatter.inflation)
    return Evidence(gain, scatter.inflation, p_value, covariance, variation)


def spread_over_runs(data: Data, fitted: Fit, index: int) -> float:
    """Return the standard deviation from run to run of the one size of effect `index`.

    A run of score s (m,) and residual r has a size that is s.r / s.s off the common one; each is
    weighed by s.s, what it tells. 0 where less than two runs tell.
    """
    place = fitted.hypothesis.own(index).start
    score, _ = _projected(fitted, [place])
    own = zip(data.per_run(score[:, 0]), data.per_run(fitted.residual), strict=True)
    off, known = np.array([(float(s @ r), float(s @ s)) for s, r in own]).T
    told = known > 0
    if np.sum(told) < 2:
        return 0.0
    square = np.sum(off[told] ** 2 / known[told]) / np.sum(known)
    unbiased = np.sum(told) / (np.sum(told) - 1)
    return float(fitted.hypothesis.parameters[place].scale * np.sqrt(square * unbiased))


def _variation(
    data: Data, score: Array, information: Array, gain: float, inflation: float
) -> float:
    """Return the effect's change of size (Evidence) from its score (m, k) by blocks."""
    by_row = np.sum((score @ np.linalg.pinv(information, hermitian=True)) * score, axis=1)
    by_block = np.bincount(data.blocks, by_row)
    blocks = np.sum(by_block) ** 2 / max(float(np.sum(by_block**2)), 1e-300)
    return float(np.sqrt((inflation - 1.0) * blocks / max(gain, 1e-9)))


def _chance(gain: float, scatter: "Scatter", parameters: int) -> float:
    """Return the p-value of the F-test."""
    inflation = scatter.inflation
    known_from = scatter.blocks * inflation / max(inflation - 1.0, 1e-6)
    return float(f_distribution.sf(max(gain, 0.0) / inflation / parameters, parameters, known_from))


def absorbed(fitted: Fit, columns: Array, leave_out: Sequence[int] = ()) -> tuple[Array, Array]:
    """Regress columns (m, k) on the derivative of the fit, believed keys with their prior.

    Return the columns without that, and the weights (parameters, k). Parameters on a bound, and
    those left out, cannot move and take nothing.
    """
    others = [
        i for i in range(fitted.jacobian.shape[1]) if i not in leave_out and not at_bound(fitted, i)
    ]
    b = fitted.jacobian[:, others]
    gram = fitted.information[np.ix_(others, others)]
    gram += 1e-9 * np.trace(gram) / max(len(gram), 1) * np.eye(len(gram))
    weights = np.zeros((fitted.jacobian.shape[1], columns.shape[1]))
    weights[others] = np.linalg.solve(gram, b.T @ columns)
    return columns - b @ weights[others], weights


def free_of_fitted(fitted: Fit, columns: Array) -> Array:
    """Return columns (m, k) without what the fitted parameters explain."""
    return absorbed(fitted, columns)[0]


def _projected(fitted: Fit, own: list[int]) -> tuple[Array, Array]:
    """Return the columns of `own` free of what the other parameters explain, and their Gram."""
    score, weights = absorbed(fitted, fitted.jacobian[:, own], own)
    pull = weights[: len(fitted.hypothesis.base)]
    return score, score.T @ score + pull.T @ pull


def at_bound(fitted: Fit, index: int) -> bool:
    """Return whether free parameter `index` rests on one of its bounds."""
    p, x = fitted.hypothesis.parameters[index], fitted.hypothesis.x[index]
    return x <= p.low + 1e-6 * p.scale or x >= p.high - 1e-6 * p.scale


def inflation_of(data: Data, score: Array, residual: Array, information: Array) -> float:
    """Return c: how much the block sums of a score vary beyond what white residuals would."""
    return scatter_of(data, score, residual, information).inflation


@dataclass(frozen=True)
class Scatter:
    """How the block sums of a score vary: c, from how many blocks it is known, worst block first.

    That number is (sum q)^2 / sum q^2 of the blocks' squares q: one if a single block makes c.
    """

    inflation: float
    blocks: float
    worst: npt.NDArray[np.int64]


def scatter_of(data: Data, score: Array, residual: Array, information: Array) -> Scatter:
    """Measure the scatter of a score (m, k) with its `information` (k, k)."""
    blocks = data.blocks
    sums = np.stack(
        [np.bincount(blocks, score[:, k] * residual) for k in range(score.shape[1])], axis=1
    )
    spread = sums.T @ sums
    sizes, axes = np.linalg.eigh(information)
    seen = sizes > 1e-9 * max(sizes[-1], 1e-300)
    if not seen.any():
        return Scatter(1.0, float(len(sums)), np.arange(len(sums)))
    root = axes[:, seen] / np.sqrt(sizes[seen])
    squares = np.sum((sums @ root) ** 2, axis=1)
    known_from = np.sum(squares) ** 2 / max(float(np.sum(squares**2)), 1e-300)
    inflation = float(np.max(np.linalg.eigvalsh(root.T @ spread @ root)))
    return Scatter(max(1.0, inflation), max(1.0, float(known_from)), np.argsort(-squares))
