"""The film: as long, as large and as full of motion as it says."""

from itertools import pairwise

import numpy as np
import pytest
from omnislip import animation, paper
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.simulate import simulate_truth
from PIL import Image


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "push.gif"
    model = read_model(NOMINAL_ROBOT)
    truths = {}
    for name in paper.CONTROLLERS:
        case = paper.Case(name, 2.35, paper.REFERENCE_IMPULSE_N_S)
        truths[case] = simulate_truth(paper.case_scenario(case, model))
    paper.film_push(truths, model, path)
    with Image.open(path) as image:
        frames = []
        for number in range(image.n_frames):
            image.seek(number)
            frames.append(np.asarray(image.convert("RGB")).astype(int))
        return path, image.info["duration"], frames


def test_the_film_is_three_times_slower_than_the_runs(film):
    path, frame_ms, frames = film
    shown_s = len(frames) * frame_ms / 1000
    expected_s = animation.SLOWER * (animation.BEFORE_PUSH_S + animation.AFTER_PUSH_S)
    assert shown_s == pytest.approx(expected_s, abs=2 * frame_ms / 1000)
    assert path.stat().st_size < 5e6


def pixels_like(frame: np.ndarray, colour: str) -> int:
    rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(frame - rgb).max(axis=2) < 12).sum())


def test_the_push_is_seen_when_it_happens(film):
    frames = film[2]
    push = round(animation.BEFORE_PUSH_S * animation.FRAMES_PER_S * animation.SLOWER)
    shown = round(animation.PUSH_SHOWN_S * animation.FRAMES_PER_S * animation.SLOWER)
    arrow = [pixels_like(frame, animation.plots.PINK) for frame in frames]
    lone_line = max(arrow[: push - 1])
    assert min(arrow[push + 1 : push + shown - 1]) > lone_line + 500
    assert max(arrow[push + shown + 1 :]) <= lone_line


def test_every_frame_shows_motion_and_both_controllers(film):
    frames = film[2]
    assert all((before != frame).any() for before, frame in pairwise(frames))
    for colour in paper.CONTROLLER_COLOURS.values():
        assert min(pixels_like(frame, colour) for frame in frames) > 500
