"""A program image: words at addresses of program memory, and the rules they must obey.

Memory of the LF2407A in microcontroller mode (SPRU357; those marked [M] from memory of it):

    0000-7FFF  flash; 0000-003F vectors, 0040-0043 password: whatever is programmed there but FFFFh
               locks the chip; sectors of 4, 12, 12 and 4 K words [M]
    8000-87FF  SARAM, seen as program memory while PON = 1 [M]
    8800-FDFF  external
    FF00-FFFF  DARAM B0, while CNF = 1: the boot ROM sets it for destinations from FE00h on
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnislip.errors import InputError

PASSWORD = range(0x0040, 0x0044)
ERASED = 0xFFFF
FLASH_SECTORS = (
    range(0x0000, 0x1000),
    range(0x1000, 0x4000),
    range(0x4000, 0x7000),
    range(0x7000, 0x8000),
)


@dataclass(frozen=True)
class Region:
    """Addresses of program memory that hold a program."""

    name: str
    begin: int
    end: int
    is_ram: bool


REGIONS = (
    Region("flash", 0x0000, 0x8000, False),
    Region("SARAM", 0x8000, 0x8800, True),
    Region("DARAM B0", 0xFF00, 0x10000, True),
)


@dataclass(frozen=True)
class Block:
    """Words in a row; `name` is that of the section, or the place in the file."""

    name: str
    address: int
    words: tuple[int, ...]

    @property
    def end(self) -> int:
        """Address behind the last word."""
        return self.address + len(self.words)

    @property
    def region(self) -> Region | None:
        """The memory that holds all of it, None if there is none."""
        fits = (r for r in REGIONS if r.begin <= self.address and self.end <= r.end)
        return next(fits, None)


@dataclass(frozen=True)
class Image:
    """A program that may be loaded: blocks in the order of their addresses."""

    path: Path
    format: str
    blocks: tuple[Block, ...]

    @property
    def for_ram(self) -> bool:
        """Whether all of it goes to RAM."""
        return all(block.region is not None and block.region.is_ram for block in self.blocks)

    @property
    def flash_sectors(self) -> list[int]:
        """Numbers of the flash sectors that hold something of it."""
        return [
            number
            for number, sector in enumerate(FLASH_SECTORS)
            if any(b.address < sector.stop and sector.start < b.end for b in self.blocks)
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return what `omnislip flash --json` prints."""
        return {
            "file": str(self.path),
            "format": self.format,
            "for_ram": self.for_ram,
            "flash_sectors": self.flash_sectors,
            "blocks": [
                {
                    "name": block.name,
                    "address": block.address,
                    "words": len(block.words),
                    "memory": block.region.name if block.region else None,
                }
                for block in self.blocks
            ],
        }


def make_image(path: Path, format_name: str, blocks: Iterable[Block]) -> Image:
    """Return the image of `blocks`. InputError when a rule of the memory is broken."""
    ordered = sorted((block for block in blocks if block.words), key=lambda b: b.address)
    if not ordered:
        raise InputError(f"{path}: there is nothing to load in it")
    for block in ordered:
        _check_place(path, block)
    for before, after in itertools.pairwise(ordered):
        if after.address < before.end:
            raise InputError(
                f"{path}: {before.name} and {after.name} both have address {after.address:04X}h"
            )
    _check_reset_vector(path, ordered[0])
    return Image(path, format_name, tuple(ordered))


def _check_place(path: Path, block: Block) -> None:
    if block.region is None:
        places = ", ".join(f"{r.name} {r.begin:04X}h-{r.end - 1:04X}h" for r in REGIONS)
        raise InputError(
            f"{path}: {block.name} at {block.address:04X}h-{block.end - 1:04X}h does not lie in "
            f"one memory; there are {places}"
        )
    if block.region.is_ram:
        return
    for address in PASSWORD:
        if block.address <= address < block.end and block.words[address - block.address] != ERASED:
            raise InputError(
                f"{path}: {block.name} writes {address:04X}h, a word of the flash password: that "
                "locks the chip; leave 0040h-0043h out or FFFFh"
            )


def _check_reset_vector(path: Path, first: Block) -> None:
    """The word at 0 is a branch, 7980h to 79FFh; its bytes changed over betray a swapped file."""
    word = first.words[0]
    swapped = word >> 8 | (word & 0xFF) << 8
    if first.address == 0 and word & 0xFF80 != 0x7980 and swapped & 0xFF80 == 0x7980:
        raise InputError(
            f"{path}: the bytes of each word are changed over; high byte first is right "
            "(dsphex -order MS)"
        )
