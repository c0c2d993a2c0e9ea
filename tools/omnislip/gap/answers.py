"""What a controller answers: how much of a model's change could be foreseen.

In closed loop the command of a row goes along with what disturbed the wheels in it and just before.
A change of the model moves the residuals by c, and c holds those answers: it is correlated with the
residuals r beside the true model, too. Least squares then draw keys (where a robot is driven in few
directions by one or two of their tolerances) and feign lags and friction, unless the model of the
disturbances is exact (Forssell and Ljung, Closed-loop identification revisited, Automatica 1999).

Instruments mend that. Let c~ be the same change by commands without their news: less what is left
of them by a prediction from what was logged CHANCE_S before (linear, from commands and innovations
of all wheels in PAST rows; clipped, for a step of the programme answers nothing). Disturbances have
faded by then, so c~'r is chance. What is lost was answers: in a log of ordinary driving at three
times the usual noise c~ holds 99 % of what is known of friction, a quarter of what seemed known of
the motors' inertia and a hundredth of a delay. With J~ such derivatives by the parameters of a
model, P the projection on their span, and u = (1 - P) c~, two-stage least squares take for the
change

    c^ = P c + u u'c / u'u

what of c goes with something that could be foreseen. Residuals are r + c^ with r those of the
model, so that squares, secants and tests are those of any other fit. Several new parameters at
once share one u, and may be exchanged for each other until the model is settled anew. (Soederstrom
and Stoica, Instrumental variable methods for system identification, 1983; Wooldridge, Econometric
analysis of cross section and panel data, chapter 5.)

Nor is chance how a command moves within a row (rows.py). A controller that is as slow as the rows
holds it, and one that is faster moves it as the means tell: `likelier_held` asks motion and
currents which, `likelier_with_rows` whether what is held jumps within rows or where they begin.
Where commands are taken as held, how far they rise all the same is taken out of r: w, what is
changed by commands that rise at the rate of their means, times how far they do, by the same
instruments -w~'r / w~'w, between 0 and 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import orth

from omnislip import _core
from omnislip.gap.machine import CURRENT, Machine
from omnislip.gap.noise import Noise, corrections, require_finite, track_all
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

FOLLOWS = 0.002
"""Share of what is new in a command that innovations must explain for a closed loop, in rows where
the command hardly changes: elsewhere a model that is a little off gives as much in open loop."""
FEIGNED_GAIN = 40.0
"""Gain up to which answers feign effects in spite of the instruments: twice what anything promised
in logs of closed loops in which nothing was missing (20). In open loop no answer is seen beside a
model that is right."""
UNDRIVEN = 2.5
"""Times as much where a direction is not driven: there the robot moves by nothing but disturbances
and the answers to them, and instruments hold little of what is known."""
DRIVEN = 0.02
"""Of the speed of the strongest direction: 0.002 where a robot goes to and fro, 0.05 and more where
it turns, too."""
BEYOND_CHANCE = 4.0
"""Times what chance explains of so many rows (F of SHORT_PAST and very many: once in 1000)."""
ROUNDING = 1e-6
"""Of a command's size: less is nothing new (a timer has steps of 1e-3, a log six digits)."""
CALM = 1.0
"""Changes of a command in such rows, in their deviations."""
MOVES = 2 / 3
"""Share of rows in which a command moves, below which its controller is slower than the log: then
it answers in those rows only."""
SHORT_PAST, PAST = 6, 12
"""Rows from which a command is predicted, by those of one wheel and of all."""
ROW_S = 0.005
"""Shorter rows of a past are taken together."""
CLIP = 3.0
UNUSUAL, ROBUST_ROUNDS = 4.0, 4
"""Standard deviations beyond which news are no answer but the programme's; rounds to find them."""
CHANCE_S = 0.03
"""Disturbances fade at 40 per second or faster (noise.py)."""
ROW_BY_ROW = 0.05
"""Share of what is new in a command that innovations explain from which on it is set row by row by
what was measured at its begin: 0.12 to 0.72 of such controllers, up to 0.02 of those at 1 kHz,
whose rows mostly answer what happens within them, in most sets of logs; in a few 0.22."""
MOST_OF_A_RUN = 2.0
"""How much of what half of the runs reach, or more, one of them may tell how commands move.
All are of one controller; in one wheels broke loose a moment later than beside a model, and it told
1,400 the other way."""
CREEP_RAD_S = 2.0
"""Speed of a shaft below which the sign of its friction is smooth (sim/robot_plant.h)."""
NOTHING = 1e-12
"""Share of the square of a change that rounding leaves of what lies in the span."""


@dataclass(frozen=True)
class News:
    """What is new in the commands (rows, 4) of each run, nothing in open loop; share of what is new
    from row to row that innovations explain."""

    new: list[Array]
    share: float
    driven: bool
    """Whether the robot is driven in all directions."""
    along: tuple[bool, bool, bool] = (True, True, True)
    """Whether it is driven along its x, its y, and round."""

    @property
    def answers(self) -> bool:
        """Whether commands answer what disturbs the wheels: whether a loop is closed."""
        return bool(self.new)

    @property
    def feigned_gain(self) -> float:
        """Gain beyond chance that a controller's answers feign where nothing is missing."""
        if not self.answers:
            return 0.0
        return FEIGNED_GAIN if self.driven else UNDRIVEN * FEIGNED_GAIN


class Foreseen:
    """What of the change of residuals could be foreseen: the residuals of a model and others near.

    From the residuals (m,) of the model by the logged commands and by those without news, the
    derivatives (m, n) of the latter by its parameters, and what both commands change of innovations
    (m,) where they rise within rows.
    """

    def __init__(
        self,
        found: Array,
        newsless: Array,
        derivatives: Array,
        rise: Array,
        newsless_rise: Array,
    ) -> None:
        self._found, self._newsless = found, newsless
        sizes = np.linalg.norm(derivatives, axis=0)
        self._axes = orth(derivatives[:, sizes > 0] / sizes[sizes > 0])
        free = newsless_rise - self._axes @ (self._axes.T @ newsless_rise)
        common = float(free @ rise)
        self.rise_share = float(np.clip(-free @ found / common, 0.0, 1.0)) if common else 0.0
        """How far commands taken as held rise within rows: 1 at the rate of their means."""
        self._residual = found + self.rise_share * rise

    def residuals(self, found: Array, newsless: Array) -> Array:
        """Return r + c^ of models (models, m) from their residuals by both commands, used up."""
        found -= self._found
        newsless -= self._newsless
        residuals = self.part(found, newsless)
        residuals += self._residual
        return residuals

    def part(self, change: Array, newsless: Array) -> Array:
        """Return c^ (n, m) of changes c by the logged commands and c~, used up, without news."""
        along, within = newsless @ self._axes, change @ self._axes
        whole = np.vecdot(newsless, newsless)
        square = whole - np.vecdot(along, along)  # of what of c~ is out of the span
        common = np.vecdot(newsless, change) - np.vecdot(along, within)
        share = (common / np.where(square > NOTHING * whole, square, np.inf))[:, None]
        part = (within - share * along) @ self._axes.T
        newsless *= share
        part += newsless
        return part


def lead_rows(run: Run) -> int:
    """Rows from one whose disturbances are chance back to the last that may tell what goes on then.

    A row's command goes on to the next row.
    """
    return max(2, round(CHANCE_S / run.row_s))


def foreseen(run: Run, track: _core.Track) -> Array:
    """States (rows, states) without what was corrected in the last `CHANCE_S`."""
    rows = len(run.t_s)
    corrected = corrections(track)
    transition = track.transition.reshape(rows, track.filter_states, -1)
    states = track.state.reshape(rows, -1) - corrected
    for _ in range(lead_rows(run)):
        corrected[1:] = np.einsum("kij,kj->ki", transition[:-1], corrected[:-1])
        corrected[0] = 0.0
        states -= corrected
    return states


def news_of(machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track]) -> News:
    """Return what is new in the commands; runs whose rows are as long are asked together.

    `tracks` keep their matrices. Nothing of machines other than robots. RunawayError for a model by
    which a robot would go on without bounds.
    """
    if machine.kind != "robot":
        return News([], 0.0, True)
    new: dict[int, Array] = {}
    most = 0.0
    for lead in {lead_rows(run) for run in runs}:
        own = [k for k, run in enumerate(runs) if lead_rows(run) == lead]
        logged = [(runs[k], tracks[k]) for k in own]
        share = _share_answered(logged)
        most = max(most, share)
        if share > FOLLOWS:
            new.update(zip(own, _new(logged), strict=True))
    found = [new.get(k, np.zeros_like(run.command)) for k, run in enumerate(runs)]
    return News(found if new else [], most, *_driven(machine, tracks))


def likelier_held(machine: Machine, runs: Sequence[Run], values: Array, noise: Noise) -> float:
    """Return by how much (log) the motion is likelier if a robot's commands are held within rows.

    `runs` are those of commands that move. Infinite where a controller seems to set them row by row
    and no currents show whether it does. (Likelihood of motion alone does not tell a
    controller's: the means of the next row, by which a command rises, answer what happened in this
    one. Currents show where a command is when a row begins: of loops at 1 kHz that have them some
    seemed to be set row by row, by shares of up to 0.14.)
    """
    if machine.kind != "robot":
        return -np.inf
    tracks = track_all(machine, runs, values, noise, keep_linear=True)
    moved = np.array([track.log_likelihood for track in tracks])
    blind = np.isfinite(moved).all() and not _show_currents(runs)
    if blind and news_of(machine, runs, tracks).share > ROW_BY_ROW:
        return np.inf
    return _likelier(moved, _likelihoods(machine, [r.held_in_rows() for r in runs], values, noise))


def likelier_with_rows(machine: Machine, runs: Sequence[Run], values: Array, noise: Noise) -> float:
    """Return by how much (log) the motion is likelier if held commands jump where rows begin.

    A controller that leads a step of its set point over a row gives all wheels a mean of what was
    before and after, as a jump within the row does. Of commands that are held either tells all, so
    what noise leaves open within rows has no say.
    """
    runs = [run for run in runs if (run.parted or run).jumped.size]
    noise = replace(noise, unresolved=0.0, unresolved_current=0.0)
    parted = _likelihoods(machine, [run.held_in_rows() for run in runs], values, noise)
    whole = _likelihoods(machine, [run.set_with_rows() for run in runs], values, noise)
    return _likelier(parted, whole)


def _show_currents(runs: Sequence[Run]) -> bool:
    return any(np.isfinite(run.outputs[:, CURRENT]).any() for run in runs)


def _likelihoods(machine: Machine, runs: Sequence[Run], values: Array, noise: Noise) -> Array:
    return np.array([track.log_likelihood for track in track_all(machine, runs, values, noise)])


def _likelier(one: Array, other: Array) -> float:
    """By how much the other of two log-likelihoods (runs,) is larger, no run telling it all."""
    if not np.isfinite(one).all():  # the filter lost the robot
        return np.inf if np.isfinite(other).all() else 0.0
    if not np.isfinite(other).all():
        return -np.inf
    likelier = other - one
    most = MOST_OF_A_RUN * np.median(np.abs(likelier)) if likelier.size else 0.0
    return float(np.sum(np.clip(likelier, -most, most)))


def _share_answered(logged: Sequence[tuple[Run, _core.Track]]) -> float:
    """Share of what is new in commands, beside what the wheel's last lead to, that goes with
    innovations.

    Where a command moves, but hardly. Innovations beside a wrong model tell how the robot moves,
    and where commands follow a programme that tells how they go on. So what they explain has to be
    more than the motion foreseen explains as well: an answer is one to what was not. And it has to
    show away from jumps, too: behind them such innovations tell the programme.
    """
    stride = _stride(logged[0][0])
    past = SHORT_PAST * stride
    commanded, told, now, motion, behind = [], [], [], [], []
    for run, track in logged:
        commands, _ = _past(run, track, past, 1, 1)
        _, innovations = _past(run, track, SHORT_PAST, stride, 1)
        commanded.append(commands.reshape(past, -1).T)
        told.append(innovations.reshape(SHORT_PAST, -1).T)
        now.append(run.logged_command[past:].ravel())
        states = foreseen(run, track)[run.log_rows][past:]
        with np.errstate(over="ignore"):
            squares = np.square(np.hstack([states, told[-1].reshape(len(states), -1)]))
        require_finite(run, squares)
        motion.append(_motion(states))
        behind.append(np.repeat(_behind_jumps(run, past)[past:], run.command.shape[1]))
    x, told, y, motion = (np.concatenate(each) for each in (commanded, told, now, motion))
    step = np.abs(y - x[:, 0])
    moves = step > ROUNDING * np.max(np.abs(y), initial=0.0)
    if not moves.any():
        return 0.0
    asked = moves if np.mean(moves) < MOVES else np.full(len(y), True)
    calm = asked & (step <= CALM * _spread(step[asked]))
    limit = CLIP * _spread(told[calm])
    told = np.clip(told, -limit, limit)
    share = min(
        _share_explained(known[rows], told[rows], y[rows])
        for rows in (calm, calm & ~np.concatenate(behind))
        for known in (x, np.hstack([x, motion]))
    )
    return share if share > BEYOND_CHANCE * SHORT_PAST / np.count_nonzero(calm) else 0.0


def _behind_jumps(run: Run, past: int) -> npt.NDArray[np.bool_]:
    """Rows of the log (rows,) in whose past, or in which, commands jump within a row."""
    jumped = np.isin(run.log_rows, run.jumped - 1)
    near = np.convolve(jumped, np.ones(past + 1))
    return near[: len(jumped)] > 0


def _new(logged: Sequence[tuple[Run, _core.Track]]) -> list[Array]:
    """News of the commands (rows, 4) of each run: what nobody could foresee `CHANCE_S` before.

    Prediction by robust least squares. News are clipped: a step of the programme is no answer.
    """
    lead, stride = lead_rows(logged[0][0]), _stride(logged[0][0])
    pasts = [_past(run, track, PAST, stride, lead) for run, track in logged]
    x = np.concatenate([np.hstack([*commands, *innovations]) for commands, innovations in pasts])
    x /= np.maximum(x.std(axis=0), 1e-12)
    first = PAST * stride + lead - 1
    y = np.concatenate([run.logged_command[first:] for run, _ in logged])
    usual = np.full(len(y), True)
    for _ in range(ROBUST_ROUNDS):
        left = y - x @ np.linalg.lstsq(x[usual], y[usual], rcond=None)[0]
        limit = UNUSUAL * np.median(np.abs(left), axis=0) / 0.6745
        usual = np.all(np.abs(left) <= limit, axis=1)
    new = np.clip(left, -limit, limit)
    found = [np.zeros_like(run.command) for run, _ in logged]
    parts = np.split(new, np.cumsum([commands.shape[1] for commands, _ in pasts])[:-1])
    for (run, _), own, part in zip(logged, found, parts, strict=True):
        own[run.log_rows[len(run.log_rows) - len(part) :]] = part
        own[run.jumped] = own[run.jumped - 1]
    return found


def _stride(run: Run) -> int:
    """Rows that make one of the past."""
    return max(1, round(ROW_S / run.row_s))


def _past(run: Run, track: _core.Track, past: int, stride: int, lead: int) -> tuple[Array, Array]:
    """Commands and innovations of all wheels (past, rows, 4), means of `stride` rows, latest first.

    Those of command k, from row past * stride + lead - 1 on, end with command k - lead and the
    innovations just after it. Rows are those of the log.
    """
    command = run.logged_command
    rows = max(len(command) - past * stride - lead + 1, 0)
    innovation = track.innovation.reshape(len(run.t_s), -1)[run.log_rows]
    innovation = np.nan_to_num(innovation[1:, :4])
    firsts = range((past - 1) * stride, -1, -stride)
    commands, innovations = (
        np.stack([signal[first : first + rows] for first in firsts])
        for signal in (_means(command, stride), _means(innovation, stride))
    )
    return commands, innovations


def _means(values: Array, stride: int) -> Array:
    """Means of values (rows, n) over the next `stride` rows each."""
    if len(values) < stride:
        return values[:0]
    return np.lib.stride_tricks.sliding_window_view(values, stride, axis=0).mean(axis=-1)


def _driven(
    machine: Machine, tracks: Sequence[_core.Track]
) -> tuple[bool, tuple[bool, bool, bool]]:
    """Whether the robot moves in every direction of (x, y, a wheel's way round), and in each."""
    speed = np.concatenate([t.state.reshape(-1, t.filter_states)[:, 8:11] for t in tracks])
    speed = speed * [1.0, 1.0, machine.model.values["robot.wheel_distance_m"]]
    squares = speed.T @ speed
    least, *_, most = np.linalg.eigvalsh(squares)
    along_x, along_y, around = (bool(own >= DRIVEN**2 * most) for own in np.diag(squares))
    return bool(least >= DRIVEN**2 * most), (along_x, along_y, around)


def _motion(states: Array) -> Array:
    """How the robot moves (rows * 4, 12): speeds and their signs, from each wheel's view."""
    speed, body = states[:, :4], states[:, 8:11]
    from_wheels = [
        np.hstack([np.roll(speed, -k, axis=1), np.tanh(np.roll(speed, -k, axis=1) / CREEP_RAD_S)])
        for k in range(4)
    ]
    seen = np.stack([np.hstack([one, body, np.ones((len(body), 1))]) for one in from_wheels], 1)
    return seen.reshape(-1, seen.shape[2])


def _share_explained(known: Array, told: Array, target: Array) -> float:
    """Share of what `known` leaves of the target (rows,) that `told` (rows, n) explains.

    0 where it leaves nothing but rounding, as of a command that is held.
    """
    known = known / np.maximum(np.sqrt(np.mean(known**2, axis=0)), 1e-12)
    rest, _ = _rest(known, np.hstack([told, target[:, None]]))
    left = rest.T @ rest
    told_left, slope = left[:-1, :-1], left[:-1, -1]
    if left[-1, -1] <= ROUNDING**2 * (target @ target):
        return 0.0
    return float(slope @ np.linalg.pinv(told_left, hermitian=True) @ slope / left[-1, -1])


def _rest(x: Array, y: Array) -> tuple[Array, Array]:
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    return y - x @ weights, weights


def _spread(values: Array) -> float:
    """Robust standard deviation around zero."""
    return float(np.median(np.abs(values))) / 0.6745
