"""Frames and messages against the firmware's transcript, and against noise."""

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_bench import robot
from omnislip.errors import InputError
from omnislip.link import protocol
from omnislip.link.protocol import (
    Answer,
    FrameReader,
    Happening,
    Sample,
    StreamLayout,
    decode_message,
    encode_frame,
    encode_request,
)

CONVERSATION = Path(__file__).parents[1] / "firmware" / "link_conversation.txt"
LINES = [
    [half.strip() for half in line.split("|")]
    for line in CONVERSATION.read_text().splitlines()
    if line and not line.startswith("#")
]
HOST = [line for line in LINES if line[0].startswith("host")]
ROBOT = [line for line in LINES if line[0].startswith("robot")]
contents = st.binary(min_size=1, max_size=protocol.CONTENT_MAX)
messages = st.binary(min_size=3, max_size=protocol.CONTENT_MAX)


def words_of(text):
    """What a line of the transcript says: who, kind, name, values."""
    head = [word for word in text.split() if "=" not in word]
    return head, dict(word.split("=") for word in text.split() if "=" in word)


@pytest.mark.parametrize(("text", "wire"), HOST, ids=[text for text, _ in HOST])
def test_requests_are_those_of_the_transcript(text, wire):
    (_, name), values = words_of(text)
    sequence = int(values.pop("sequence"))
    signals = [protocol.SIGNALS[s].id for s in values.pop("signals", "").split(",") if s]
    numbers = {key: int(value) for key, value in values.items()}
    assert encode_request(name, sequence, numbers, bytes(signals)).hex(" ") == wire


def told(message):
    """What a message of the robot says, as the transcript writes it."""
    if isinstance(message, Answer):
        request = next(r for r in protocol.REQUESTS.values() if r.code == message.code)
        result = protocol.RESULT_NAMES[message.result]
        fields = request.answer.unpack(message.fields) if message.fields else {}
        return f"answer {request.name}", {"sequence": message.sequence, "result": result, **fields}
    if isinstance(message, Happening):
        return f"event {message.name}", {"sequence": message.sequence, **message.values}
    return f"stream {message.stream}", {"sequence": message.sequence}


@pytest.mark.parametrize(("text", "wire"), ROBOT, ids=[text for text, _ in ROBOT])
def test_what_the_robot_says_is_read_as_the_transcript_says_it(text, wire):
    (content,) = FrameReader().feed(bytes.fromhex(wire))
    assert encode_frame(content) == bytes.fromhex(wire)
    message = decode_message(content)
    (_, *kind), values = words_of(text)
    head, read = told(message)
    if isinstance(message, Sample):
        layout = StreamLayout([protocol.SIGNALS[name] for name in values if name != "sequence"])
        read |= layout.unpack(message.signals)
    assert head.split() == kind
    assert {key: str(value) for key, value in read.items()} == values


def test_tables_are_those_of_the_robot():
    reader = FrameReader()
    came = robot().advance(10, encode_request("identify", 1, {}))
    answers = [decode_message(content) for content in reader.feed(came)]
    (answer,) = [a for a in answers if isinstance(a, Answer)]
    fields = protocol.REQUESTS["identify"].answer.unpack(answer.fields)
    assert fields["parameter_table"] == protocol.parameter_table()
    assert fields["signal_table"] == protocol.signal_table()
    assert fields["parameter_count"] == len(protocol.PARAMETERS)
    assert fields["signal_count"] == len(protocol.SIGNALS)


# ---- frames under noise ----


@given(messages)
def test_a_frame_comes_back(content):
    wire = encode_frame(content)
    assert wire.count(0) == 1 and wire[-1] == 0
    assert len(wire) <= len(content) + protocol.FRAME_OVERHEAD
    assert FrameReader().feed(wire) == [content]


@given(st.lists(messages), st.data())
def test_frames_come_back_however_they_are_cut(sent, data):
    wire = b"".join(map(encode_frame, sent))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)))))
    reader = FrameReader()
    pieces = [wire[a:b] for a, b in zip([0, *cuts], [*cuts, len(wire)], strict=True)]
    assert [content for piece in pieces for content in reader.feed(piece)] == sent
    assert reader.broken == 0


@given(messages, st.data())
def test_one_wrong_bit_is_never_accepted(content, data):
    wire = bytearray(encode_frame(content))
    wire[data.draw(st.integers(0, len(wire) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert content not in FrameReader().feed(bytes(wire) + b"\0")


@given(st.binary(max_size=300), messages)
def test_after_noise_a_delimiter_begins_afresh(noise, content):
    reader = FrameReader()
    heard = reader.feed(noise + b"\0" + encode_frame(content))
    assert heard[-1] == content


@given(st.binary(max_size=400))
def test_noise_is_read_without_an_exception(noise):
    for content in FrameReader().feed(noise):
        decode_message(content)


@given(messages)
def test_any_valid_content_is_read_without_an_exception(content):
    decode_message(content)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        bytes([1, 0x80, 0]),
        bytes([1, 0x80, 0, 0x77, 0]),  # an answer to no request
        bytes([1, 0x80, 0, 0x18, 99]),  # no such result
        bytes([1, 0x80, 0, 0x18, 0, 0]),  # a field too many
        bytes([1, 0x80, 0, 0x02, 0, 0]),  # half a field
        bytes([1, 0x81, 0, 0x77]),  # no such event
        bytes([1, 0x81, 0, 2, 0, 0, 0, 0, 99, 0, 0]),  # no such state
        bytes([1, 0x93, 0]),  # no such stream
        bytes([1, 0x18, 0]),  # a request
    ],
)
def test_what_no_robot_says_is_no_message(content):
    assert decode_message(content) is None


def test_noise_without_end_is_not_kept():
    reader = FrameReader()
    for _ in range(1000):
        reader.feed(b"\x55" * 1000)
    assert reader.feed(b"\0" + encode_frame(b"abc")) == [b"abc"]
    assert reader.broken == 1


# ---- values ----


@given(st.sampled_from(list(protocol.PARAMETERS.values())), st.data())
def test_parameters_convert_to_their_unit_and_back(parameter, data):
    raw = data.draw(st.integers(parameter.minimum, parameter.maximum))
    assert parameter.raw(parameter.value(raw)) == raw


def test_a_parameter_out_of_its_limits_is_named_with_them():
    gain = protocol.find_parameter("speed_gain")
    with pytest.raises(InputError, match=r"speed_gain_q15: must be 0 to 0\.99.* V\*s/rad, not 2"):
        gain.raw(2.0)


def test_unknown_names_are_answered_with_the_nearest():
    with pytest.raises(InputError, match="did you mean 'speed_gain_q15'"):
        protocol.find_parameter("sped_gain_q15")
    with pytest.raises(InputError, match="did you mean 'supply_mv'"):
        protocol.find_signal("suply_mv")


def test_signals_that_do_not_fit_a_frame_are_refused():
    with pytest.raises(InputError, match="do not fit a frame"):
        StreamLayout([protocol.SIGNALS["time_ms"]] * 16)


def test_a_field_that_does_not_fit_is_an_error():
    with pytest.raises(struct.error):
        encode_request("velocity", 0, {"x_mm_s": 40000, "y_mm_s": 0, "omega_mrad_s": 0})
