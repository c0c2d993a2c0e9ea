"""What simpler methods name from the same logs: the baselines of `omnislip gap benchmark`.

base refit  Every believed key is fitted, free by 90 %; names nothing.
BIC         Forward selection on open-loop error: replays of one second from the states of the
            refitted model's filter. Secants screen the catalogue, the most promising are refitted
            with all keys, the lowest criterion n ln(square error) + k ln n wins (Schwarz 1978)
            until none lowers it. Errors of a replay last, so that n counts independent ones:
            n (1 - r) / (1 + r) with r the correlation from row to row (Bayley, Hammersley 1946).
SINDy       Sparse regression of the discrepancy (Brunton, Proctor, Kutz, PNAS 2016; Kaheman et al.,
            2019): accelerations of shafts and body from the filtered speeds, as means over
            `SPAN_ROWS` rows, minus those of the refitted model, on terms with PySINDy's
            thresholded least squares, and stepwise ones that drop the weakest term (Boninsegna et
            al. 2018). What changes no acceleration at once (sensors, delay, drift) has no term.
ridge       All terms at once on the innovations. An effect is named that gives `NAMED_SHARE` of
            what all of them explain.

A term of SINDy and ridge is the secant of one effect of the catalogue at its typical size, free of
what the keys explain: the library has the right forms and their names, as good a library as can
be. Of an effect with a shape (period, place) it holds the one start that alone promises most; what
is infinite when absent (stiffness, limit) is not linear and has no term. Thresholds, numbers of
terms and lambda are chosen by cross-validation over runs, the simplest within one standard error of
the best (Breiman et al. 1984); the effects that are named are then refitted with all keys.

Every method gets the runs that the workflow made of the logs (gates passed, cut at pushes) and its
refitted model, and names at most `MOST_EFFECTS`.
"""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec

import numpy as np
import numpy.typing as npt

from omnislip.errors import InputError
from omnislip.gap.inference import (
    BATCH,
    DIVERGED,
    Data,
    Fit,
    Hypothesis,
    fit,
    fit_more,
    free_of_fitted,
)
from omnislip.gap.machine import CURVE, Candidate, Machine
from omnislip.gap.metrics import WINDOW_S, gap_table, replay_all
from omnislip.gap.noise import Noise, track_all, tune_noise
from omnislip.gap.peers import FREE
from omnislip.gap.recordings import Run
from omnislip.gap.screen import Screened, screen
from omnislip.gap.search import NEIGHBOURS
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.split import Split

Array = npt.NDArray[np.float64]
Pair = tuple[str, int | None]

METHODS = ("base refit", "BIC", "SINDy", "ridge")
REFITS, ITERATIONS, MOST_EFFECTS = 3, 3, 3
"""Three effects are two and a friction curve: no case hides more."""
REPLAY_STEP_S = 2.5e-3
SPAN_ROWS = 8
SHAFTS_AND_BODY = (0, 1, 2, 3, 8, 9, 10)
"""States whose accelerations are compared."""
THRESHOLDS = np.logspace(-2, 0, 9)
RIDGE, MOST_TERMS = 1e-3, 6
LAMBDAS = np.logspace(-4, 4, 25)
NAMED_SHARE = 0.1


@dataclass(frozen=True)
class Answer:
    """Effects a method names, strongest first, and the parameter set of its model."""

    named: tuple[Pair, ...]
    values: Array


def check_installed() -> None:
    """InputError if the package that one of the methods needs is missing."""
    if find_spec("pysindy") is None:
        raise InputError("pysindy is not installed: .venv/bin/pip install pysindy")


def ask_baselines(
    machine: Machine, split: Split, refit: Hypothesis, noise: Noise
) -> dict[str, Answer]:
    """Return the answer of every method; `refit` are the keys as the workflow fitted them.

    The noise is tuned for that model, from a first `noise`: a defect counts as noise while it is
    not explained.
    """
    runs = split.fitting
    values = refit.flat(machine.believed)
    noise = tune_noise(machine, runs, values, noise)
    data = Data(machine, runs, noise, refit)
    return {
        "base refit": _free_refit(data),
        "BIC": _lowest_criterion(OpenLoop(machine, runs, noise, refit), refit),
        "SINDy": _sparse(Accelerations(machine, runs, noise, refit), data, refit),
        "ridge": _ridge(data, refit),
    }


def _free_refit(data: Data) -> Answer:
    free = data.machine.of(replace(data.machine.model, tolerance={"default": FREE}))
    fitted = fit(data, believed_hypothesis(free))
    return Answer((), fitted.hypothesis.flat(data.believed))


class OpenLoop(Data):
    """Errors of one-second replays, in the deviations that the noise alone gives them."""

    def kept_rows(self, run: Run) -> npt.NDArray[np.bool_]:
        """Rows of windows; the first row past the settling time belongs to none."""
        kept = super().kept_rows(run)
        kept[np.argmax(kept)] = False
        return kept

    def residuals(self, sets: Array) -> Array:
        """Return errors (sets, m) of flat parameter sets."""
        batches = np.array_split(sets, np.arange(BATCH, len(sets), BATCH))
        return np.concatenate([self._errors(np.ascontiguousarray(batch)) for batch in batches])

    def _errors(self, sets: Array) -> Array:
        engine = self.machine.engine
        replays = engine.replays(self.recordings, self.tracks, sets, REPLAY_STEP_S, WINDOW_S)
        parts = [
            np.where(weight > 0, error[:, kept] * weight, 0.0).reshape(len(sets), -1)
            for error, kept, weight in zip(replays, self._kept, self._weights, strict=True)
        ]
        return _finite(np.concatenate(parts, axis=1) / self.scale)

    @cached_property
    def _weights(self) -> list[Array]:
        """One over the deviation that the noise gives each error; 0 where nothing was sampled."""
        values = self._model.flat(self.believed)
        tracks = track_all(self.machine, self.runs, values, self.noise, floor_window_s=WINDOW_S)
        weights = []
        for run, track, kept in zip(self.runs, tracks, self._kept, strict=True):
            deviation = np.sqrt(track.replay_variance.reshape(run.outputs.shape))[kept]
            weights.append(np.where(np.isnan(run.outputs[kept]), 0.0, 1.0 / deviation))
        return weights


class Accelerations(Data):
    """Mean accelerations over `SPAN_ROWS` rows: derived minus modelled, in their own deviation.

    Each span shares half its rows with the next. Those of `SHAFTS_AND_BODY` take the places of the
    first outputs; the others are 0.
    """

    def __init__(
        self, machine: Machine, runs: Sequence[Run], noise: Noise, refit: Hypothesis
    ) -> None:
        self._refit = refit.flat(machine.believed)
        super().__init__(machine, runs, noise, refit)

    def kept_rows(self, run: Run) -> npt.NDArray[np.bool_]:
        """Rows that end a span."""
        row = np.arange(len(run.t_s))
        return super().kept_rows(run) & (row >= SPAN_ROWS) & (row % (SPAN_ROWS // 2) == 0)

    def residuals(self, sets: Array) -> Array:
        """Return what is left of the accelerations (sets, m) by flat parameter sets."""
        found = np.zeros((len(sets), len(self._derived), self.machine.engine.outputs))
        for k, values in enumerate(sets):
            left = (self._derived - self._modelled(values)) / self._deviation
            found[k, :, : len(SHAFTS_AND_BODY)] = left
        return _finite(found.reshape(len(sets), -1) / self.scale)

    @cached_property
    def _rows(self) -> tuple[Array, Array, Array, npt.NDArray[np.int64]]:
        """Time, filtered state and command of all rows of all runs, and where spans end."""
        states = [
            track.state.reshape(len(run.t_s), -1)
            for run, track in zip(self.runs, self.tracks, strict=True)
        ]
        return (
            np.concatenate([run.t_s for run in self.runs]),
            np.concatenate(states)[:, : self.machine.engine.states],
            np.concatenate([run.command for run in self.runs]),
            np.flatnonzero(np.concatenate([self.kept_rows(run) for run in self.runs])),
        )

    @cached_property
    def _derived(self) -> Array:
        _, states, _, _ = self._rows
        return self._mean_rate(states[:, SHAFTS_AND_BODY])

    def _modelled(self, values: Array) -> Array:
        t_s, states, command, _ = self._rows
        middle = np.ascontiguousarray((states[1:] + states[:-1]) / 2)
        rates = self.machine.engine.derivatives(values, middle, command[:-1].copy())
        steps = rates[:, SHAFTS_AND_BODY] * np.diff(t_s)[:, None]
        return self._mean_rate(np.cumsum(np.vstack([np.zeros_like(steps[:1]), steps]), axis=0))

    def _mean_rate(self, integral: Array) -> Array:
        t_s, _, _, end = self._rows
        change = integral[end] - integral[end - SPAN_ROWS]
        return change / (t_s[end] - t_s[end - SPAN_ROWS])[:, None]

    @cached_property
    def _deviation(self) -> Array:
        return np.std(self._derived - self._modelled(self._refit), axis=0)


def _finite(residuals: Array) -> Array:
    """Return the residuals of models that diverged as far off."""
    return np.clip(np.nan_to_num(residuals, nan=DIVERGED), -DIVERGED, DIVERGED)


def _candidates(data: Data) -> list[Candidate]:
    return data.machine.candidates_for(data.runs)


def _sizes(machine: Machine, one: Screened, amounts: Sequence[float]) -> Array:
    """Sizes of an effect with `amounts` of its typical ones, its shape as it was screened."""
    sizes = one.start.copy()
    for amount, index in zip(amounts, one.candidate.amplitudes, strict=True):
        p = one.candidate.parameters[index]
        absent = machine.believed[p.places[0]]
        if np.isfinite(absent):  # else the size that it was screened with
            sign = machine.sign_of(one.candidate.effect, p.label)
            sizes[index] = absent + amount * p.scale * sign
    parameters = one.candidate.parameters
    return np.clip(sizes, [p.low for p in parameters], [p.high for p in parameters])


def _with_screened(data: Data, model: Hypothesis, one: Screened) -> Hypothesis:
    """Return the model with one more effect, as large as the screen has it."""
    amounts = one.start[list(one.candidate.amplitudes)]
    return model.with_effect(one.candidate, _sizes(data.machine, one, amounts))


def _lowest_criterion(data: OpenLoop, refit: Hypothesis) -> Answer:
    current, candidates = fit(data, refit, ITERATIONS), _candidates(data)
    while len(current.hypothesis.effects) < MOST_EFFECTS:
        screened = screen(data, current, candidates)[:NEIGHBOURS]
        starts = [_with_screened(data, current.hypothesis, one) for one in screened[:REFITS]]
        quick = min(fit_more(data, current, starts, ITERATIONS), key=lambda one: one.objective)
        best = fit(data, quick.hypothesis, ITERATIONS)
        count = _independent(data, current.residual)
        if _criterion(best, count) >= _criterion(current, count):
            break
        taken = best.hypothesis.effects[-1].name
        candidates = [one.candidate for one in screened if one.candidate.name != taken]
        current = best
    return Answer(_named(current.hypothesis.effects), current.hypothesis.flat(data.believed))


def _criterion(fitted: Fit, count: float) -> float:
    left = float(fitted.residual @ fitted.residual)
    return count * np.log(left) + len(fitted.hypothesis.x) * np.log(count)


def _independent(data: Data, residual: Array) -> float:
    """How many independent errors are worth as much as these; 0 is not sampled."""
    rows = residual.reshape(-1, data.machine.engine.outputs)
    pairs = np.stack([rows[1:], rows[:-1]])[:, (rows[1:] != 0) & (rows[:-1] != 0)]
    correlation = 2 * np.sum(pairs[0] * pairs[1]) / np.sum(pairs**2)
    return np.count_nonzero(rows) * (1 - correlation) / (1 + correlation)


class Library:
    """The terms of SINDy and ridge, free of the keys: columns (m, terms) of unit deviation.

    `owner` is the number of the effect in `effects` that a term belongs to.
    """

    def __init__(self, data: Data, base: Fit) -> None:
        self.effects = screen(data, base, [c for c in _candidates(data) if _linear(data, c)])
        points, owner = [], []
        for number, one in enumerate(self.effects):
            for unit in np.eye(len(one.candidate.amplitudes)):
                sizes = _sizes(data.machine, one, unit)
                points.append(base.hypothesis.with_effect(one.candidate, sizes).flat(data.believed))
                owner.append(number)
        secants = (data.residuals(np.stack(points)) - base.residual).T
        free = free_of_fitted(base, secants)
        deviation = np.sqrt(np.mean(free**2, axis=0))
        shows = deviation > 0
        self.owner = np.array(owner)[shows]
        self.columns = free[:, shows] / deviation[shows]

    def strongest(self, gains: Array, least: float) -> list[Screened]:
        """Return the effects whose terms together gain more than `least`, strongest first."""
        sums = np.bincount(self.owner, gains, len(self.effects))
        order = [k for k in np.argsort(-sums) if sums[k] > least]
        return [self.effects[k] for k in order[:MOST_EFFECTS]]


def _linear(data: Data, candidate: Candidate) -> bool:
    places = [candidate.parameters[i].places[0] for i in candidate.amplitudes]
    return bool(np.isfinite(data.believed[places]).all())


def _named(effects: Iterable[Candidate]) -> tuple[Pair, ...]:
    """Names in the order of `gap find`: a friction curve comes last."""
    ordered = sorted(effects, key=lambda effect: effect.effect == CURVE)
    return tuple((effect.effect, effect.wheel) for effect in ordered)


def _sparse(data: Accelerations, innovations: Data, refit: Hypothesis) -> Answer:
    from pysindy import SSR, STLSQ

    def models(gram: Array, right: Array) -> list[Array]:
        squares, axes = np.linalg.eigh(gram)  # terms and target with these products
        root = np.sqrt(np.maximum(squares, 1e-9 * squares[-1]))
        terms, target = root[:, None] * axes.T, (axes.T @ right / root)[:, None]
        size = RIDGE * len(data.blocks)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sparsity parameter is too big")  # names nothing
            found = [STLSQ(threshold=t, alpha=size).fit(terms, target).coef_ for t in THRESHOLDS]
        stepwise = SSR(alpha=size, max_iter=len(gram)).fit(terms, target)
        found += stepwise.history_[-MOST_TERMS:]  # one term less each
        return [np.ravel(weights) for weights in found]

    base = fit(data, refit, iterations=0)
    library = Library(data, base)
    gains = _cross_validated(data, base, library, models)
    return _refitted(innovations, refit, library.strongest(gains, 0.0))


def _ridge(data: Data, refit: Hypothesis) -> Answer:
    def models(gram: Array, right: Array) -> list[Array]:
        sizes = LAMBDAS * len(data.blocks)
        return [np.linalg.solve(gram + size * np.eye(len(gram)), right) for size in sizes]

    base = fit(data, refit)
    library = Library(data, base)
    gains = _cross_validated(data, base, library, models)
    return _refitted(data, refit, library.strongest(gains, NAMED_SHARE * np.sum(gains)))


def _cross_validated(
    data: Data, base: Fit, library: Library, models: Callable[[Array, Array], list[Array]]
) -> Array:
    """Return what each term gains in the model that predicts runs left out.

    `models` gives weights of several models from the products of the terms with each other and
    with the target. Of those within one standard error of the best the one of the smallest weights
    is taken, or none where none is surely better than nothing.
    """
    columns, targets = data.per_run(library.columns), data.per_run(-base.residual)
    grams = np.stack([c.T @ c for c in columns])
    rights = np.stack([c.T @ t for c, t in zip(columns, targets, strict=True)])
    gram, right = grams.sum(axis=0), rights.sum(axis=0)
    changes = np.array(  # of the square error (run, model)
        [
            [w @ own @ w - 2 * w @ seen for w in models(gram - own, right - seen)]
            for own, seen in zip(grams, rights, strict=True)
        ]
    )
    means = changes.mean(axis=0)
    best = int(np.argmin(means))
    enough = means[best] + changes[:, best].std(ddof=1) / np.sqrt(len(grams))
    if enough >= 0:
        return np.zeros(len(right))
    good = [w for w, mean in zip(models(gram, right), means, strict=True) if mean <= enough]
    smallest = min(good, key=lambda w: np.sum(np.abs(w)))
    return smallest * (2 * right - gram @ smallest)


def _refitted(data: Data, refit: Hypothesis, effects: Sequence[Screened]) -> Answer:
    """Return the model of the named effects, fitted to the innovations with all keys."""
    model = refit
    for one in effects:
        model = _with_screened(data, model, one)
    values = fit(data, model, ITERATIONS).hypothesis.flat(data.believed)
    return Answer(_named([one.candidate for one in effects]), values)


def replay_errors(
    machine: Machine, runs: Sequence[Run], noise: Noise, sets: Sequence[Array]
) -> Array:
    """Return the error of one-second replays of each of two or more models.

    In noise floors of the first model; at most `DIVERGED`, and so much for one that diverges.
    """
    replays = replay_all(machine, runs, noise, [*sets, sets[0]])  # the last one gives the floor
    table = gap_table(replays)
    errors = np.sqrt(np.mean((table.rmse / table.floor) ** 2, axis=1))
    for one in replays:
        sampled = ~np.isnan(one.run.outputs) & one.counted[:, None]
        errors[np.isnan(one.errors[:, sampled]).any(axis=1)] = DIVERGED
    return np.minimum(errors, DIVERGED)[:-1]
