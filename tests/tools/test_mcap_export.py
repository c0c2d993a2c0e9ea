"""MCAP files, read back with the official reader: all that was logged, in schemas others know."""

import json
import math

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.descriptor import Descriptor
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from omnislip.errors import InputError
from omnislip.log_file import Log
from omnislip.mcap_export import FOXGLOVE_SCHEMAS, with_truth, write_mcap
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.scenario import Scenario
from omnislip.simulate import run_scenario

NAN = math.nan


def read(path):
    """Return (topic, time in ns, schema, message) of each message, by the official reader."""
    with path.open("rb") as stream:
        return [
            (channel.topic, message.log_time, schema, json.loads(message.data))
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]


def of_topic(messages, topic):
    return [(time_ns, message) for name, time_ns, _, message in messages if name == topic]


def small_log() -> Log:
    columns = {
        "wheel/1/duty": np.array([0.5, -0.5, 0.25]),
        "wheel/1/encoder_counts": np.array([65535.0, 0.0, 1.0]),
        "gyro/z_rad_s": np.array([NAN, 0.125, NAN]),
        "pose/x_m": np.array([1.0, NAN, 3.0]),
        "pose/y_m": np.array([2.0, NAN, 4.0]),
        "pose/theta_rad": np.array([math.pi / 2, NAN, NAN]),
    }
    return Log("run", np.array([0.0, 0.005, 1.5]), columns)


def test_columns_become_fields_of_topics_and_blank_cells_nothing(tmp_path):
    write_mcap(small_log(), tmp_path / "run.mcap")
    messages = read(tmp_path / "run.mcap")
    assert of_topic(messages, "/wheel/1") == [
        (0, {"duty": 0.5, "encoder_counts": 65535}),
        (5_000_000, {"duty": -0.5, "encoder_counts": 0}),
        (1_500_000_000, {"duty": 0.25, "encoder_counts": 1}),
    ]
    assert of_topic(messages, "/gyro") == [(5_000_000, {"z_rad_s": 0.125})]
    assert of_topic(messages, "/pose")[1] == (1_500_000_000, {"x_m": 3.0, "y_m": 4.0})


def test_a_whole_pose_is_given_as_foxglove_knows_it(tmp_path):
    write_mcap(small_log(), tmp_path / "run.mcap")
    messages = read(tmp_path / "run.mcap")
    half = pytest.approx(math.sqrt(0.5))
    place, turn = {"x": 1.0, "y": 2.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": half, "w": half}
    start = {"sec": 0, "nsec": 0}
    assert of_topic(messages, "/pose/in_frame") == [
        (
            0,
            {
                "timestamp": start,
                "frame_id": "world",
                "pose": {"position": place, "orientation": turn},
            },
        )
    ]
    assert of_topic(messages, "/tf") == [
        (
            0,
            {
                "timestamp": start,
                "parent_frame_id": "world",
                "child_frame_id": "robot",
                "translation": place,
                "rotation": turn,
            },
        )
    ]


def fields_of(descriptor: Descriptor) -> dict[str, object]:
    """Return the nested field names of an official message."""
    return {
        field.name: fields_of(field.message_type) if field.message_type else None
        for field in descriptor.fields
    }


def names_of(schema: dict) -> dict[str, object] | None:
    properties = schema.get("properties")
    return properties and {name: names_of(item) for name, item in properties.items()}


@pytest.mark.parametrize("official", [PoseInFrame, FrameTransform])
def test_schemas_are_the_official_ones(official):
    ours = names_of(FOXGLOVE_SCHEMAS[official.DESCRIPTOR.full_name])
    theirs = fields_of(official.DESCRIPTOR)
    # Protobuf has a time type of its own; in JSON it is sec and nsec (Foxglove's Timestamp).
    assert theirs["timestamp"] == {"seconds": None, "nanos": None}
    theirs["timestamp"] = {"sec": None, "nsec": None}
    assert ours == theirs


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    velocity = {"t_s": 0.0, "kind": "velocity", "value": [1.0, 0.0, 0.5]}
    run = run_scenario(Scenario("run", 0.5, read_model(NOMINAL_ROBOT), [velocity]))
    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    write_mcap(with_truth(run.log, run.truth), path)
    return run, read(path)


def test_a_simulated_run_shows_what_no_sensor_sees(simulated):
    run, messages = simulated
    slip = [message["slip_m_s"] for _, message in of_topic(messages, "/truth/wheel/3")]
    np.testing.assert_array_equal(slip, run.truth["slip_m_s"][::5, 2])
    believed = [message["x_m"] for _, message in of_topic(messages, "/odometry/pose")]
    np.testing.assert_array_equal(believed, run.truth["odometry"][::5, 0])
    frames = {message["child_frame_id"] for _, message in of_topic(messages, "/tf")}
    assert frames == {"robot", "truth", "odometry"}


def test_every_message_is_as_its_schema_says_and_in_the_order_of_time(simulated):
    _, messages = simulated
    times = [time_ns for _, time_ns, _, _ in messages]
    assert times == sorted(times)
    for _, _, schema, message in messages:
        assert schema.encoding == "jsonschema"
        assert set(message) <= set(json.loads(schema.data)["properties"])


@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=5, unique=True))
def test_times_are_kept_to_the_nanosecond(tmp_path_factory, times):
    t_s = np.sort(times)
    path = tmp_path_factory.getbasetemp() / "run.mcap"
    write_mcap(Log("run", t_s, {"axis/command": np.arange(len(t_s)) * 1.0}), path)
    shown_s = np.array([time_ns for time_ns, _ in of_topic(read(path), "/axis")]) / 1e9
    expected_s = t_s - min(t_s[0], 0.0)
    # A float of seconds holds nanoseconds up to 4e6 s; beyond, its own last digit.
    np.testing.assert_allclose(shown_s, expected_s, rtol=4e-16, atol=1e-9)


def test_a_time_that_does_not_fit_is_named_and_leaves_nothing(tmp_path):
    log = Log("run", np.array([0.0, 1e300]), {"axis/command": np.zeros(2)})
    with pytest.raises(InputError, match=r"run\.mcap: MCAP holds times below 4294967296 s"):
        write_mcap(log, tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []
