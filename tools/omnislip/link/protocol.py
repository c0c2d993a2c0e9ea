"""Frames and messages of the serial protocol; ``firmware/link.h`` and ``frame.h`` specify it.

The tables of requests, events, signals and parameters are the firmware's own ``.def`` files, as
they were compiled into ``omnislip._core``: nothing is written twice.

    wire      COBS(content, CRC low byte, CRC high byte), 00
    CRC       CRC-16/CCITT-FALSE of the content
"""

import binascii
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from omnislip import _core
from omnislip.errors import InputError
from omnislip.files import nearest

_TABLES = _core.link_tables()
_FORMATS = {"u8": "B", "u16": "H", "u32": "I", "i16": "h", "i32": "i"}

VERSION: int = _TABLES["version"]
ANSWER: int = _TABLES["answer"]
EVENT: int = _TABLES["event"]
TELEMETRY: int = _TABLES["telemetry"]
STREAMS: int = _TABLES["streams"]
SIGNALS_PER_STREAM: int = _TABLES["signals_per_stream"]
CONTENT_MAX: int = _TABLES["content_max"]
BYTES_PER_SECOND = 11520
HEADER_BYTES = 3
FRAME_OVERHEAD = 4
DELIMITER = b"\0"

RESULTS: dict[str, str] = dict(_TABLES["results"])
RESULT_NAMES = list(RESULTS)
STORE_STATUSES: dict[str, str] = dict(_TABLES["store_statuses"])
STATES: dict[str, str] = dict(_TABLES["states"])
FAULTS: dict[str, str] = {name: text for name, _, text in _TABLES["faults"]}
LIMITS: list[str] = _TABLES["limits"]
MODES: list[str] = _TABLES["modes"]
RESET_CAUSES: list[str] = _TABLES["reset_causes"]
# What a number stands for, by the name of the field or signal.
NAMES_OF = {
    "state": list(STATES),
    "fault": list(FAULTS),
    "limit": LIMITS,
    "mode": MODES,
    "store_status": list(STORE_STATUSES),
    "reset_cause": RESET_CAUSES,
}


def name_of(field: str, value: int) -> str | None:
    """Return what a value of a field or signal stands for, None if it is a number."""
    names = NAMES_OF.get(field, [])
    return names[value] if 0 <= value < len(names) else None


class _Fields:
    """Fields of a message: "name type, name type", little-endian without padding."""

    def __init__(self, text: str) -> None:
        pairs = [field.split() for field in text.split(",") if field.strip()]
        self.names = [name for name, _ in pairs]
        self._format = struct.Struct("<" + "".join(_FORMATS[kind] for _, kind in pairs))
        self.size = self._format.size

    def pack(self, values: Mapping[str, int]) -> bytes:
        if set(values) != set(self.names):
            raise ValueError(f"fields are {self.names}, not {list(values)}")
        return self._format.pack(*(values[name] for name in self.names))

    def unpack(self, data: bytes) -> dict[str, int]:
        return dict(zip(self.names, self._format.unpack(data), strict=True))


@dataclass(frozen=True)
class Message:
    """A request or an event; `answer` has no fields for an event."""

    name: str
    code: int
    fields: _Fields
    answer: _Fields
    description: str


@dataclass(frozen=True)
class Signal:
    """A signal of telemetry; its value is raw / 2^q_bits in `unit`."""

    id: int
    name: str
    type: str
    unit: str
    q_bits: int
    description: str

    @property
    def size(self) -> int:
        """Bytes in a frame."""
        return struct.calcsize(_FORMATS[self.type])

    def value(self, raw: int) -> float:
        """Return the value in `unit`."""
        return raw / 2**self.q_bits

    def shown(self, raw: int) -> str:
        """Return the value as a reader wants it: a name where the number stands for one."""
        return name_of(self.name, raw) or f"{self.value(raw):.6g}"


@dataclass(frozen=True)
class Parameter:
    """A parameter of the firmware; its value is raw / 2^q_bits in `unit`, limits are raw."""

    id: int
    name: str
    unit: str
    q_bits: int
    minimum: int
    maximum: int
    default: int
    tunable: bool
    description: str

    def value(self, raw: int) -> float:
        """Return the value in `unit`."""
        return raw / 2**self.q_bits

    def raw(self, value: float) -> int:
        """Return the raw number nearest to `value`. InputError when it is out of the limits."""
        raw = round(value * 2**self.q_bits)
        if not self.minimum <= raw <= self.maximum:
            low, high = self.value(self.minimum), self.value(self.maximum)
            raise InputError(
                f"parameter {self.name}: must be {low:.6g} to {high:.6g} {self.unit}, not {value:g}"
            )
        return raw


REQUESTS = {
    name: Message(name, code, _Fields(fields), _Fields(answer), text)
    for name, code, fields, answer, text in _TABLES["requests"]
}
EVENTS = {
    code: Message(name, code, _Fields(fields), _Fields(""), text)
    for name, code, fields, text in _TABLES["events"]
}
SIGNALS = {row[0]: Signal(number, *row) for number, row in enumerate(_TABLES["signals"])}
PARAMETERS = {
    row[0]: Parameter(number, *row[:6], number >= _TABLES["first_tunable"], row[6])
    for number, row in enumerate(_TABLES["parameters"])
}


def find_parameter(name: str) -> Parameter:
    """Return a parameter by its name, with or without the Q format at its end."""
    for parameter in PARAMETERS.values():
        if name in (parameter.name, parameter.name.removesuffix(f"_q{parameter.q_bits}")):
            return parameter
    raise InputError(f"unknown parameter '{name}'{nearest(name, PARAMETERS)}")


def find_signal(name: str) -> Signal:
    """Return a signal by its name, with or without the Q format at its end."""
    for signal in SIGNALS.values():
        if name in (signal.name, signal.name.removesuffix(f"_q{signal.q_bits}")):
            return signal
    raise InputError(f"unknown signal '{name}'{nearest(name, SIGNALS)}")


def parameter_table() -> int:
    """Return the fingerprint of the parameter table, as ``firmware/parameters.h`` states it."""
    rows = b"".join(
        struct.pack("<BBHhhh", len(p.name), len(p.unit), p.q_bits, p.minimum, p.maximum, p.default)
        for p in PARAMETERS.values()
    )
    return crc(rows)


def signal_table() -> int:
    """Return the fingerprint of the signal table, as ``firmware/telemetry.h`` states it."""
    return crc(
        b"".join(bytes([len(s.name), len(s.unit), s.size, s.q_bits]) for s in SIGNALS.values())
    )


# ---- frames ----


def crc(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of `data`."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode_frame(content: bytes) -> bytes:
    """Return the bytes on the wire for a content, delimiter included."""
    data = content + struct.pack("<H", crc(content))
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\0")) + DELIMITER


def _unstuff(stuffed: bytes) -> bytes | None:
    """Return the data of a COBS frame without its delimiter, None if it is cut or damaged."""
    runs, at = [], 0
    while at < len(stuffed):
        distance = stuffed[at]
        if at + distance > len(stuffed):
            return None
        runs.append(stuffed[at + 1 : at + distance])
        at += distance
    return b"\0".join(runs)


def decode_frame(stuffed: bytes) -> bytes | None:
    """Return the content of a frame without its delimiter, None if it is not valid."""
    data = _unstuff(stuffed)
    if data is None or len(data) < HEADER_BYTES:
        return None
    content, their_crc = data[:-2], struct.unpack("<H", data[-2:])[0]
    return content if crc(content) == their_crc else None


class FrameReader:
    """Cuts what the line delivers into frames. `broken` counts frames that were not valid."""

    def __init__(self) -> None:
        self.broken = 0
        self._begun = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the contents of the frames that end in `data`."""
        *whole, self._begun = (self._begun + data).split(DELIMITER)
        # No frame is longer; what noise has begun need not be kept, only known to be broken.
        self._begun = self._begun[: CONTENT_MAX + FRAME_OVERHEAD]
        contents = [decode_frame(stuffed) for stuffed in whole if stuffed]
        self.broken += contents.count(None)
        return [content for content in contents if content is not None]


# ---- messages ----


@dataclass(frozen=True)
class Answer:
    """What the robot says to a request."""

    sequence: int
    code: int
    result: int
    fields: bytes


@dataclass(frozen=True)
class Happening:
    """An event that the robot tells of; values are raw, by the names in ``messages.def``."""

    sequence: int
    name: str
    values: dict[str, int]

    def __str__(self) -> str:
        told = {name: value for name, value in self.values.items() if name != "time_ms"}
        shown = ", ".join(f"{name} {name_of(name, value) or value}" for name, value in told.items())
        if self.name == "limit":
            shown = _limit_line(told["limit"], told["limit_wheel"])
        return f"{self.values['time_ms'] / 1000:.3f} s: {shown}"


def _limit_line(limit: int, wheel: int) -> str:
    by = LIMITS[limit].lower()
    if by == "none":
        return "not limited"
    return f"limited by: {by}, wheel {wheel}" if wheel else f"limited by: {by}"


@dataclass(frozen=True)
class Sample:
    """A frame of a stream; its signals are those the host has asked for."""

    stream: int
    sequence: int
    signals: bytes


@dataclass(frozen=True)
class Foreign:
    """A frame of another protocol version."""

    version: int


def encode_request(name: str, sequence: int, values: Mapping[str, int], more: bytes = b"") -> bytes:
    """Return the wire bytes of a request; `more` follows its fields."""
    request = REQUESTS[name]
    content = bytes([VERSION, request.code, sequence]) + request.fields.pack(values) + more
    return encode_frame(content)


def decode_message(content: bytes) -> Answer | Happening | Sample | Foreign | None:
    """Return what a content says, None if a robot does not say such a thing.

    Damage passes the CRC once in 2^16 times: nothing here is taken on trust.
    """
    if len(content) < HEADER_BYTES:
        return None
    version, kind, sequence = content[:HEADER_BYTES]
    rest = content[HEADER_BYTES:]
    if version != VERSION:
        return Foreign(version)
    if kind == ANSWER and len(rest) >= 2:
        return _answer(Answer(sequence, rest[0], rest[1], rest[2:]))
    if kind == EVENT and rest:
        return _happening(sequence, rest[0], rest[1:])
    if TELEMETRY <= kind < TELEMETRY + STREAMS:
        return Sample(kind - TELEMETRY, sequence, rest)
    return None


def _answer(answer: Answer) -> Answer | None:
    """Return the answer if there are such a request, such a result and such fields."""
    request = next((r for r in REQUESTS.values() if r.code == answer.code), None)
    if request is None or answer.result >= len(RESULT_NAMES):
        return None
    accepted = RESULT_NAMES[answer.result] == "ACCEPTED"
    return answer if len(answer.fields) == (request.answer.size if accepted else 0) else None


def _happening(sequence: int, code: int, fields: bytes) -> Happening | None:
    """Return the event if there are such an event and such fields."""
    event = EVENTS.get(code)
    if event is None or len(fields) != event.fields.size:
        return None
    values = event.fields.unpack(fields)
    known = all(name_of(name, value) for name, value in values.items() if name in NAMES_OF)
    return Happening(sequence, event.name, values) if known else None


class StreamLayout:
    """How the signals of a stream lie in its frames."""

    def __init__(self, signals: Sequence[Signal]) -> None:
        self.signals = list(signals)
        self._format = struct.Struct("<" + "".join(_FORMATS[s.type] for s in signals))
        self.frame_bytes = HEADER_BYTES + self._format.size + FRAME_OVERHEAD
        if len(signals) > SIGNALS_PER_STREAM or HEADER_BYTES + self._format.size > CONTENT_MAX:
            raise InputError(
                f"{len(signals)} signals of {self._format.size} bytes do not fit a frame of "
                f"{SIGNALS_PER_STREAM} signals and {CONTENT_MAX - HEADER_BYTES} bytes"
            )

    def unpack(self, data: bytes) -> dict[str, int] | None:
        """Return the raw values by name, None if the frame has another length."""
        if len(data) != self._format.size:
            return None
        names = [signal.name for signal in self.signals]
        return dict(zip(names, self._format.unpack(data), strict=True))
