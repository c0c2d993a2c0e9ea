"""What the command `omnislip flash` does, step by step."""

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from omnislip.errors import InputError, RobotError
from omnislip.flash import boot_rom
from omnislip.flash.coff import is_coff, read_coff
from omnislip.flash.image import Image, make_image
from omnislip.flash.intel_hex import read_intel_hex
from omnislip.link.port import SerialLine


def read_image(path: Path) -> Image:
    """Read a program, TI COFF or Intel HEX by its contents. InputError names what is wrong."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if is_coff(data):
        return make_image(path, *read_coff(path, data))
    if data.lstrip().startswith(b":"):
        return make_image(path, *read_intel_hex(path, data))
    raise InputError(
        f"{path}: neither TI COFF for target 0092h (begins with 92, C0, C1 or C2) nor Intel HEX "
        "(begins with ':')"
    )


def show_image(image: Image, steps: list[str]) -> None:
    """Print what goes where, and the steps behind it."""
    table = Table(title=f"{image.path}: {image.format}", title_justify="left", box=None)
    for heading in ("section", "from", "to", "words", "memory"):
        table.add_column(heading, justify="left" if heading in ("section", "memory") else "right")
    for block in image.blocks:
        memory = block.region.name if block.region else ""
        ends = (f"{block.address:04X}h", f"{block.end - 1:04X}h")
        table.add_row(block.name, *ends, str(len(block.words)), memory)
    Console().print(table)
    for line in steps:
        print(line)


def load_ram(image: Image, port: str, reset_line: str | None) -> None:
    """Load a RAM image through the boot ROM and start it.

    reset_line: "rts" or "dtr" if that output resets the chip, None to ask for it.
    """
    boot_rom.transfer_bytes(image)  # what cannot be loaded is said before the port is opened
    line = SerialLine(port, boot_rom.BAUD)
    console = Console(stderr=True)
    status = console.status("")

    def tell(text: str) -> None:
        status.update(text)
        if not text[0].isdigit():  # what counts bytes only moves the status line
            console.print(text, highlight=False)

    def reset() -> None:
        if reset_line is not None:
            line.pulse(reset_line)
            return
        status.stop()
        console.print("reset the chip with BOOT_EN low, then press Enter")
        if not sys.stdin.readline():
            raise RobotError("nobody to reset the chip; --reset-by rts or dtr if the port can")
        status.start()

    try:
        loaded = boot_rom.load(line, image, reset, tell)
    finally:
        status.stop()
        line.close()
    words = sum(len(block.words) for block in image.blocks)
    again = f" in attempt {loaded.attempts}" if loaded.attempts > 1 else ""
    if loaded.confirmed:
        print(f"{words} words loaded and started{again}")
    else:
        print(f"{words} words loaded{again}; the last byte has not come back: see whether it runs")
