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
blocks of half a second, and T / max(1, c) is compared with the chi-squared of its parameter count.
(Score test with cluster-robust variance: White, Econometrica 1982; Liang and Zeger 1986.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from omnislip.gap.machine import Candidate, Machine, Parameter
from omnislip.gap.noise import Noise, track_all
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

BLOCK_S = 0.5
SETTLE_S = 0.25
BATCH = 64
STEPS = (1.0, 0.5, 0.2, 0.05)
SECANT = 0.05
CONVERGED = 0.05


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
        """Return the flat parameter set of the engine."""
        values = believed.copy()
        for parameter, number in zip(self.parameters, self.x if x is None else x, strict=True):
            values[list(parameter.places)] = number
        return values

    def with_effect(self, candidate: Candidate, sizes: Sequence[float]) -> "Hypothesis":
        """Return this model with one more effect, its parameters at `sizes`."""
        return replace(self, effects=(*self.effects, candidate), x=np.concatenate([self.x, sizes]))

    def without(self, index: int) -> "Hypothesis":
        """Return this model without its effect number `index`."""
        first = len(self.base) + sum(len(e.parameters) for e in self.effects[:index])
        gone = range(first, first + len(self.effects[index].parameters))
        effects = self.effects[:index] + self.effects[index + 1 :]
        return replace(self, effects=effects, x=np.delete(self.x, list(gone)))

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
        first = len(self.base) + sum(len(e.parameters) for e in self.effects[:index])
        return self.x[first : first + len(self.effects[index].parameters)]


@dataclass(frozen=True)
class Fit:
    """A fitted hypothesis: objective, residual and derivative at the optimum (whitened, by s)."""

    hypothesis: Hypothesis
    objective: float
    residual: Array
    jacobian: Array = field(repr=False)


class Data:
    """Runs with their frozen predictor: evaluates residuals of many parameter sets at once."""

    def __init__(self, machine: Machine, runs: Sequence[Run], noise: Noise, values: Array) -> None:
        self.machine = machine
        self.runs = list(runs)
        self.noise = noise
        self.tracks = track_all(machine, runs, values, noise)
        self.recordings = [run.recording for run in runs]
        self.believed = machine.believed
        self._kept = [self.kept_rows(run) for run in self.runs]
        self.blocks = self._block_numbers()
        self.scale = 1.0
        residual = self.residuals(values[None])[0]
        self.scale = float(np.sqrt(np.sum(residual**2) / max(np.count_nonzero(residual), 1)))

    def residuals(self, sets: Array) -> Array:
        """Return whitened residuals (sets, m) of flat parameter sets (sets, parameters)."""
        parts = []
        for first in range(0, len(sets), BATCH):
            batch = np.ascontiguousarray(sets[first : first + BATCH])
            arrays = self.machine.engine.innovations(self.recordings, self.tracks, batch)
            kept = [
                a[:, k].reshape(len(batch), -1) for a, k in zip(arrays, self._kept, strict=True)
            ]
            parts.append(np.concatenate(kept, axis=1))
        residuals = np.concatenate(parts) / self.scale
        return np.nan_to_num(residuals, nan=1e3, posinf=1e3, neginf=-1e3)

    def per_run(self, residual: Array) -> list[Array]:
        """Split one residual (m,) into runs."""
        sizes = [int(k.sum()) * self.machine.engine.outputs for k in self._kept]
        return np.split(residual, np.cumsum(sizes)[:-1])

    def kept_times(self, index: int) -> Array:
        """Times of the rows of run `index` that count."""
        return self.runs[index].t_s[self._kept[index]]

    def kept_rows(self, run: Run) -> npt.NDArray[np.bool_]:
        """Rows after the filter has found the initial state."""
        return run.t_s >= run.t_s[0] + SETTLE_S

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


def linearise(data: Data, hypothesis: Hypothesis) -> tuple[Array, Array]:
    """Return residual (m,) and its derivative (m, parameters) by z = change / scale."""
    scale = np.array([p.scale for p in hypothesis.parameters])
    high = np.array([p.high for p in hypothesis.parameters])
    steps = np.where(hypothesis.x + SECANT * scale <= high, SECANT, -SECANT)
    points = np.vstack([hypothesis.x, hypothesis.x + np.diag(steps * scale)])
    flats = np.stack([hypothesis.flat(data.believed, row) for row in points])
    residuals = data.residuals(flats)
    return residuals[0], ((residuals[1:] - residuals[0]) / steps[:, None]).T


def fit(data: Data, hypothesis: Hypothesis, iterations: int = 10) -> Fit:
    """Minimise Q by Gauss-Newton within bounds."""
    scale = np.array([p.scale for p in hypothesis.parameters])
    low = np.array([p.low for p in hypothesis.parameters])
    high = np.array([p.high for p in hypothesis.parameters])
    count = len(hypothesis.base)
    current = hypothesis
    best = float(objective(data, current, current.x[None])[0])
    for _ in range(iterations):
        residual, jacobian = linearise(data, current)
        z = prior_penalty(current, data.believed, current.x)
        prior = np.zeros((count, len(scale)))
        prior[:, :count] = np.eye(count)
        step = _bounded_step(
            np.vstack([jacobian, prior]),
            np.concatenate([residual, z]),
            (low - current.x) / scale,
            (high - current.x) / scale,
        )
        trials = np.clip(current.x + np.outer(STEPS, step * scale), low, high)
        costs = objective(data, current, trials)
        pick = int(np.argmin(costs))
        gained = best - costs[pick]
        if gained > 0:
            best = float(costs[pick])
            current = replace(current, x=trials[pick])
        if gained < CONVERGED:
            break
    residual, jacobian = linearise(data, current)
    return Fit(current, best, residual, jacobian)


def _bounded_step(matrix: Array, residual: Array, low: Array, high: Array) -> Array:
    """Least-squares step within bounds, through the normal matrix (columns are few)."""
    gram = matrix.T @ matrix
    ridge = 1e-9 * np.trace(gram) / len(gram)
    factor = np.linalg.cholesky(gram + ridge * np.eye(len(gram))).T
    target = np.linalg.solve(factor.T, -matrix.T @ residual)
    low, high = np.minimum(low, 0.0) - 1e-9, np.maximum(high, 0.0) + 1e-9
    return lsq_linear(factor, target, (low, high), method="bvls").x


@dataclass(frozen=True)
class Evidence:
    """How strongly the data speak for the last effect of a fitted model.

    `gain` is T, `inflation` c, `p_value` of T / max(1, c) for one candidate; `covariance` of the
    effect's parameters in their units, inflated by the same factor.
    """

    gain: float
    inflation: float
    p_value: float
    covariance: Array


def weigh(data: Data, without: float, with_effect: Fit, index: int) -> Evidence:
    """Judge effect number `index` of a fit against the objective of the model `without` it."""
    hypothesis = with_effect.hypothesis
    first = len(hypothesis.base) + sum(len(e.parameters) for e in hypothesis.effects[:index])
    own = list(range(first, first + len(hypothesis.effects[index].parameters)))
    score, information = _projected(with_effect, own)
    inflation = inflation_of(data, score, with_effect.residual, information)
    gain = without - with_effect.objective
    scale = np.array([hypothesis.parameters[i].scale for i in own])
    covariance = np.linalg.pinv(information) * np.outer(scale, scale) * inflation
    p_value = float(chi2.sf(max(gain, 0.0) / inflation, len(own)))
    return Evidence(gain, inflation, p_value, covariance)


@dataclass(frozen=True)
class Absorbed:
    """What the fitted parameters take of some columns: parameter numbers and weights (k, columns).

    Parameters on a bound, and those left out on purpose, cannot move and take nothing.
    """

    parameters: list[int]
    weights: Array

    def rest(self, jacobian: Array, columns: Array) -> Array:
        """Return the columns (m, ...) without that, on any runs with their own derivative."""
        return columns - jacobian[:, self.parameters] @ self.weights


def absorbed(fitted: Fit, columns: Array, leave_out: Sequence[int] = ()) -> Absorbed:
    """Regress columns (m, k) on the derivative of the fit, believed keys with their prior."""
    count = len(fitted.hypothesis.base)
    others = [
        i for i in range(fitted.jacobian.shape[1]) if i not in leave_out and not at_bound(fitted, i)
    ]
    b = fitted.jacobian[:, others]
    gram = b.T @ b + np.diag([1.0 if i < count else 0.0 for i in others])
    gram += 1e-9 * np.trace(gram) / max(len(gram), 1) * np.eye(len(gram))
    return Absorbed(others, np.linalg.solve(gram, b.T @ columns))


def free_of_fitted(fitted: Fit, columns: Array) -> Array:
    """Return columns (m, k) without what the fitted parameters explain."""
    return absorbed(fitted, columns).rest(fitted.jacobian, columns)


def _projected(fitted: Fit, own: list[int]) -> tuple[Array, Array]:
    """Return the columns of `own` free of what the other parameters explain, and their Gram."""
    columns = fitted.jacobian[:, own]
    taken = absorbed(fitted, columns, own)
    score = taken.rest(fitted.jacobian, columns)
    count = len(fitted.hypothesis.base)
    pull = taken.weights[[k for k, i in enumerate(taken.parameters) if i < count]]
    return score, score.T @ score + pull.T @ pull


def at_bound(fitted: Fit, index: int) -> bool:
    """Return whether free parameter `index` rests on one of its bounds."""
    p, x = fitted.hypothesis.parameters[index], fitted.hypothesis.x[index]
    return x <= p.low + 1e-6 * p.scale or x >= p.high - 1e-6 * p.scale


def inflation_of(data: Data, score: Array, residual: Array, information: Array) -> float:
    """Return c: how much the block sums of a score vary beyond what white residuals would."""
    blocks = data.blocks
    sums = np.stack(
        [np.bincount(blocks, score[:, k] * residual) for k in range(score.shape[1])], axis=1
    )
    spread = sums.T @ sums
    sizes, axes = np.linalg.eigh(information)
    seen = sizes > 1e-9 * max(sizes[-1], 1e-300)
    if not seen.any():
        return 1.0
    root = axes[:, seen] / np.sqrt(sizes[seen])
    return max(1.0, float(np.max(np.linalg.eigvalsh(root.T @ spread @ root))))
