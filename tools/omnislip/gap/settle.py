"""Noise and model fitted in turn, and what a model is worth by the noise that fits it.

Noise that was tuned for keys which are off gives others that are off in another way; noise that was
tuned without an effect covers it. So they are fitted in turn until they agree.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from omnislip.gap.inference import Data, Fit, Hypothesis, fit, prior_penalty
from omnislip.gap.machine import CURVE, Machine
from omnislip.gap.noise import Noise, track_all, tune_noise
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]
"""Is told what is being tried, for people who wait."""

MOST_TUNINGS, FEW_TUNINGS, LEAST_TUNINGS, SETTLED = 6, 3, 2, 1.0
"""Times that noise and model are fitted in turn, at most; the same to look for pushes or one step
ahead, for what passes settles again; times after which a fit that moves further than the one before
ends it (a rough Q has many minima); and change of Q by what the fit moved that ends it."""
LOST_PER_ROW = 1.0
"""Fall of the log-likelihood by which the filter of a fitted model has lost the robot. A fit takes
its gains from the model that it begins from: where friction falls with slip and only a camera shows
the slip, one that made Q less by 237 lost the robot for 0.8 s by its own gains, and 98,000 of the
log-likelihood of some 6,000 rows. Noise was tuned to that, and neither of two effects was found."""


def believed_hypothesis(machine: Machine) -> Hypothesis:
    """Return the believed model: no effect, every key that may move at its value."""
    base = tuple(machine.base_parameters())
    return Hypothesis(base, (), np.array([machine.believed[p.places[0]] for p in base]))


def first_model(
    machine: Machine,
    runs: Sequence[Run],
    like: tuple[Noise, Hypothesis] | None = None,
    tunings: int = FEW_TUNINGS,
) -> tuple[Noise, Hypothesis]:
    """Return noise and fit of a model that is near enough to see pushes beside it.

    The believed keys within their tolerance and a free friction curve: what is off in most robots.
    `like`: those of nearly the same runs, to start from.
    """
    noise, start = like or (None, believed_hypothesis(machine))
    if like is None:
        for candidate in [c for c in machine.candidates() if c.effect == CURVE]:
            start = start.with_effect(candidate, [0.1])
    data, fitted = settle(machine, runs, start, noise, tunings)
    return data.noise, fitted.hypothesis


def settle(
    machine: Machine,
    runs: Sequence[Run],
    start: Hypothesis,
    noise: Noise | None = None,
    tunings: int = MOST_TUNINGS,
    last: Array | None = None,
) -> tuple[Data, Fit]:
    """Tune the noise at `start` and fit, until predictor and model agree or for so many times.

    Back to the last fit whose own filter follows the robot where one loses it. `last`: as `fit` has
    it.
    """
    hypothesis, before = start, np.inf
    scale = np.array([p.scale for p in start.parameters])
    lost = LOST_PER_ROW * sum(len(run.t_s) for run in runs)
    most, pair, followed = -np.inf, None, None
    for tuning in range(tunings):
        values = hypothesis.flat(machine.believed)
        noise = tune_noise(machine, runs, values, noise, paths=1)
        data = Data(machine, runs, noise, hypothesis)
        likelihood = sum(track.log_likelihood for track in data.tracks)
        if likelihood > most - lost:
            followed = pair
        elif followed:
            return followed
        most = max(most, likelihood)
        fitted = fit(data, hypothesis, last=last)
        pair, last = (data, fitted), fitted.jacobian
        moved = (fitted.hypothesis.x - hypothesis.x) / scale
        hypothesis = fitted.hypothesis
        way = float(moved @ fitted.information @ moved)
        if way < SETTLED or (way > before and tuning >= LEAST_TUNINGS):
            break
        before = way
    return data, fitted


def likelihood_judges(data: Data) -> bool:
    """Whether no controller answers within rows (answers.py)."""
    return not data.answers or data.machine.holds_commands


def log_posterior(data: Data, fitted: Fit) -> float:
    """Return the logarithm of the likelihood by the data's noise and of the base parameters'.

    What the rows hide is integrated out. Minus infinity where the filter loses the robot.
    """
    hypothesis = fitted.hypothesis
    values = hypothesis.flat(data.believed)
    tracks = track_all(data.machine, data.runs, values, data.noise)
    prior = prior_penalty(hypothesis, data.believed, hypothesis.x)
    likelihood = sum(t.log_likelihood for t in tracks) + data.hidden_likelihood(values)
    return float(np.nan_to_num(likelihood - 0.5 * np.sum(prior**2), nan=-np.inf))
