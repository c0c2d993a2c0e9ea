"""Limits of detection: the smallest size of each effect that these logs would have shown.

A robot with an effect of size a, fitted without it: the believed keys move by -w a and take what
they can. What is left is a gain of

    g(a) = |r(a, x - w a) - r(0, x)|^2 + |pull of the priors on what moved|^2

over the inflation, which has to stand out from chance. Close to none g rises with a^2, so that one
size gives the limit, if it is near the limit itself: many effects bend (a step of viscous friction
is a step of the back-EMF, but no tangent tells that of a large one), so it is found twice, from
a size worth looking for and from the limit that this one gives. Both times the keys are moved by
the derivative and what that leaves is regressed on it again (a Gauss-Newton step of the fit), so
that bent in the same way counts as explained.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from omnislip.gap.inference import VISIBLE_GAIN, Data, Fit, Hypothesis, absorbed, inflation_of
from omnislip.gap.judge import shortest_lag
from omnislip.gap.machine import Candidate
from omnislip.gap.screen import Screened, neutral_sizes, possible_amounts, reach_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Probe:
    """A size to try: `reach` from none, or one of those of what is infinite when absent."""

    candidate: Candidate
    amplitude: int
    sizes: Array
    """Of the effect when absent, with its shape; of what is infinite when absent as it is tried."""

    reach: float
    """0 where the size is one to try."""

    most: float
    """Bound of the size, over the reach."""

    def beside(self, model: Hypothesis, steps: float) -> Hypothesis:
        """Return the model with the effect at `steps` of its reach from none."""
        sizes = self.sizes.copy()
        sizes[self.amplitude] += steps * self.reach
        return model.with_effect(self.candidate, sizes)


def detection_limits(
    data: Data, fitted: Fit, screened: Sequence[Screened]
) -> dict[str, dict[str, float]]:
    """Return by candidate and parameter of its file the smallest size that would have been seen.

    `screened`: candidates with the shapes (period, place) that promised most on `fitted`. Of a size
    that is infinite when absent it is the largest of its starts that would have been, if there is
    one. Absent means size 0.
    """
    probes = [probe for one in screened for probe in _probes(data, fitted.hypothesis, one)]
    most = np.array([probe.most for probe in probes])
    near = np.minimum(_seen_from(data, fitted, probes, np.ones(len(probes)), within=True), most)
    near[[not probe.reach for probe in probes]] = 1.0  # those are as large as they are
    found = _seen_from(data, fitted, probes, near, within=False)
    limits: dict[str, dict[str, float]] = {one.candidate.name: {} for one in screened}
    for probe, steps in zip(probes, found, strict=True):
        own, label = limits[probe.candidate.name], probe.candidate.parameters[probe.amplitude].label
        name = data.machine.file_parameter(label)
        if probe.reach:
            shortest = shortest_lag(data, probe.candidate.effect)
            own[name] = max(float(steps * abs(probe.reach)), shortest)
        elif steps <= 1.0:
            own[name] = max(own.get(name, 0.0), float(probe.sizes[probe.amplitude]))
    return limits


def _probes(data: Data, model: Hypothesis, screened: Screened) -> list[_Probe]:
    candidate, found = screened.candidate, []
    shape = {
        k: screened.start[k]
        for k in range(len(candidate.parameters))
        if k not in candidate.amplitudes
    }
    none = neutral_sizes(data, model, candidate, shape)
    low, high = possible_amounts(data, model, candidate)
    for k, amplitude in enumerate(candidate.amplitudes):
        if np.isfinite(none[amplitude]):
            reach = reach_of(candidate, data.machine, amplitude)
            most = high[k] if high[k] > 0 else -low[k]
            found.append(_Probe(candidate, amplitude, none, reach, most))
            continue
        for start in candidate.starts:
            sizes = neutral_sizes(data, model, candidate, start)
            found.append(_Probe(candidate, amplitude, sizes, 0.0, 1.0))
    return found


def _seen_from(
    data: Data, fitted: Fit, probes: Sequence[_Probe], tried: Array, within: bool
) -> Array:
    """Return the sizes (probes,) whose gain stands out from chance, from that of sizes `tried`.

    `within`: sizes are as small as leaves the keys within their bounds, not the keys held there.
    """
    model, keys = fitted.hypothesis, len(fitted.hypothesis.base)
    scale = np.array([p.scale for p in model.parameters])
    below, above = (np.maximum(room, 0.0) for room in (-model.room()[0], model.room()[1]))

    def changed(sizes: Array, moves: Array) -> Array:
        """(probes, m)."""
        points = [
            probe.beside(replace(model, x=model.x + move * scale), size).flat(data.believed)
            for probe, size, move in zip(probes, sizes, moves, strict=True)
        ]
        return data.residuals(np.stack(points)) - fitted.residual

    none = np.zeros((len(probes), len(scale)))
    moves = -absorbed(fitted, changed(tried, none).T)[1].T
    room = np.where(moves > 0, above, below)
    shares = np.divide(room, np.abs(moves), where=moves != 0, out=np.full_like(room, np.inf))
    bound = tried * np.min(shares, axis=1, initial=np.inf)
    if within:
        part = np.minimum(1.0, bound / tried)
        tried, moves, shares = tried * part, moves * part[:, None], shares / part[:, None]
    held = shares < 1.0 - 1e-9
    moves = np.clip(moves, -below, above)
    visible = max(VISIBLE_GAIN, data.feigned_gain)
    found = np.empty(len(probes))
    for k, change in enumerate(changed(tried, moves)):
        left, more = absorbed(fitted, change[:, None], np.flatnonzero(held[k]))
        pull = (more[:, 0] - moves[k])[:keys]
        gain = max(float(left[:, 0] @ left[:, 0] + pull @ pull), 1e-12)
        rest = fitted.residual - left[:, 0] * (left[:, 0] @ fitted.residual) / gain
        least = visible * inflation_of(data, left, rest, np.array([[gain]]))
        found[k] = tried[k] * np.sqrt(least / gain)
        if held[k].any() and gain > least:
            # `tried` would be the limit if keys were free; from their bound on the gain is more.
            free = least * (bound[k] / tried[k]) ** 2
            share = (least - free) / max(gain - free, least - free)
            found[k] = bound[k] + np.sqrt(share) * (tried[k] - bound[k])
    return found
