"""The force error of an axis: what drives it against what the model says its motion needs.

The inverse dynamic model of robotics: F = M q'' + friction(q', q). Position is low-passed forward
and backward (Butterworth of order 4, so no lag), derived by central differences; force and model
then go through the same decimation filter, which takes ripple out of both. With the cut at 100 Hz
(five times the bandwidth of the position loop) and 100 samples a second left this is the method of
Gautier and Janot, and gives their figures on EMPS. Reported is |F - model| / |F|, eq. (11) of
Janot, Gautier, Brunot, "Data set and reference models of EMPS", 2019.
"""

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, decimate, filtfilt

from omnislip.gap.machine import Machine
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

CUT_HZ = 100.0
DECIMATED_HZ = 100.0
EDGE_S = 0.05
"""Left out at both ends, where a filter knows one side only."""


def relative_force_error(machine: Machine, run: Run, values: Array, late_s: float = 0.0) -> float:
    """Return |F - model| / |F| of one parameter set over a run of an axis (0.04 is 4 %).

    The motion is taken to answer the command `late_s` ago.
    """
    step_s = run.row_s
    grid = np.arange(run.t_s[0], run.t_s[-1], step_s)
    command = np.interp(grid - late_s, run.t_s, run.command[:, 0])
    position = low_pass(np.interp(grid, run.t_s, run.outputs[:, 0]), step_s)
    speed = np.gradient(position, step_s)
    states = np.stack([speed, position], axis=1)
    at_rest = np.stack([np.zeros_like(speed), position], axis=1)
    # Forces per inertia; the inertia cancels in the ratio.
    moved = machine.engine.derivatives(values, states, command[:, None])[:, 0]
    driven = machine.engine.derivatives(values, at_rest, command[:, None])[:, 0]
    idle = machine.engine.derivatives(values, at_rest, np.zeros((len(grid), 1)))[:, 0]
    edge = round(EDGE_S / step_s)
    error, force = (
        _decimate(signal[edge:-edge], step_s)
        for signal in (np.gradient(speed, step_s) - moved, driven - idle)
    )
    return float(np.linalg.norm(error) / np.linalg.norm(force))


def low_pass(values: Array, step_s: float) -> Array:
    """Return `values` without what is above CUT_HZ, not delayed."""
    share = min(2 * CUT_HZ * step_s, 0.8)
    return filtfilt(*butter(4, share), values)


def _decimate(values: Array, step_s: float) -> Array:
    factor = round(1.0 / (DECIMATED_HZ * step_s))
    return decimate(values, factor, ftype="iir", zero_phase=True) if factor > 1 else values
