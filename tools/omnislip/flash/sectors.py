"""Programs for flash sectors: the tools of others that write them, and the steps with each.

The boot ROM writes no flash. A program in RAM could, but TI's (the kernel of its package SPRC074)
speaks a protocol that was never published, in files whose layout was not either, and a wrong pulse
at the flash can make it unusable. So nothing is sent to the chip from here: what can be checked is
checked, and the steps with the tool at hand are told.

Known of these tools, all from public threads of TI's forum and the tools' own notes, none tried:

    SPRC074   krnl24xx.hex is the kernel; clr24_x1, era24_x1, prg24_x1 clear, erase, program;
              f240_hex.exe converts COFF version 1, base name of at most 7 characters, short path;
              serhost1.exe and serhost2.exe send it all, on Windows up to 7, 32 bit, not on 10
    C2Prog    serial, too; knows TMS320LF2407A at 40 MHz, PLL x4; reads Intel HEX
    JTAG      prg2xx and SDFlash of Spectrum Digital with an XDS510-class probe
    SPISIMO   low for the boot ROM to listen to the SCI, as a user quotes TI's flash guide

Inferred: serhost1 is for COM1, serhost2 for COM2.
"""

from pathlib import Path

from omnislip.errors import InputError
from omnislip.flash.image import FLASH_SECTORS, Image

KERNEL_FILES = ("krnl24xx.hex", "clr24_x1.hex", "era24_x1.hex", "prg24_x1.hex", "f240_hex.exe")
HOST_PROGRAMS = ("serhost1.exe", "serhost2.exe")
KERNEL_FORMAT = "TI COFF 1"
BASE_NAME_CHARACTERS = 7


def ways(image: Image) -> list[str]:
    """Return lines: what writes this program to the flash; none for a program in RAM."""
    if not image.flash_sectors:
        return []
    name = image.path.stem
    sectors = ", ".join(
        f"{n} ({FLASH_SECTORS[n].start:04X}h-{FLASH_SECTORS[n].stop - 1:04X}h)"
        for n in image.flash_sectors
    )
    return [
        f"flash sectors: {sectors}; the boot ROM cannot write them, these tools of others can:",
        "  C2Prog, serial port, Windows",
        f"    dsphex -romwidth 16 -memwidth 16 -i -o {name}.hex {name}.out",
        "    target TMS320LF2407A, 40 MHz, PLL x4; chip reset with BOOT_EN and SPISIMO low",
        "  TI's serial programmer (SPRC074), 32-bit Windows up to 7",
        f"    omnislip flash {image.path} --kernel FOLDER   checks its files and names the steps",
        "  prg2xx, JTAG, probe of XDS510 class; algorithms made for 10 MHz x 4",
        "    clear and erase with its own algorithms, then",
        f"    prg2xxw95 -p 240 -w 6 c2xx_bpX.out {name}.out",
    ]


def kernel_steps(image: Image, folder: Path) -> list[str]:
    """Return lines: the steps with TI's serial programmer in `folder`.

    InputError when a file of it is missing, or it cannot read this program.
    """
    if image.for_ram:
        raise InputError(
            f"{image.path}: goes to RAM; --port loads it through the boot ROM, without a kernel"
        )
    host = _check_folder(folder)
    if image.format != KERNEL_FORMAT:
        raise InputError(
            f"{image.path}: is {image.format}; f240_hex reads COFF version 1 only: "
            "link with -v1 and give the .out file"
        )
    short = image.path.stem[:BASE_NAME_CHARACTERS]
    return [
        f"with TI's serial programmer in {folder}, on 32-bit Windows up to 7 (also a virtual one):",
        f"  1  copy {image.path} to {folder} as {short}.out, and the folder to a short path",
        f"  2  there: f240_hex {short}.out   (it writes {short}.hex)",
        f"  3  connect the chip's SCI to COM{host.removesuffix('.exe')[-1]}, "
        "reset the chip with BOOT_EN and SPISIMO low",
        f"  4  there: {host.removesuffix('.exe')} {short}.hex",
        "not done from here: the protocol of TI's kernel was never published; "
        "nothing has been sent to the chip",
    ]


def _check_folder(folder: Path) -> str:
    """Return the host program of the package in `folder`; names may be in capitals."""
    try:
        there = {path.name.lower() for path in folder.iterdir()}
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from None
    missing = [name for name in KERNEL_FILES if name not in there]
    host = next((name for name in HOST_PROGRAMS if name in there), None)
    if host is None:
        missing.append(" or ".join(HOST_PROGRAMS))
    if host is None or missing:
        raise InputError(
            f"{folder}: not TI's serial programmer SPRC074: {', '.join(missing)} missing"
        )
    return host
