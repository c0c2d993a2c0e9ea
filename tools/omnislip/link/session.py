"""A conversation with one robot: requests with answers, events, streams; nothing lost unseen.

A request is sent again, the same frame, until its answer comes; the robot carries it out once. All
that goes wrong on the way is counted in `Counters`. One thread; the robot is heard only inside
`request`, `offer` and `listen`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from omnislip.errors import RobotError
from omnislip.link import protocol
from omnislip.link.port import Line
from omnislip.link.protocol import Answer, Foreign, FrameReader, Happening, Sample, StreamLayout

# An answer leaves within a tick, behind at most a full send buffer (11 ms); adapters add up to
# 16 ms each way.
ANSWER_TIMEOUT_S = 0.1
TRIES = 10
EVENTS_KEPT = 100

STATUS_STREAM = protocol.STREAMS - 1
STATUS_PERIOD_MS = 100
STATUS_SIGNALS = (
    "time_ms",
    "state",
    "fault",
    "fault_wheel",
    "store_status",
    "bad_frames",
    "bytes_lost",
    "answers_lost",
    "samples_lost",
)
_COUNTERS_END = ("_frames", "_lost")

Take = Callable[[int, dict[str, int]], None]


@dataclass
class Counters:
    """How the line has fared, seen from here."""

    requests: int = 0
    repeated: int = 0
    unanswered: int = 0
    stray_answers: int = 0
    samples: int = 0
    samples_missing: int = 0
    events: int = 0
    events_missing: int = 0
    implausible: int = 0
    """Valid frames that say what no robot says: damage that the CRC has missed."""


@dataclass
class _Stream:
    layout: StreamLayout
    take: Take
    last_sequence: int | None = None


@dataclass(frozen=True)
class Identity:
    """What a robot says of itself."""

    reset_cause: str
    store_status: str
    time_ms: int


@dataclass(frozen=True)
class Status:
    """The state of the robot and its counters; names as in ``supervisor.def``."""

    time_ms: int
    state: str
    fault: str
    fault_wheel: int
    store_status: str
    counters: dict[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        wheel = f" of wheel {self.fault_wheel}" if self.fault_wheel else ""
        fault = "" if self.fault == "NONE" else f", last fault {self.fault}{wheel}"
        return f"{self.state}{fault}"


class Refused(RobotError):  # noqa: N818 - what happened, not a defect
    """The robot has understood a request and says no."""

    def __init__(self, request: str, result: str) -> None:
        self.result = result
        super().__init__(f"the robot does not carry out '{request}': {_result_text(result)}")


def _result_text(result: str) -> str:
    return protocol.RESULTS[result].removeprefix("refused: ")


class Session:
    """A conversation over a line. `connect` first."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.counters = Counters()
        self.events: deque[Happening] = deque(maxlen=EVENTS_KEPT)
        self.status: Status | None = None
        self._reader = FrameReader()
        self._sequence = 0
        self._streams: dict[int, _Stream] = {}
        self._event_sequence: int | None = None
        self._answers: list[Answer] = []

    @property
    def broken_frames(self) -> int:
        """Frames that came damaged."""
        return self._reader.broken

    # ---- requests ----

    def connect(self) -> Identity:
        """Find the robot and check that it speaks as we do. RobotError when it does not."""
        try:
            found = self.request("identify")
        except NoAnswer:
            raise RobotError(
                "no answer: is the robot on, this its port, and no other program there?"
            ) from None
        self._check_table("parameters", found["parameter_table"], protocol.parameter_table())
        self._check_table("signals", found["signal_table"], protocol.signal_table())
        for stream in range(protocol.STREAMS):
            self.close_stream(stream)
        reset_cause = protocol.name_of("reset_cause", found["reset_cause"])
        store_status = protocol.name_of("store_status", found["store_status"])
        return Identity(reset_cause or "?", store_status or "?", found["time_ms"])

    def request(self, name: str, more: bytes = b"", **values: int) -> dict[str, int]:
        """Have a request carried out once; return the fields of its answer.

        Refused when the robot says no, RobotError when it does not answer.
        """
        frame = self._next_frame(name, values, more)
        for attempt in range(TRIES):
            self.counters.repeated += attempt > 0
            answer = self._ask(name, frame, ANSWER_TIMEOUT_S)
            if answer is not None:
                return self._fields(name, answer)
        self.counters.unanswered += 1
        raise NoAnswer(name)

    def offer(self, name: str, timeout_s: float, **values: int) -> bool:
        """Send a request once; return whether an answer came in time. Refused as in `request`."""
        answer = self._ask(name, self._next_frame(name, values, b""), timeout_s)
        if answer is None:
            self.counters.unanswered += 1
            return False
        self._fields(name, answer)
        return True

    def listen(self, duration_s: float) -> None:
        """Take what the robot tells for `duration_s`."""
        until_s = self.line.time_s() + duration_s
        while (left_s := until_s - self.line.time_s()) > 0:
            self._hear(left_s)

    # ---- streams ----

    def open_stream(
        self, stream: int, period_ms: int, signals: Sequence[str], take: Take
    ) -> StreamLayout:
        """Have `signals` sent every `period_ms`; `take` gets sequence and raw values of each."""
        found = [protocol.find_signal(name) for name in signals]
        layout = StreamLayout(found)
        # Ended first, so that nothing of an older stream is taken for a sample of this one.
        self.close_stream(stream)
        self._streams[stream] = _Stream(layout, take)
        ids = bytes(signal.id for signal in found)
        self.request("stream", ids, stream=stream, period_ms=period_ms)
        return layout

    def close_stream(self, stream: int) -> None:
        """End a stream."""
        self._streams.pop(stream, None)
        self.request("stream", stream=stream, period_ms=0)

    def close(self) -> None:
        """End all streams of ours."""
        for stream in list(self._streams):
            self.close_stream(stream)

    def watch_status(self) -> Status:
        """Keep `status` up to date from now on; return the present one."""
        self.status = None
        self.open_stream(STATUS_STREAM, STATUS_PERIOD_MS, STATUS_SIGNALS, self._take_status)
        return self.fresh_status()

    def fresh_status(self) -> Status:
        """Return a status that is younger than this call."""
        self.status = None
        until_s = self.line.time_s() + TRIES * STATUS_PERIOD_MS / 1000
        while self.status is None and (left_s := until_s - self.line.time_s()) > 0:
            self._hear(left_s)
        if self.status is None:
            raise RobotError("the robot does not send its status")
        return self.status

    # ---- inside ----

    def _next_frame(self, name: str, values: dict[str, int], more: bytes) -> bytes:
        self._sequence = (self._sequence + 1) % 256
        self.counters.requests += 1
        # The delimiter in front ends what noise may have begun.
        return protocol.DELIMITER + protocol.encode_request(name, self._sequence, values, more)

    def _ask(self, name: str, frame: bytes, timeout_s: float) -> Answer | None:
        code = protocol.REQUESTS[name].code
        self.line.write(frame)
        until_s = self.line.time_s() + timeout_s
        while (left_s := until_s - self.line.time_s()) > 0:
            self._hear(left_s)
            heard, self._answers = self._answers, []
            for answer in heard:
                if (answer.sequence, answer.code) == (self._sequence, code):
                    return answer
                self.counters.stray_answers += 1
        return None

    def _fields(self, name: str, answer: Answer) -> dict[str, int]:
        result = protocol.RESULT_NAMES[answer.result]
        if result != "ACCEPTED":
            raise Refused(name, result)
        return protocol.REQUESTS[name].answer.unpack(answer.fields)

    def _hear(self, timeout_s: float) -> None:
        for content in self._reader.feed(self.line.read(timeout_s)):
            message = protocol.decode_message(content)
            if isinstance(message, Answer):
                self._answers.append(message)
            elif isinstance(message, Happening):
                self._take_event(message)
            elif isinstance(message, Sample):
                self._take_sample(message)
            elif isinstance(message, Foreign):
                raise RobotError(
                    f"the robot speaks protocol version {message.version}, this program "
                    f"{protocol.VERSION}: bring both to the same release"
                )
            else:
                self.counters.implausible += 1

    def _take_event(self, event: Happening) -> None:
        self.counters.events += 1
        if self._event_sequence is not None and event.name != "boot":
            self.counters.events_missing += (event.sequence - self._event_sequence - 1) % 256
        self._event_sequence = event.sequence
        self.events.append(event)

    def _take_sample(self, sample: Sample) -> None:
        stream = self._streams.get(sample.stream)
        if stream is None:
            return
        values = stream.layout.unpack(sample.signals)
        if values is None:
            self.counters.implausible += 1
            return
        self.counters.samples += 1
        if stream.last_sequence is not None:
            missing = (sample.sequence - stream.last_sequence - 1) % 256
            self.counters.samples_missing += missing
        stream.last_sequence = sample.sequence
        stream.take(sample.sequence, values)

    def _take_status(self, _sequence: int, raw: dict[str, int]) -> None:
        state, fault, store_status = (
            protocol.name_of(name, raw[name]) for name in ("state", "fault", "store_status")
        )
        if state is None or fault is None or store_status is None:
            self.counters.implausible += 1
            return
        counters = {name: raw[name] for name in STATUS_SIGNALS if name.endswith(_COUNTERS_END)}
        wheel = raw["fault_wheel"]
        self.status = Status(raw["time_ms"], state, fault, wheel, store_status, counters)

    def _check_table(self, what: str, theirs: int, ours: int) -> None:
        if theirs != ours:
            raise RobotError(
                f"the robot's table of {what} is another one ({theirs:04X}h, here {ours:04X}h): "
                "bring robot and program to the same release"
            )


class NoAnswer(RobotError):  # noqa: N818 - what happened, not a defect
    """No answer to a request, however often it was sent."""

    def __init__(self, request: str) -> None:
        super().__init__(f"no answer to '{request}', sent {TRIES} times")
