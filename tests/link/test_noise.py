"""One byte in a hundred is wrong, both ways: nothing wrong is done and nothing is lost unseen.

noise.py makes the experiment and, called by hand, ten minutes of it.
"""

import pytest
from noise import Witness, experiment, on_pseudo_terminal
from omnislip.virtual_robot import VirtualLine


@pytest.fixture(scope="module")
def fast():
    witness = Witness()
    return experiment(VirtualLine(witness), witness, 20.0)


@pytest.fixture(scope="module")
def real_time():
    return on_pseudo_terminal(Witness(), 5.0)


@pytest.fixture(params=["fast", "real_time"])
def figures(request):
    return request.getfixturevalue(request.param)


def test_the_line_is_as_bad_as_meant(figures):
    bytes_passed = sum(figures["bytes"].values())
    # Binomial: six standard deviations.
    assert abs(figures["damaged_bytes"] - bytes_passed / 100) < 0.6 * bytes_passed**0.5
    assert figures["session"]["repeated"] + figures["session"]["unanswered"] > 0
    assert figures["robot"]["bad_frames"] > 0


def test_no_frame_is_valid_that_was_not_sent(fast, real_time):
    """Damage passes the CRC with about 2^-16; what is damaged in real time is not repeatable."""
    assert fast["frames_to_robot"][2] == fast["frames_from_robot"][2] == 0
    broken = real_time["frames_from_robot"][0] - real_time["frames_from_robot"][1]
    assert 0 < broken < 1000  # two that pass are then as unlikely as 1 in 8000
    assert real_time["frames_to_robot"][2] + real_time["frames_from_robot"][2] <= 1


def test_the_robot_holds_only_commands_that_were_offered_in_their_order(figures):
    assert figures["commands_held"] > 0.5 * figures["commands_offered"]
    assert figures["commands_held_and_never_offered"] == 0
    assert figures["commands_in_order"]


def test_parameters_are_what_the_host_has_set(figures):
    assert figures["parameters_set"] > 0
    assert figures["parameters_wrong"] == 0
    assert not figures["other_parameters_changed"]
    assert figures["requests_given_up"] == 0


def test_every_frame_of_the_recording_is_there_or_missed(figures):
    received, missing = figures["record_frames_received"], figures["record_frames_missing"]
    sent = figures["record_frames_sent"]
    assert missing > 0
    # Of what was sent before the first that came and after the last nobody can know.
    assert sent - 20 <= received + missing <= sent
    # The last frame only ends the row before it.
    assert figures["rows"] == received - 1
