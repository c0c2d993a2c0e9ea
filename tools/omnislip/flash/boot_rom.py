"""The serial protocol of the LF2407A's boot ROM: a program into RAM, then started.

    1  Reset with BOOT_EN low. 38400 baud, 8N1. The host sends 0Dh until the chip has found its
       clock and baud rate (nine good ones in a row) and acknowledges with AAh.
    2  Each byte from then on comes back as an echo: destination, length n, n words, two bytes each,
       high byte first. There is no checksum.
    3  The chip branches to the destination.

Echo and order of steps are those of the LF240x manual (SPRU357); AAh, high byte first and that the
LF2407A does as its predecessor are from memory or inferred: never tried on a chip.

One wrong or missing echo and the image in the chip cannot be trusted. The chip cannot be told: it
counts bytes until it has n words, whatever they are, then it branches. So after a wrong echo not a
byte more is sent before the chip has been reset, by a line of the port or by hand. The last byte
starts the program, and its echo may be lost in that; a word FFFFh behind the image keeps it out of
the program.
"""

from collections.abc import Callable
from dataclasses import dataclass

from omnislip.errors import InputError, RobotError
from omnislip.flash.image import ERASED, Image
from omnislip.link.port import Line

BAUD = 38400
SYNC = b"\x0d"
ACKNOWLEDGE = b"\xaa"
ATTEMPTS = 5
# Two bytes take 0.5 ms, adapters add up to 16 ms each way.
SYNC_PERIOD_S = 0.1
SYNC_TIME_S = 10.0
ECHO_TIMEOUT_S = 0.2

Tell = Callable[[str], None]


class WrongEcho(RobotError):  # noqa: N818 - what happened, not a defect
    """What came back is not what was sent."""


@dataclass(frozen=True)
class Loaded:
    """An image that stands in the chip; `confirmed`: its last byte came back, so it was started."""

    attempts: int
    confirmed: bool


def load(line: Line, image: Image, reset: Callable[[], None], tell: Tell) -> Loaded:
    """Load and start a RAM image.

    `reset` resets the chip into its boot ROM, before each attempt. InputError when the image is not
    one for RAM; RobotError when the chip does not answer, or after ATTEMPTS.
    """
    data = transfer_bytes(image)
    for attempt in range(1, ATTEMPTS + 1):
        reset()
        try:
            _synchronise(line)
            return Loaded(attempt, _transfer(line, data, tell))
        except WrongEcho as wrong:
            tell(f"attempt {attempt} of {ATTEMPTS}: {wrong}")
    raise RobotError(f"{image.path}: not loaded: {ATTEMPTS} attempts each met a wrong echo")


def transfer_bytes(image: Image) -> bytes:
    """Return destination, length and words as they are sent.

    Several blocks become one, gaps filled with FFFFh: the boot ROM takes a single one. A word FFFFh
    follows, if the memory has one left.
    """
    if not image.for_ram:
        flash = next(b for b in image.blocks if b.region is not None and not b.region.is_ram)
        raise InputError(
            f"{image.path}: {flash.name} goes to flash, which the boot ROM cannot write; "
            f"omnislip flash {image.path} names the tools that do"
        )
    first, last = image.blocks[0], image.blocks[-1]
    if last.region is None or first.region != last.region:
        raise InputError(
            f"{image.path}: {first.name} and {last.name} lie in different memories; the boot ROM "
            "loads one block"
        )
    words = [ERASED] * (min(last.end + 1, last.region.end) - first.address)
    for block in image.blocks:
        start = block.address - first.address
        words[start : start + len(block.words)] = block.words
    numbers = [first.address, len(words), *words]
    return b"".join(number.to_bytes(2, "big") for number in numbers)


def _synchronise(line: Line) -> None:
    """Send 0Dh until the chip acknowledges."""
    until_s = line.time_s() + SYNC_TIME_S
    came = b""
    while line.time_s() < until_s:
        line.write(SYNC)
        came = line.read(SYNC_PERIOD_S)
        if came.endswith(ACKNOWLEDGE):
            break
        if came.endswith(SYNC):
            raise WrongEcho("the chip echoes though its acknowledgement has not come back")
    else:
        heard = f"; the last that came was {came.hex(' ')}" if came else ""
        raise RobotError(f"the boot ROM has not answered for {SYNC_TIME_S:g} s{heard}")
    if late := line.read(SYNC_PERIOD_S):
        raise WrongEcho(f"after its acknowledgement the chip sent {late.hex(' ')}")


def _transfer(line: Line, data: bytes, tell: Tell) -> bool:
    """Send an image; return whether the last byte has come back too."""
    for sent, byte in enumerate(data[:-1]):
        line.write(bytes([byte]))
        echo = line.read(ECHO_TIMEOUT_S)
        if echo != bytes([byte]):
            came = echo.hex(" ") or "nothing"
            raise WrongEcho(f"byte {sent + 1} of {len(data)}: sent {byte:02x}, {came} came back")
        if sent % 64 == 0:
            tell(f"{sent} of {len(data)} bytes")
    line.write(data[-1:])
    return line.read(ECHO_TIMEOUT_S)[:1] == data[-1:]
