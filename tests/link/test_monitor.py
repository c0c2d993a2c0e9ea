"""The live view: what it draws, where it fits, and that it fills a terminal."""

import fcntl
import os
import struct
import subprocess
import sys
import termios

import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.link import protocol
from omnislip.link.monitor import (
    PANEL_COLUMNS,
    PANEL_ROWS,
    SIGNALS,
    WINDOW_S,
    LivePlots,
    Watched,
    grid,
    live_view,
)
from rich.console import Console

BRAILLE = {chr(code) for code in range(0x2801, 0x2900)}


def watched(*signals, period_ms=50, count=300, value=lambda name, k: k):
    found = Watched(signals)
    for k in range(count):
        raw = {name: value(name, k) for name in found.names}
        found.take(k, raw | {"time_ms": k * period_ms})
    return found


def drawn(renderable, width=120, height=40):
    console = Console(width=width, height=height, force_terminal=False, legacy_windows=False)
    with console.capture() as capture:
        console.print(renderable, height=height)
    return capture.get()


def titles(text):
    """Units above the panels."""
    return [word for word in text.split() if word in {"mV", "mm", "mrad", "m/s", "rad/s"}]


def test_samples_in_their_units():
    found = watched("supply_mv", "pose_x_mm_q13", count=3, value=lambda name, k: 8192 * k)
    assert list(found.rows(1)) == [
        {"time_ms": 50.0, "supply_mv": 8192.0, "pose_x_mm_q13": 1.0},
        {"time_ms": 100.0, "supply_mv": 16384.0, "pose_x_mm_q13": 2.0},
    ]
    assert found.values(protocol.SIGNALS["pose_x_mm_q13"], 1).tolist() == [1.0, 2.0]
    assert "COMMAND_TIMEOUT" in drawn(watched("fault", value=lambda name, k: 1).table(""))


def test_a_panel_for_each_unit_with_the_names_of_its_signals():
    text = drawn(LivePlots(watched(*SIGNALS, value=lambda name, k: 1)))
    assert sorted(titles(text)) == sorted(["mV", "mm", "mrad", "m/s", "rad/s"])
    numbers = [n for n in SIGNALS if n not in protocol.NAMES_OF and n != "time_ms"]
    assert all(name in text for name in numbers)


@pytest.mark.parametrize(
    ("width", "height", "expected"),
    [(30, 8, ["mV"]), (30, 16, ["mV", "mm"]), (65, 8, ["mV", "mm"]), (29, 40, []), (90, 7, [])],
)
def test_as_many_panels_as_the_place_has_room_for(width, height, expected):
    text = drawn(LivePlots(watched(*SIGNALS, value=lambda name, k: 1)), width, height)
    assert titles(text) == expected
    assert all(len(line) <= width for line in text.splitlines())


@given(st.integers(0, 12), st.integers(0, 300), st.integers(0, 100))
def test_the_grid_fits_its_place_and_wastes_none_of_it(panels, width, height):
    rows = grid(panels, width, height)
    assert len(rows) * PANEL_ROWS <= height or not rows
    assert all(columns * PANEL_COLUMNS <= width for columns in rows)
    assert sum(rows) == min(panels, (width // PANEL_COLUMNS) * (height // PANEL_ROWS))
    assert not rows or max(rows) - min(rows) <= 1


def test_only_the_last_seconds_are_drawn():
    """What lies before them would stretch the scale from 0 to 100 up to 5000."""
    begin = 300 - round(WINDOW_S / 0.05) - 1
    text = drawn(LivePlots(watched("supply_mv", value=lambda n, k: 5000 if k < begin else k % 101)))
    assert "100.0┤" in text and "5000" not in text


def test_before_the_first_sample_there_is_a_table_and_no_plot():
    text = drawn(live_view(watched("supply_mv", count=0), "0 samples", Console(width=120)))
    assert "supply_mv" in text and "┤" not in text


def test_a_terminal_is_filled_and_given_back(port):
    """On a real terminal of 100 x 30: plots while it runs, the table when it has ended."""
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    words = ["link", str(port), "monitor", "--duration", "1.5"]
    process = subprocess.Popen(
        [sys.executable, "-m", "omnislip.cli", *words],
        stdout=slave,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"TERM": "xterm-256color"},
    )
    os.close(slave)
    shown = b""
    try:
        while piece := os.read(master, 65536):
            shown += piece
    except OSError:  # the other end is closed
        pass
    os.close(master)
    assert process.wait() == 0
    alternate_on, alternate_off = b"\x1b[?1049h", b"\x1b[?1049l"
    live, _, after = shown.partition(alternate_on)[2].partition(alternate_off)
    assert set(live.decode()) & BRAILLE and "rad/s" in live.decode()
    assert "supply_mv" in after.decode() and not set(after.decode()) & BRAILLE
