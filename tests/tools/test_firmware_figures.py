"""`omnislip figures`: what is measured is what its names say."""

import json

import numpy as np
import pytest
from omnislip.firmware_figures import (
    TUNED_GAINS,
    Case,
    all_cases,
    blow_rows,
    impulse_table,
    run_figures,
    step_rows,
    stopping_rows,
    tables,
    tuning_rows,
)


@pytest.fixture(scope="module")
def blows():
    return blow_rows(6.0, 1.85)


def test_slip_model_leaves_a_third_of_the_displacement_or_less(blows):
    """The aim of the slip model where no wheel is saturated, in every direction."""
    row = next(row for row in impulse_table(blows) if row["impulse_n_s"] == 6.0)
    assert row["saturated_share"] == 0.0
    assert row["ratio_smallest"] > 3.0


def test_both_controllers_slide_as_far_before_they_can_know(blows):
    """The peak is physics: what the blow moves before any wheel has braked it."""
    peaks = {(row["controller"], row["direction_deg"]): row["peak_mm"] for row in blows}
    for direction_deg in range(0, 360, 45):
        ratio = peaks["plain", direction_deg] / peaks["slip", direction_deg]
        assert 0.9 < ratio < 1.2


def test_opposite_sideways_blows_displace_alike(blows):
    """The robot is symmetric about its x axis."""
    left, right = (
        next(
            row["peak_mm"]
            for row in blows
            if row["controller"] == "plain" and row["direction_deg"] == direction
        )
        for direction in (90, 270)
    )
    assert left == pytest.approx(right, rel=0.02)


def test_body_step_takes_the_time_of_its_acceleration_limit():
    rows = {(row["controller"], row["what"]): row for row in step_rows()}
    body = rows["slip", "body, 1 m/s"]
    assert body["rise_ms"] == pytest.approx(800 / 1.472, rel=0.05)
    assert 0.0 <= body["overshoot_percent"] < 5.0
    assert rows["plain", "wheel, 0.15 m/s at the rim"]["rise_ms"] < 15.0


def test_stopping_cannot_beat_the_floor():
    """Along x four wheels give at most mu g sin 30, and no traction limit loses the odometry."""
    rows = {(row["floor"], row["traction_limit"]): row for row in stopping_rows()}
    shortest_mm = 1e3 * 1.5**2 / 2 / (0.2 * 9.81 * 0.5 + 0.05 * 9.81)
    for row in rows.values():
        assert row["distance_mm"] > 0.95 * shortest_mm
    held = rows["constant friction", "with"]["odometry_error_mm"]
    assert held < 0.2 * rows["constant friction", "without"]["odometry_error_mm"]


def test_file_holds_settings_and_every_figure(tmp_path):
    cases = [Case("steps", ()), Case("stopping", ())]
    result = run_figures(cases, tmp_path)
    written = json.loads((tmp_path / "figures.json").read_text())
    assert written == result
    assert written["schema"] == "omnislip-figures/1"
    assert written["parameters"]["speed_gain_q15"] > 0
    every = {"impulses", "odometry", "tuning", "steps", "stopping"}
    assert {case.figure for case in all_cases()} == every


@pytest.mark.parametrize("gain", TUNED_GAINS)
def test_no_tuning_of_the_baseline_makes_up_for_what_it_does_not_see(gain):
    """As tuned, the slip model leaves less than a third of the baseline's best over all factors."""
    rows = tuning_rows(gain)
    best = min(row["plain_remaining_mm"] for row in rows)
    as_it_is = next(row for row in rows if row["factor"] == 1.0)
    assert as_it_is["slip_remaining_mm"] < best / 3


def test_tables_have_a_row_per_impulse(blows):
    rows = {"impulses": blows, "odometry": [], "tuning": [], "steps": [], "stopping": []}
    title, table = tables(rows | {"impulses": blows})[0]
    assert "blows" in title
    assert [row["impulse_n_s"] for row in table if np.isfinite(row["ratio_median"])] == [6.0]
