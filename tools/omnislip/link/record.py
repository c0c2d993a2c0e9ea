"""Telemetry to a log, every frame accounted for.

Each frame carries the time of its tick and running sums of the duties, so a row's duty is the exact
mean up to the next row that came, however many were lost between; a lost frame is a row that is not
there. Sequence numbers count to 256 and time tells how often they went round.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from omnislip.errors import InputError, RobotError
from omnislip.link import protocol
from omnislip.link.session import Session
from omnislip.log_file import Log

RECORD_STREAM = 0
WHEELS = range(1, 5)
SIGNALS = (
    "time_ms",
    *(f"duty_sum_{wheel}_q15" for wheel in WHEELS),
    *(f"counts_{wheel}" for wheel in WHEELS),
    "supply_mv",
    *(f"current_{wheel}_ma" for wheel in WHEELS),
)
# Of the line; the rest is for answers, events and the status.
SHARE_OF_LINE = 0.9

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Account:
    """Where the frames of a recording went: received + missing = sent or skipped by the robot."""

    received: int
    missing: int
    skipped_by_robot: int
    gaps: list[tuple[float, int]] = field(default_factory=list)
    """Time of the row before the gap in s, and how many rows are missing."""

    @property
    def lost_on_line(self) -> int:
        """Frames that left the robot and did not arrive."""
        return self.missing - self.skipped_by_robot


def period_of(rate_hz: int) -> int:
    """Return the period in ms of a rate. InputError when the line cannot carry it."""
    layout = protocol.StreamLayout([protocol.SIGNALS[name] for name in SIGNALS])
    most_hz = int(SHARE_OF_LINE * protocol.BYTES_PER_SECOND / layout.frame_bytes)
    if rate_hz < 1 or 1000 % rate_hz or rate_hz > most_hz:
        possible = [rate for rate in range(1, most_hz + 1) if 1000 % rate == 0]
        raise InputError(
            f"rate {rate_hz} Hz: must divide 1000 and fit the line, as {possible[-3:]} do"
        )
    return 1000 // rate_hz


class Recorder:
    """Records from `start` to `finish`; listen to the session in between."""

    def __init__(self, session: Session, rate_hz: int) -> None:
        self._session = session
        self._period_ms = period_of(rate_hz)
        self._sequences: list[int] = []
        self._rows: list[list[int]] = []
        self._doubtful: tuple[int, list[int]] | None = None
        self._skipped_before = 0

    @property
    def rows(self) -> int:
        """Frames received so far."""
        return len(self._rows)

    def start(self) -> None:
        """Have the robot send; its status is watched as well."""
        self._skipped_before = self._session.watch_status().counters["samples_lost"]
        self._session.open_stream(RECORD_STREAM, self._period_ms, SIGNALS, self._take)

    def finish(self, name: str) -> tuple[Log, Account]:
        """End the stream; return the log and what became of the frames."""
        self._session.close_stream(RECORD_STREAM)
        skipped = self._session.fresh_status().counters["samples_lost"] - self._skipped_before
        if len(self._rows) < 3:
            raise RobotError(f"only {len(self._rows)} frames came: not enough for a log")
        log, gaps = make_log(name, np.array(self._sequences), np.array(self._rows), self._period_ms)
        missing = sum(count for _, count in gaps)
        return log, Account(len(self._rows), missing, min(skipped % 65536, missing), gaps)

    def _take(self, sequence: int, raw: dict[str, int]) -> None:
        row = [raw[name] for name in SIGNALS]
        if self._rows and not self._follows(self._sequences[-1], self._rows[-1], sequence, row):
            # Damage that the CRC has missed, or a robot that has started anew: the next one tells.
            if self._doubtful is not None and self._follows(*self._doubtful, sequence, row):
                raise RobotError("the robot has started anew: the recording ends here")
            self._doubtful = (sequence, row)
            return
        self._doubtful = None
        self._sequences.append(sequence)
        self._rows.append(row)

    def _follows(
        self, before: int, row_before: list[int], after: int, row_after: list[int]
    ) -> bool:
        """Whether time has gone on as the sequence says; a frame may wait for up to a period."""
        passed_ms = (row_after[0] - row_before[0] + 2**31) % 2**32 - 2**31
        steps = (after - before) % 256
        steps += 256 * round((passed_ms / self._period_ms - steps) / 256)
        return passed_ms > 0 and abs(passed_ms - steps * self._period_ms) <= self._period_ms


def make_log(
    name: str, sequences: Integers, rows: Integers, period_ms: int
) -> tuple[Log, list[tuple[float, int]]]:
    """Return log and gaps of frames: `sequences` (n,), `rows` (n, 14) raw in the order of SIGNALS.

    The last frame only ends the interval of the row before it.
    """
    columns = dict(zip(SIGNALS, rows.T, strict=True))
    time_ms = _unwrapped(columns["time_ms"], 32)
    t_s = time_ms / 1000
    logged: dict[str, npt.NDArray[np.float64]] = {}
    for wheel in WHEELS:
        sums = np.diff(_unwrapped(columns[f"duty_sum_{wheel}_q15"], 32))
        logged[f"wheel/{wheel}/duty"] = sums / np.diff(time_ms) / 2**15
        logged[f"wheel/{wheel}/encoder_counts"] = columns[f"counts_{wheel}"][:-1].astype(float)
    logged["supply/voltage_v"] = columns["supply_mv"][:-1] / 1000
    currents_ma = np.stack([columns[f"current_{wheel}_ma"][:-1] for wheel in WHEELS])
    if currents_ma.any():  # else the robot has no current sensors
        for wheel in WHEELS:
            logged[f"wheel/{wheel}/current_a"] = currents_ma[wheel - 1] / 1000
    return Log(name, t_s[:-1], logged), list(_gaps(t_s, sequences, period_ms))


def _unwrapped(raw: Integers, bits: int) -> Integers:
    """Return a counter of `bits` bits as differences from its first value, without the wraps."""
    half = 2 ** (bits - 1)
    steps = (np.diff(raw) + half) % 2**bits - half
    return np.concatenate([[0], np.cumsum(steps)])


def _gaps(
    t_s: npt.NDArray[np.float64], sequences: Integers, period_ms: int
) -> Iterator[tuple[float, int]]:
    """Yield time and number of missing rows.

    Of the numbers that the sequence allows, the one nearest to the time that has passed.
    """
    by_time = np.diff(t_s) * 1000 / period_ms
    modulo = np.diff(sequences) % 256
    steps = modulo + 256 * np.round((by_time - modulo) / 256)
    for row in np.flatnonzero(steps != 1):
        yield float(t_s[row]), int(steps[row]) - 1
