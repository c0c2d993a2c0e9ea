"""Linked programs in TI's COFF, versions 0, 1 and 2, for target 0092h (C2x, C2xx, C5x).

Layout, little-endian (SPRU018 appendix A, SPRAAO8; sizes and addresses count 16-bit words):

    file header      version u16 (00C0h or 0092h: 0; 00C1h: 1; 00C2h: 2), sections u16, date u32,
                     symbols at u32, symbols u32, optional header bytes u16, flags u16;
                     from version 1 on: target u16
    optional header  skipped
    section headers  name 8 bytes (0 u32, place in the string table u32 if longer), physical,
                     virtual address, size, data at, relocations at, lines at: u32 each;
                     version 2: relocations u32, lines u32, flags u32, reserved u16, page u16;
                     before: relocations u16, lines u16, flags u16, reserved u8, page u8
    symbols          18 bytes each, the string table behind them

Verified against these documents and other readers' descriptions; never against a file of TI's
linker, which is not to be had here.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

from omnislip.errors import InputError
from omnislip.flash.image import Block

TARGET = 0x0092
VERSIONS = {0x0092: 0, 0x00C0: 0, 0x00C1: 1, 0x00C2: 2}
FILE_EXECUTABLE, FILE_BIG_ENDIAN = 0x0002, 0x0200
# Sections that are not loaded: dummy, no load, copy, uninitialised.
SECTION_NOT_LOADED = 0x0001 | 0x0002 | 0x0010 | 0x0080
PROGRAM_PAGE = 0
SYMBOL_BYTES = 18

_HEADER = struct.Struct("<HHIIIHH")
_SECTION = {
    0: struct.Struct("<8sIIIIIIHHHBB"),
    1: struct.Struct("<8sIIIIIIHHHBB"),
    2: struct.Struct("<8sIIIIIIIIIHH"),
}


@dataclass(frozen=True)
class _File:
    path: Path
    data: bytes

    def cut(self, at: int, count: int, what: str) -> bytes:
        if at + count > len(self.data):
            raise InputError(f"{self.path}: ends within {what}, it should have {at + count} bytes")
        return self.data[at : at + count]


def is_coff(data: bytes) -> bool:
    """Return whether a file begins as one of TI's COFF files for this target."""
    return len(data) >= 2 and struct.unpack_from("<H", data)[0] in VERSIONS


def read_coff(path: Path, data: bytes) -> tuple[str, list[Block]]:
    """Return the name of the format and the program's blocks. InputError names what is wrong."""
    file = _File(path, data)
    magic, sections, _, symbols_at, symbols, optional, flags = _HEADER.unpack(
        file.cut(0, _HEADER.size, "the file header")
    )
    version = VERSIONS[magic]
    at = _HEADER.size
    if version > 0:
        target = struct.unpack("<H", file.cut(at, 2, "the file header"))[0]
        at += 2
        if target != TARGET:
            raise InputError(f"{path}: made for target {target:04X}h, not {TARGET:04X}h (C2xx)")
    if flags & FILE_BIG_ENDIAN:
        raise InputError(f"{path}: a big-endian COFF file; only little-endian ones are known")
    if not flags & FILE_EXECUTABLE:
        raise InputError(f"{path}: not linked, it has unresolved references; link it first")
    strings_at = symbols_at + symbols * SYMBOL_BYTES
    header = _SECTION[version]
    blocks = []
    for number in range(sections):
        fields = header.unpack(
            file.cut(at + optional + number * header.size, header.size, "the section headers")
        )
        blocks += _block(file, fields, strings_at)
    return f"TI COFF {version}", blocks


def _block(file: _File, fields: tuple[bytes | int, ...], strings_at: int) -> list[Block]:
    """Return the block of a section, or nothing if it is not loaded."""
    raw_name, address, _, words, data_at, _, _, relocations, _, flags, _, page = fields
    name = _name(file, raw_name, strings_at)
    if flags & SECTION_NOT_LOADED or data_at == 0 or words == 0:
        return []
    if relocations:
        raise InputError(f"{file.path}: section {name} is not relocated; link it fully")
    if page != PROGRAM_PAGE:
        raise InputError(
            f"{file.path}: section {name} is to be loaded into page {page}; only page 0, program "
            "memory, is there when the chip starts"
        )
    data = file.cut(data_at, 2 * words, f"section {name}")
    return [Block(name, address, struct.unpack(f"<{words}H", data))]


def _name(file: _File, raw: bytes, strings_at: int) -> str:
    if raw[:4] == b"\0\0\0\0":
        at = strings_at + struct.unpack("<I", raw[4:])[0]
        end = file.data.find(b"\0", at)
        if not strings_at < at <= end:
            raise InputError(f"{file.path}: the name of a section lies beyond the string table")
        raw = file.data[at:end]
    return raw.rstrip(b"\0").decode("ascii", "replace")
