"""Wiring: swapped encoders and reversed signs, found before anything else and mended in the logs.

Every single mistake (23 permutations of the encoders, 4 encoder signs, 4 motor signs) is tried: the
logs are mended for it and the filter of the believed model follows them. A wrong wiring is so far
from any physics that the right one shows at once; nothing is fitted and no noise is tuned. After
a find the search starts again on the mended logs, so that several mistakes are found one by one.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from omnislip.gap.machine import Machine
from omnislip.gap.noise import first_guess, track_all
from omnislip.gap.recordings import make_run
from omnislip.log_file import Log
from omnislip.model_file import WIRING, Effect

LOOK_AT_S = 12.0
MOST_MISTAKES = 3
BETTER = 0.8
"""One of several mistakes mended must leave less than this share of the mean square innovation,"""
CLEARLY_BETTER = 0.25
"""and all of them less than this one."""
IMPLAUSIBLE = 30.0
"""Mean square of the whitened innovations below which the wiring is not in question."""


def mend(log: Log, effects: Sequence[Effect]) -> Log:
    """Return the log as it would be with the right wiring."""
    columns = dict(log.columns)
    for effect in effects:
        if effect.name == "wheel_permutation":
            names = [f"wheel/{wheel}/encoder_counts" for wheel in range(1, 5)]
            shown = [columns[name] for name in names]
            for column, wheel in zip(shown, effect.parameters["wheels"], strict=True):
                columns[f"wheel/{wheel}/encoder_counts"] = column
        elif effect.name in WIRING:
            # The driver measures the current in the sense of its duty.
            turned = ("encoder_counts",) if effect.name == "encoder_sign" else ("duty", "current_a")
            for name in (f"wheel/{effect.wheel}/{signal}" for signal in turned):
                if name in columns:
                    columns[name] = -columns[name]
    return replace(log, columns=columns)


def find_wiring(machine: Machine, logs: Sequence[Log]) -> list[Effect]:
    """Return the wiring mistakes of the logs, most telling first."""
    if machine.kind != "robot":
        return []
    looked_at = _beginning(logs)
    found: list[Effect] = []
    first = now = _misfit(machine, looked_at)
    while now > IMPLAUSIBLE and len(found) < MOST_MISTAKES:
        candidates = _mistakes()
        misfits = [_misfit(machine, [mend(log, [one]) for log in looked_at]) for one in candidates]
        best = int(np.argmin(misfits))
        if misfits[best] > BETTER * now:
            break
        now = misfits[best]
        found.append(candidates[best])
        looked_at = [mend(log, [candidates[best]]) for log in looked_at]
    return found if now < CLEARLY_BETTER * first else []


def _mistakes() -> list[Effect]:
    orders = [list(order) for order in permutations((1, 2, 3, 4))][1:]
    mistakes = [Effect("wheel_permutation", {"wheels": order}) for order in orders]
    for name in ("encoder_sign", "motor_sign"):
        mistakes += [Effect(name, {}, wheel) for wheel in range(1, 5)]
    return mistakes


def _beginning(logs: Sequence[Log]) -> list[Log]:
    """The first seconds of the logs, in which a wheel moves at all."""
    chosen, total_s = [], 0.0
    for log in logs:
        rows = log.t_s - log.t_s[0] < LOOK_AT_S - total_s
        if rows.sum() < 2:
            break
        columns = {name: values[rows] for name, values in log.columns.items()}
        chosen.append(Log(log.name, log.t_s[rows], columns))
        total_s += float(log.t_s[rows][-1] - log.t_s[0])
    return chosen


def _misfit(machine: Machine, logs: Sequence[Log]) -> float:
    """Mean square of the whitened innovations under the noise one would guess."""
    runs = [make_run(machine, log) for log in logs]
    noise = first_guess(machine, runs)
    squares, count = 0.0, 0
    for run, track in zip(runs, track_all(machine, runs, machine.believed, noise), strict=True):
        outputs = machine.engine.outputs
        innovation = np.nan_to_num(track.innovation.reshape(-1, outputs))
        whitening = track.whitening.reshape(-1, outputs, outputs)
        squares += float(np.sum(np.einsum("rij,rj->ri", whitening, innovation) ** 2))
        count += int(np.count_nonzero(~np.isnan(run.outputs)))
    return squares / max(count, 1) if np.isfinite(squares) else float("inf")
