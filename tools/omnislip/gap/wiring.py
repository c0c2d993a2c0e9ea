"""Wiring: swapped encoders and reversed signs, found before anything else and mended in the logs.

Every wiring is tried: 24 permutations of the encoders, of the motors, or of both (wheels that are
counted in another order), 16 sets of the encoders' signs, and for each of them the best of 16 sets
of the motors' signs. Each is judged by kinematics over windows of 0.2 s, in metres of rim. Mended,
the ways r of the wheels have to be those of a body, and each has to follow its duty:

    sum |Q (r - J b)| + sum |r - p|      J, b of eq. (3); p: way of the unloaded motor, with a lag

b is the motion that gyro and camera show. What they do not show may be anything: Q projects it out.
The likeliest wirings are then judged by the filter of the believed model. A wrong wiring is so far
from any physics that the right one shows at once; nothing is fitted and no noise is tuned.

What logs cannot tell is left open (all encoders reversed or all motors, without gyro and camera).
Of wirings that explain the logs alike the one with the fewest mistakes is the answer. Everything
reversed at once, motors and encoders, shows against a camera only: to a gyro alone it looks like a
gyro that is upside down.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from omnislip.gap.machine import Machine, count_rad
from omnislip.gap.noise import first_guess, track_all
from omnislip.gap.recordings import make_run, rim_m_per_rad, unwrap_counts, wheel_jacobian
from omnislip.log_file import POSE_COLUMNS, Log
from omnislip.model_file import ENCODERS, MOTORS, WHEEL_COLUMNS, WIRING, Effect

Array = npt.NDArray[np.float64]

LOOK_AT_S = 12.0
GRID_S, WINDOW_S = 0.01, 0.2
LIKELIEST, AS_NEAR = 12, 1e-3
"""How many wirings the filter judges, and share of what is off by which one mistake more must be
nearer to come first."""
BETTER = 0.9
"""A motor that is driven forwards must be off by less than this share of backwards."""
CLEARLY_BETTER = 0.25
"""A right wiring leaves less than this share of the mean square innovation of a wrong one."""
ALIKE = 1.1
"""Factor between mean square innovations below which two wirings cannot be told apart."""
IMPLAUSIBLE = 30.0
"""Mean square of the whitened innovations below which the wiring is not in question."""
MOST_SIGNS = 4
"""Reversed signs, of eight, where no camera shows which half of them it is."""


def mend(log: Log, effects: Sequence[Effect]) -> Log:
    """Return the log as it would be with the right wiring."""
    columns = dict(log.columns)
    for effect in effects:
        if effect.name == "wheel_permutation":
            for signal in WHEEL_COLUMNS[effect.parameters.get("of", ENCODERS)]:
                shown = [columns.pop(f"wheel/{wheel}/{signal}", None) for wheel in range(1, 5)]
                for column, wheel in zip(shown, effect.parameters["wheels"], strict=True):
                    if column is not None:
                        columns[f"wheel/{wheel}/{signal}"] = column
        elif effect.name in WIRING:
            turned = WHEEL_COLUMNS[ENCODERS if effect.name == "encoder_sign" else MOTORS]
            for name in (f"wheel/{effect.wheel}/{signal}" for signal in turned):
                if name in columns:
                    columns[name] = -columns[name]
    return replace(log, columns=columns)


def find_wirings(machine: Machine, logs: Sequence[Log]) -> list[list[Effect]]:
    """Return the mistakes of each wiring that explains the logs, the fewest mistakes first.

    The first is the answer, no mistake for logs that are wired right; the others have no more
    mistakes, and these logs cannot tell them from it.
    """
    if machine.kind != "robot":
        return [[]]
    looked_at = _beginning(logs)
    as_logged = _misfit(machine, looked_at)
    if as_logged <= IMPLAUSIBLE:
        return [[]]
    tried = [
        (_misfit(machine, [mend(log, mistakes) for log in looked_at]), mistakes)
        for mistakes in _likeliest(machine, looked_at)
    ]
    least = min((misfit for misfit, _ in tried), default=np.inf)
    if not least < CLEARLY_BETTER * as_logged:
        return [[]]
    most = ALIKE * max(least, 1.0)
    tried.sort(key=lambda one: one[0])
    alike = [mistakes for misfit, mistakes in tried if misfit < most]
    fewest = min(len(mistakes) for mistakes in alike)
    return sorted((mistakes for mistakes in alike if len(mistakes) == fewest), key=_what_moved)


def _what_moved(mistakes: Sequence[Effect]) -> int:
    """Order of wirings that explain the logs alike: encoders are the likeliest to change places."""
    moved = [effect.parameters.get("of", ENCODERS) for effect in mistakes]
    return max(map(list(WHEEL_COLUMNS).index, moved), default=0)


def _likeliest(machine: Machine, logs: Sequence[Log]) -> list[list[Effect]]:
    """Mistakes of the wirings that kinematics prefer to the logs' own, likeliest first.

    Of those that are as near, the fewest mistakes: mirrored wheels with signs are like signs alone.
    """
    tried = _tried(machine, logs)
    as_logged = next(off for off, mistakes in tried if not mistakes)
    better = [one for one in tried if one[0] < as_logged]
    better.sort(key=lambda one: one[0] * (1.0 + AS_NEAR * len(one[1])))
    return [mistakes for _, mistakes in better[:LIKELIEST]]


def _tried(machine: Machine, logs: Sequence[Log]) -> list[tuple[float, list[Effect]]]:
    """Metres off and mistakes of every order of columns and every sign of the encoders.

    Motors turn as logged or as suits it.
    """
    ways = [_ways(machine, log) for log in logs]
    rim, driven, shown = (np.concatenate(columns) for columns in zip(*ways, strict=True))
    known = ~np.isnan(shown)
    jacobian = wheel_jacobian(machine)
    body = np.nan_to_num(shown) @ jacobian.T
    cases = []
    for pattern in np.unique(known, axis=0):
        free = jacobian[:, ~pattern]
        cases.append(((known == pattern).all(axis=1), np.eye(4) - free @ np.linalg.pinv(free)))
    most_signs = 8 if known.all(axis=1).any() else MOST_SIGNS
    tried = []
    in_place = tuple(range(4))
    orders = [(in_place, ENCODERS)]
    orders += [(o, of) for o in permutations(in_place) if o != in_place for of in WHEEL_COLUMNS]
    for order, of in orders:
        encoders = np.argsort(order if of != MOTORS else in_place)
        motors = np.argsort(order if of != ENCODERS else in_place)
        for encoder_signs in product((1, -1), repeat=4):
            way, duty_way = rim[:, encoders] * encoder_signs, driven[:, motors]
            forward, backward = (np.abs(way - sign * duty_way).sum(axis=0) for sign in (1, -1))
            off_body = sum(np.abs((way[rows] - body[rows]) @ q).sum() for rows, q in cases)
            suiting = backward < BETTER * forward
            for turned in np.unique([np.zeros(4, dtype=bool), suiting], axis=0):
                mistakes = _mistakes(order, of, np.array(encoder_signs) < 0, turned)
                if sum(mistake.name != "wheel_permutation" for mistake in mistakes) <= most_signs:
                    off = float(off_body + np.where(turned, backward, forward).sum())
                    tried.append((off, mistakes))
    return tried


def _mistakes(
    order: tuple[int, ...],
    of: str,
    reversed_encoders: npt.NDArray[np.bool_],
    reversed_motors: npt.NDArray[np.bool_],
) -> list[Effect]:
    """Column k of the encoders, motors or both is of wheel order[k] (from 0)."""
    mistakes = []
    if order != tuple(range(4)):
        columns = {"wheels": [wheel + 1 for wheel in order]}
        columns |= {} if of == ENCODERS else {"of": of}
        mistakes.append(Effect("wheel_permutation", columns))
    mistakes += [Effect("encoder_sign", {}, int(k) + 1) for k in np.flatnonzero(reversed_encoders)]
    return mistakes + [
        Effect("motor_sign", {}, int(k) + 1) for k in np.flatnonzero(reversed_motors)
    ]


def _ways(machine: Machine, log: Log) -> tuple[Array, Array, Array]:
    """Ways in windows: of rims by encoders and by duties (windows, 4) in m, of the body (.., 3).

    The body's are in its own frame (m, m, rad), NaN where no sensor shows them.
    """
    values = machine.model.values
    edges_s = np.arange(log.t_s[0], log.t_s[-1], WINDOW_S)
    counts = [unwrap_counts(log.columns[f"wheel/{w}/encoder_counts"]) for w in range(1, 5)]
    per_rad_m = rim_m_per_rad(machine)
    rim = np.diff([np.interp(edges_s, log.t_s, count) for count in counts], axis=1).T
    rim *= count_rad(machine) * per_rad_m
    grid_s = np.arange(log.t_s[0], log.t_s[-1], GRID_S)
    rows = np.searchsorted(log.t_s, grid_s, side="right") - 1
    duty = np.stack([log.columns[f"wheel/{w}/duty"][rows] for w in range(1, 5)], axis=1)
    inertia = values["motor.inertia_kg_m2"] + values["robot.mass_kg"] * per_rad_m**2 / 4
    k_v_s = values["motor.back_emf_constant_v_s_rad"]
    lag_s = inertia * values["motor.resistance_ohm"] / values["motor.torque_constant_nm_a"] / k_v_s
    fade = np.exp(-GRID_S / lag_s)
    speed_m_s = values["motor.supply_v"] / k_v_s * per_rad_m
    driven_m = np.cumsum(lfilter([1 - fade], [1, -fade], duty, axis=0), axis=0) * speed_m_s * GRID_S
    driven = np.diff([np.interp(edges_s, grid_s, way) for way in driven_m.T], axis=1).T
    return rim, driven, _body_ways(log, edges_s)


def _body_ways(log: Log, edges_s: Array) -> Array:
    """Way of the body in its own frame between the times (times - 1, 3): m, m, rad."""
    ways = np.full((len(edges_s) - 1, 3), np.nan)
    rate = log.columns.get("gyro/z_rad_s", np.array([np.nan]))
    if np.count_nonzero(~np.isnan(rate)) > 1:
        rows = np.flatnonzero(~np.isnan(rate))
        turned = np.concatenate([[0.0], np.cumsum(rate[rows[1:]] * np.diff(log.t_s[rows]))])
        ways[:, 2] = np.diff(np.interp(edges_s, log.t_s[rows], turned))
    pose = [log.columns.get(name, np.full(len(log.t_s), np.nan)) for name in POSE_COLUMNS]
    rows = np.flatnonzero(~np.isnan(pose).any(axis=0))
    if rows.size < 2:
        return ways
    t_s, (x, y, heading) = log.t_s[rows], np.array(pose)[:, rows]
    place = np.interp(edges_s, t_s, x) + 1j * np.interp(edges_s, t_s, y)
    heading = np.interp(edges_s, t_s, np.unwrap(heading))
    along = np.diff(place) * np.exp(-0.5j * (heading[1:] + heading[:-1]))
    near = np.abs(edges_s[:, None] - t_s).min(axis=1) < WINDOW_S
    seen = near[1:] & near[:-1]
    ways[seen] = np.stack([along.real, along.imag, np.diff(heading)], axis=1)[seen]
    return ways


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
