"""Program files as TI's linker and converter write them, and wrong ones."""

import struct

TEXT, BSS, COPY = 0x20, 0x80, 0x10


def section(name, address, words=(), flags=TEXT, page=0, relocations=0, size=None):
    return {
        "name": name,
        "address": address,
        "words": list(words),
        "flags": flags,
        "page": page,
        "relocations": relocations,
        "size": len(words) if size is None else size,
    }


def coff(version, sections, target=0x92, flags=0x0103, optional=28, magic=None):
    """The bytes of a COFF file; long names of sections go to a string table."""
    head_bytes = 20 if version == 0 else 22
    entry_bytes = 48 if version == 2 else 40
    data_at = head_bytes + optional + entry_bytes * len(sections)
    headers, data, strings = b"", b"", b""
    for s in sections:
        raw = struct.pack(f"<{len(s['words'])}H", *s["words"])
        name = s["name"].encode()
        if len(name) > 8:
            stored, strings = struct.pack("<II", 0, 4 + len(strings)), strings + name + b"\0"
        else:
            stored = name.ljust(8, b"\0")
        at = data_at + len(data) if raw else 0
        headers += stored + struct.pack("<IIIIII", s["address"], s["address"], s["size"], at, 0, 0)
        tail = "<IIIHH" if version == 2 else "<HHHBB"
        headers += struct.pack(tail, s["relocations"], 0, s["flags"], 0, s["page"])
        data += raw
    magic = magic or (0xC1 if version == 1 else 0xC2 if version == 2 else 0xC0)
    head = struct.pack("<HHIIIHH", magic, len(sections), 0, data_at + len(data), 0, optional, flags)
    if version > 0:
        head += struct.pack("<H", target)
    table = struct.pack("<I", 4 + len(strings)) + strings
    return head + b"\0" * optional + headers + data + table


def record(address, data, kind=0):
    raw = bytes([len(data), address >> 8 & 255, address & 255, kind]) + data
    return f":{raw.hex().upper()}{-sum(raw) % 256:02X}\n"


def intel_hex(address, words, per_record=8, addresses_per_record=None):
    """Intel HEX with addresses of words; `addresses_per_record`: for files that count otherwise."""
    text = ""
    step = addresses_per_record or per_record
    for number, begin in enumerate(range(0, len(words), per_record)):
        piece = words[begin : begin + per_record]
        text += record(address + number * step, struct.pack(f">{len(piece)}H", *piece))
    return text + record(0, b"", 1)
