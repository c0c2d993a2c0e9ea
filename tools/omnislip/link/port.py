"""The serial port as a line: bytes out, bytes in, and the clock that goes with them.

A line is anything with these three methods; `omnislip.virtual_robot.VirtualLine` is another one.
"""

import os
import time
from typing import Protocol

import serial
from serial.tools import list_ports

from omnislip.errors import InputError, RobotError

BAUD = 115200
PULSE_S = 0.05


class Line(Protocol):
    """What a session needs of a serial line."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def read(self, timeout_s: float) -> bytes:
        """Return what has come, as soon as there is any; nothing after `timeout_s`."""

    def time_s(self) -> float:
        """Return a clock that only runs forward."""


class SerialLine:
    """A serial port, or a URL that pyserial knows (socket://host:port, ...)."""

    def __init__(self, port: str, baud: int = BAUD) -> None:
        """Open `port`. InputError when it is not there or in use."""
        self._name = port
        try:
            self._port = serial.serial_for_url(port, baudrate=baud, timeout=0, do_not_open=True)
            self._port.exclusive = True
            self._port.open()
            self._port.reset_input_buffer()
        except (OSError, ValueError) as error:
            there = ", ".join(found.device for found in list_ports.comports()) or "none found"
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            raise InputError(
                f"{port}: cannot be opened as a serial port: {reason}; ports: {there}"
            ) from None

    def write(self, data: bytes) -> None:
        """Send bytes. RobotError when the port is gone."""
        try:
            self._port.write(data)
        except OSError as error:
            raise self._gone(error) from None

    def read(self, timeout_s: float) -> bytes:
        """Return what has come, as soon as there is any. RobotError when the port is gone."""
        try:
            self._port.timeout = max(0.0, timeout_s)
            data = self._port.read(1)
            self._port.timeout = 0
            return data + self._port.read(4096) if data else data
        except OSError as error:
            raise self._gone(error) from None

    def time_s(self) -> float:
        """Return the computer's monotonic clock."""
        return time.monotonic()

    def pulse(self, output: str) -> None:
        """Activate "rts" or "dtr" for PULSE_S. RobotError when the port has none."""
        try:
            for active in (True, False):
                setattr(self._port, output, active)
                time.sleep(PULSE_S)
            self._port.reset_input_buffer()
        except OSError as error:
            raise RobotError(f"{self._name}: has no {output}: {error}") from None

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _gone(self, error: OSError) -> RobotError:
        return RobotError(f"{self._name}: the port is gone: {error}")
