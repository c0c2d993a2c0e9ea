"""Programs in Intel HEX, as TI's converter writes them for 16-bit memory.

    dsphex -i -memwidth 16 -romwidth 16 -order MS program.out

Addresses then count words, and a word is two bytes, high byte first. Files for memories of 8 bits
hold bytes at addresses that count bytes; they are told by their records and refused.
"""

import itertools
from dataclasses import dataclass
from pathlib import Path

from omnislip.errors import InputError
from omnislip.flash.image import Block

DATA, END, SEGMENT, START, LINEAR, LINEAR_START = range(6)
_RIGHT = "convert with dsphex -i -memwidth 16 -romwidth 16 -order MS"


@dataclass(frozen=True)
class _Record:
    line: int
    kind: int
    address: int
    data: bytes


def read_intel_hex(path: Path, data: bytes) -> tuple[str, list[Block]]:
    """Return the name of the format and the program's blocks. InputError names the line."""
    records = [
        _record(path, number, line.strip())
        for number, line in enumerate(data.decode("ascii", "replace").splitlines(), start=1)
        if line.strip()
    ]
    if not records or records[-1].kind != END:
        raise InputError(f"{path}: ends without an end record (:00000001FF): it is cut short")
    base = 0
    placed: list[tuple[_Record, int]] = []
    for record in records[:-1]:
        if record.kind == END:
            raise InputError(f"{path}: line {record.line}: an end record before the end")
        if record.kind in (SEGMENT, LINEAR):
            base = int.from_bytes(record.data, "big") << (4 if record.kind == SEGMENT else 16)
        if record.kind == DATA:
            placed.append((record, base + record.address))
    _check_word_addresses(path, placed)
    return "Intel HEX", _blocks(path, placed)


def _record(path: Path, number: int, text: str) -> _Record:
    where = f"{path}: line {number}"
    if not text.startswith(":"):
        raise InputError(f"{where}: a record begins with ':', not {text[:1]!r}")
    try:
        raw = bytes.fromhex(text[1:])
    except ValueError:
        raise InputError(f"{where}: not hexadecimal digits in pairs") from None
    if len(raw) < 5 or len(raw) != 5 + raw[0]:
        raise InputError(f"{where}: the record's length is not that in its first byte")
    if sum(raw) % 256:
        raise InputError(f"{where}: wrong checksum")
    if raw[3] > LINEAR_START:
        raise InputError(f"{where}: unknown record type {raw[3]:02X}h")
    return _Record(number, raw[3], int.from_bytes(raw[1:3], "big"), raw[4:-1])


def _check_word_addresses(path: Path, placed: list[tuple[_Record, int]]) -> None:
    pairs = list(itertools.pairwise(placed))
    if pairs and all(at + len(record.data) == after for (record, at), (_, after) in pairs):
        raise InputError(f"{path}: its addresses count bytes; {_RIGHT}")
    for record, _ in placed:
        if len(record.data) % 2:
            raise InputError(f"{path}: line {record.line}: half a word; {_RIGHT}")


def _blocks(path: Path, placed: list[tuple[_Record, int]]) -> list[Block]:
    """Join records that follow each other."""
    blocks: list[Block] = []
    for record, address in placed:
        halves = record.data
        words = tuple(halves[i] << 8 | halves[i + 1] for i in range(0, len(halves), 2))
        if blocks and blocks[-1].end == address:
            last = blocks.pop()
            blocks.append(Block(last.name, last.address, last.words + words))
        else:
            blocks.append(Block(f"line {record.line}", address, words))
    return blocks
