"""When electric sensors are read: before the command of their row begins, or after.

A controller at the rate of the log reads its sensors, then acts: what flows at the time of a row is
by the command of the row before. Taken for what flows by the row's own it passes for noise, for an
inductance or soft shafts, and for commands that move within rows. Without a model: a current is a
sum of its wheel's command and speed, the voltage falls by squares of commands and their products
with speeds. By the commands of the row before the residuals are smaller, and those of this row and
of two rows before add next to nothing. They do where a controller is faster than the log or out of
step with it, and where an inductance makes currents late; and in a log of violent driving, where
the mean of two rows does not tell the speed between them: so most of the logs decide.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from omnislip.gap.machine import Machine
from omnislip.gap.recordings import unwrap_counts
from omnislip.log_file import Log

Array = npt.NDArray[np.float64]

SURELY_BEFORE, NOTHING_MORE = 100.0, 0.25
"""Log-likelihood of all logs, and the share of a log's that other rows may add in most of them. Of
31 sets of logs that are read so, 26 reach 100 (all 16 with currents 10,000) and add 0.001 to 0.24
of it, two reach it and add more (0.29; 1.8 with a bridge of limited slew), three voltages do not;
of 47 others 8 reach it and add 0.39 (a current that an inductance makes late) to 32. Of 40 more
sets with currents the 8 that are read so add 0.01 to 0.1 in the median of their logs (0.33 in sum,
driven violently), the 32 others 4.4 or more."""
LEAST_READINGS, TINY = 50, 1e-12


def reading_machine(machine: Machine, logs: Sequence[Log]) -> Machine:
    """Return a robot that reads before it acts if its readings say so, else the machine."""
    if not machine.electric:
        return machine
    told = np.array([_likelier_before(log) for log in logs])
    better, more = told[np.any(told != 0.0, axis=1)].T
    if np.sum(better) > SURELY_BEFORE and np.mean(more < NOTHING_MORE * better) > 0.5:
        return machine.of(machine.model, holds_commands=True, reads_before=True)
    return machine


def _likelier_before(log: Log) -> tuple[float, float]:
    """By how much (log) the electric readings of a log are likelier by the commands before.

    And by how much more by those of this row, the one before and the one before that.
    """
    wheels = range(1, 5)
    command = np.stack([log.columns[f"wheel/{wheel}/duty"] for wheel in wheels], axis=1)
    counts = [unwrap_counts(log.columns[f"wheel/{wheel}/encoder_counts"]) for wheel in wheels]
    speed = np.stack([np.gradient(one, log.t_s) for one in counts], axis=1)
    readings = {f"wheel/{wheel}/current_a": wheel - 1 for wheel in wheels}
    better = more = 0.0
    for channel in (*readings, "supply/voltage_v"):
        shown = log.columns.get(channel)
        if shown is None:
            continue

        def terms(earlier: int, wheel: int | None = readings.get(channel)) -> Array:
            own = np.roll(command, earlier, axis=0)
            if wheel is None:
                return np.hstack([own**2, own * speed])
            return np.stack([own[:, wheel], speed[:, wheel]], axis=1)

        known = np.isfinite(np.column_stack([shown, command, speed])).all(axis=1)
        known[:2] = False
        if np.count_nonzero(known) < LEAST_READINGS or np.ptp(shown[known]) == 0:
            continue
        now, before, earlier = (terms(rows) for rows in range(3))
        squares = [
            _square_left(shown[known], columns[known])
            for columns in (now, before, np.hstack([now, before, earlier]))
        ]
        rows = 0.5 * np.count_nonzero(known)
        better += rows * np.log(squares[0] / squares[1])
        more += rows * np.log(squares[1] / squares[2])
    return better, more


def _square_left(values: Array, columns: Array) -> float:
    """Return what least squares leave of values (rows,) beside columns (rows, n) and a constant."""
    sizes = np.maximum(np.abs(columns).max(axis=0), TINY)
    scaled = np.column_stack([columns / sizes, np.ones(len(values))])
    left = values - scaled @ np.linalg.lstsq(scaled, values, rcond=None)[0]
    return max(float(left @ left), TINY)
