"""The transcript of a conversation with the robot, encoded by the specification alone.

``link_conversation.txt`` holds requests and what the robot says, each as text and as the bytes on
the wire. Here the text is encoded with the tables of ``firmware/messages.def`` and
``firmware/telemetry.def`` and an own CRC and COBS; ``test_robot.c`` plays the bytes to the
firmware. Both must agree with every byte of the file.
"""

import binascii
import re
import struct
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[2] / "firmware"
CONVERSATION = Path(__file__).with_name("link_conversation.txt")
FORMATS = {"u8": "B", "u16": "H", "u32": "I", "i16": "h", "i32": "i"}
VERSION, ANSWER, EVENT, TELEMETRY = 1, 0x80, 0x81, 0x90

ROW = re.compile(r"^([A-Z_]+)\((.*?)\)$", re.MULTILINE | re.DOTALL)
CELL = re.compile(r'((?:"[^"]*"\s*)+|[^,"]+)(?:,|$)')


def rows(file: str, macro: str) -> list[list[str]]:
    """The rows of one macro of a table, cells without quotes."""
    text = re.sub(r"/\*.*?\*/|^#.*?$", "", (FIRMWARE / file).read_text(), flags=re.S | re.M)
    found = []
    for name, cells in ROW.findall(text):
        if name == macro:
            parts = [cell.strip() for cell in CELL.findall(cells)]
            found.append(["".join(re.findall(r'"([^"]*)"', p)) if '"' in p else p for p in parts])
    return found


def fields(text: str) -> list[tuple[str, str]]:
    """``"a u8, b i16"`` -> [("a", "B"), ("b", "h")]."""
    pairs = [field.split() for field in text.split(",") if field.strip()]
    return [(name, FORMATS[kind]) for name, kind in pairs]


REQUESTS = {row[0]: row for row in rows("messages.def", "REQUEST")}
EVENTS = {row[0]: row for row in rows("messages.def", "EVENT")}
RESULTS = [row[0] for row in rows("messages.def", "RESULT")]
SIGNALS = {row[0]: (id_, row[1]) for id_, row in enumerate(rows("telemetry.def", "SIGNAL"))}


def cobs(data: bytes) -> bytes:
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\0"))


def wire(content: bytes) -> bytes:
    crc = binascii.crc_hqx(content, 0xFFFF)
    return cobs(content + struct.pack("<H", crc)) + b"\0"


def pack(table: list[tuple[str, str]], values: dict[str, str]) -> bytes:
    return b"".join(struct.pack("<" + kind, int(values.pop(name), 0)) for name, kind in table)


def request(name: str, values: dict[str, str]) -> bytes:
    row = REQUESTS[name]
    content = bytes([VERSION, int(row[1], 0), int(values.pop("sequence"))])
    content += pack(fields(row[4]), values)
    return content + bytes(SIGNALS[s][0] for s in values.pop("signals", "").split(",") if s)


def answer(name: str, values: dict[str, str]) -> bytes:
    row, result = REQUESTS[name], values.pop("result")
    code = RESULTS.index(result)
    content = bytes([VERSION, ANSWER, int(values.pop("sequence")), int(row[1], 0), code])
    return content + (pack(fields(row[5]), values) if result == "ACCEPTED" else b"")


def event(name: str, values: dict[str, str]) -> bytes:
    row = EVENTS[name]
    content = bytes([VERSION, EVENT, int(values.pop("sequence")), int(row[1], 0)])
    return content + pack(fields(row[2]), values)


def stream(number: str, values: dict[str, str]) -> bytes:
    content = bytes([VERSION, TELEMETRY + int(number), int(values.pop("sequence"))])
    table = [(name, FORMATS[SIGNALS[name][1]]) for name in list(values)]
    return content + pack(table, values)


def encoded(text: str) -> bytes:
    """The wire bytes of one line's text."""
    who, *words = text.split()
    kind = {"host": request}.get(who) or {"answer": answer, "event": event, "stream": stream}[
        words.pop(0)
    ]
    name, values = words[0], dict(word.split("=") for word in words[1:])
    content = kind(name, values)
    assert not values, f"left over: {values}"
    return wire(content)


LINES = [
    line.split("|")
    for line in CONVERSATION.read_text().splitlines()
    if line and not line.startswith("#")
]


@pytest.mark.parametrize(("text", "expected"), LINES, ids=[text.strip() for text, _ in LINES])
def test_line_is_encoded_as_written(text, expected):
    assert encoded(text).hex(" ") == expected.strip()


def test_every_request_but_identify_is_in_the_transcript():
    # identify answers with the fingerprints of tables that are still growing
    asked = {text.split()[1] for text, _ in LINES if text.startswith("host")}
    assert asked == set(REQUESTS) - {"identify"}


def test_lengths_of_requests_are_those_of_their_fields():
    for name, row in REQUESTS.items():
        size = sum(struct.calcsize("<" + kind) for _, kind in fields(row[4]))
        assert size == int(row[2]), name


def test_codes_differ():
    for table in (REQUESTS, EVENTS):
        codes = [int(row[1], 0) for row in table.values()]
        assert len(set(codes)) == len(codes)
        assert all(0 < code < ANSWER for code in codes)


def test_only_requests_that_read_have_an_answer():
    for name, row in REQUESTS.items():
        assert (int(row[1], 0) < 0x10) == bool(row[5]), name


def test_names_of_signals_end_in_their_format():
    for name, _, unit, q_bits, *_ in rows("telemetry.def", "SIGNAL"):
        assert name.endswith(f"_q{q_bits}") == (q_bits != "0"), name
        if q_bits == "0" and unit != "1":
            assert name.endswith(unit.lower()), name
