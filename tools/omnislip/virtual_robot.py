"""The virtual robot: firmware, plant, serial line and EEPROM (``sim/virtual_robot.h``) on a PC.

`serve` runs it in real time behind a pseudo-terminal, `VirtualLine` as fast as the machine allows
behind the interface of a serial line.
"""

import os
import select
import struct
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from omnislip import _core
from omnislip.errors import InputError
from omnislip.files import replace_file
from omnislip.model_file import Model

STORE_WORDS = len(_core.VirtualRobot({}, []).store)
_STORE_FORMAT = struct.Struct(f">{STORE_WORDS}H")

CHUNK_TICKS = 5
# Later than this the robot leaves time out instead of running after it.
GIVE_UP_S = 1.0


def make_robot(
    model: Model, store: list[int] | None = None, on_board: bool = False
) -> _core.VirtualRobot:
    """Return a robot just switched on. `store`: words of its EEPROM, default blank.

    on_board: its firmware runs through the drivers on the virtual LF2407A. InputError when the
    model is not one of a robot, or too stiff to be integrated.
    """
    if model.kind != "robot":
        raise InputError(f"{model.path}: model.kind is '{model.kind}', a 'robot' is needed")
    parameters, effects = model.to_core()
    try:
        return _core.VirtualRobot(
            parameters, effects, store or [], model.own_effects, on_board=on_board
        )
    except ValueError as error:
        raise InputError(f"{model.path}: {error}") from None


class VirtualLine:
    """A serial line to a virtual robot whose time passes only while it is listened to."""

    def __init__(self, robot: _core.VirtualRobot) -> None:
        self.robot = robot
        self._unsent = b""

    def write(self, data: bytes) -> None:
        """Put bytes on the line."""
        self._unsent += data

    def read(self, timeout_s: float) -> bytes:
        """Let time pass until something has come, at most `timeout_s`, at least a tick."""
        for _ in range(max(1, round(1000 * timeout_s))):
            sent, self._unsent = self._unsent, b""
            came = self.robot.advance(1, sent)
            if came:
                return came
        return b""

    def time_s(self) -> float:
        """Return the robot's time."""
        return self.robot.ticks / 1000


# ---- EEPROM ----


def read_store(path: Path) -> list[int]:
    """Return the words of an EEPROM file; those of a blank one if there is no file."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) != _STORE_FORMAT.size:
        raise InputError(f"{path}: an EEPROM file has {_STORE_FORMAT.size} bytes, not {len(data)}")
    return list(_STORE_FORMAT.unpack(data))


def write_store(path: Path, words: list[int]) -> None:
    """Write an EEPROM file, whole or not at all."""
    with replace_file(path) as temporary:
        temporary.write_bytes(_STORE_FORMAT.pack(*words))


# ---- real time ----


@contextmanager
def pseudo_terminal() -> Iterator[tuple[int, str]]:
    """Give the robot's end of a new pseudo-terminal and the name of the host's end."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave, termios.TCSANOW)
        os.set_blocking(master, False)
        # The host's end stays open here too: it may come and go without an end of file.
        yield master, os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


@contextmanager
def port_link_to(port: str, link: Path | None) -> Iterator[None]:
    """Let `link` point at `port` while the robot runs. InputError when something else is there."""
    if link is None:
        yield
        return
    try:
        if link.is_symlink():
            link.unlink()
        link.symlink_to(port)
    except OSError as error:
        raise InputError(f"{link}: no link can be made there: {error.strerror}") from None
    try:
        yield
    finally:
        if link.is_symlink() and str(link.readlink()) == port:
            link.unlink()


def serve(
    robot: _core.VirtualRobot,
    master: int,
    store_path: Path | None = None,
    late: Callable[[float], None] = lambda late_s: None,
) -> None:
    """Run the robot in real time until an exception (Ctrl-C) ends it.

    `late` is told when the machine was too slow and how many seconds are left out. Bytes that
    nobody reads are lost, as on a wire.
    """
    begin_s = time.monotonic() - robot.ticks / 1000
    writes_kept = robot.store_writes
    while True:
        behind_s = time.monotonic() - begin_s - robot.ticks / 1000
        if behind_s > GIVE_UP_S:
            late(behind_s)
            begin_s += behind_s
        ticks = min(int(1000 * behind_s), CHUNK_TICKS)
        if ticks == 0:
            time.sleep(0.001)
            continue
        _send(master, robot.advance(ticks, _receive(master)))
        if store_path is not None and robot.store_writes != writes_kept:
            writes_kept = robot.store_writes
            write_store(store_path, robot.store)


def _receive(master: int) -> bytes:
    readable, _, _ = select.select([master], [], [], 0.0)
    return os.read(master, 4096) if readable else b""


def _send(master: int, data: bytes) -> None:
    try:
        os.write(master, data)
    except BlockingIOError:
        return
