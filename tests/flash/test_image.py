"""Program files: what is read, what is refused, and with which line."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.errors import InputError
from omnislip.flash.commands import read_image
from program_files import BSS, COPY, coff, intel_hex, record, section

WORDS = [0x7980, 0x0044, 0xBE41, 0xBC00]
RAM = section(".text", 0x8000, WORDS)
VECTORS = section("vectors", 0x0000, [0x7980, 0x0044] * 32)


@pytest.fixture
def image(tmp_path):
    def read(contents):
        path = tmp_path / "program.out"
        path.write_bytes(contents if isinstance(contents, bytes) else contents.encode())
        return read_image(path)

    return read


def blocks(read):
    return [(b.name, b.address, list(b.words), b.region.name) for b in read.blocks]


@pytest.mark.parametrize("version", [0, 1, 2])
def test_coff(version, image):
    read = image(coff(version, [section("a_long_name", 0x8100, [1, 2, 3]), RAM]))
    assert read.format == f"TI COFF {version}"
    assert blocks(read) == [
        (".text", 0x8000, WORDS, "SARAM"),
        ("a_long_name", 0x8100, [1, 2, 3], "SARAM"),
    ]
    assert read.for_ram


def test_coff_0_is_also_marked_by_its_target(image):
    assert image(coff(0, [RAM], magic=0x92)).format == "TI COFF 0"


def test_sections_that_are_not_loaded_are_left_out(image):
    bss = section(".bss", 0x0800, [], BSS, page=1, size=200)
    copied = section(".cinit", 0x0100, [1, 2], COPY)
    assert [b.name for b in image(coff(1, [bss, copied, RAM])).blocks] == [".text"]


def test_flash_and_vectors(image):
    read = image(coff(1, [VECTORS, section(".text", 0x44, [1] * 100)]))
    assert [b.region.name for b in read.blocks] == ["flash", "flash"]
    assert not read.for_ram


def test_intel_hex(image):
    words = list(range(1000, 1021))
    read = image(intel_hex(0x8000, words))
    assert blocks(read) == [("line 1", 0x8000, words, "SARAM")]


def test_intel_hex_with_upper_addresses_and_holes(image):
    text = record(0, bytes(2), 4) + record(0x8000, b"\x12\x34") + record(0x8010, b"\x56\x78")
    read = image(text + record(0, b"", 1))
    assert [(b.address, list(b.words)) for b in read.blocks] == [
        (0x8000, [0x1234]),
        (0x8010, [0x5678]),
    ]


def test_blank_password_words_are_allowed(image):
    assert image(coff(1, [section("passwds", 0x40, [0xFFFF] * 4), RAM])).blocks[0].address == 0x40


GOOD_HEX = intel_hex(0x8000, list(range(100)))
REFUSED = {
    "password": (
        coff(1, [section(".text", 0x0030, [0x1234] * 32)]),
        ".text writes 0040h, a word of the flash password",
    ),
    "last password word": (
        coff(1, [section("passwds", 0x43, [0])]),
        "passwds writes 0043h, a word of the flash password",
    ),
    "password in hex": (intel_hex(0x0042, [1]), "line 1 writes 0042h"),
    "overlap": (
        coff(1, [RAM, section(".cinit", 0x8003, [1, 2])]),
        ".text and .cinit both have address 8003h",
    ),
    "no memory": (
        coff(1, [section(".text", 0x9000, WORDS)]),
        ".text at 9000h-9003h does not lie in one memory",
    ),
    "over the edge": (
        coff(1, [section(".text", 0x87FE, WORDS)]),
        ".text at 87FEh-8801h does not lie in one memory",
    ),
    "beyond 64 K": (coff(1, [section(".text", 0x18000, WORDS)]), "does not lie in one memory"),
    "data page": (
        coff(1, [RAM, section(".const", 0x300, [5], page=1)]),
        "section .const is to be loaded into page 1",
    ),
    "other target": (coff(1, [RAM], target=0x98), "made for target 0098h, not 0092h"),
    "not linked": (coff(1, [RAM], flags=0x0100), "not linked"),
    "relocations": (
        coff(1, [section(".text", 0x8000, WORDS, relocations=2)]),
        "section .text is not relocated",
    ),
    "big-endian": (coff(1, [RAM], flags=0x0203), "a big-endian COFF file"),
    "nothing": (coff(1, [section(".bss", 0x800, [], BSS, size=3)]), "nothing to load"),
    "cut section": (coff(2, [RAM])[:-10], "ends within section .text"),
    "cut headers": (coff(2, [RAM])[:60], "ends within the section headers"),
    "cut header": (coff(2, [RAM])[:15], "ends within the file header"),
    "swapped bytes": (intel_hex(0x0000, [0x8079, 0x4400]), "bytes of each word are changed over"),
    "no program": (b"\x7fELF", "neither TI COFF for target 0092h"),
    "empty": (b"", "neither TI COFF for target 0092h"),
    "bytes as addresses": (
        intel_hex(0x4000, list(range(100)), addresses_per_record=16),
        "its addresses count bytes",
    ),
    "half a word": (record(0x8000, b"\x12\x34\x56") + record(0, b"", 1), "line 1: half a word"),
    "checksum": (":0280000012340F\n", "line 1: wrong checksum"),
    "length": (":020000000000\n", "line 1: the record's length"),
    "no colon": (":00000001FF\n10000\n", "line 2: a record begins with ':'"),
    "no digits": (":0G000001FF\n", "line 1: not hexadecimal digits"),
    "no end": (GOOD_HEX.replace(":00000001FF\n", ""), "ends without an end record"),
    "two ends": (GOOD_HEX + GOOD_HEX, "an end record before the end"),
    "unknown record": (record(0, b"", 7) + record(0, b"", 1), "unknown record type 07h"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, image):
    contents, expected = REFUSED[case]
    with pytest.raises(InputError) as error:
        image(contents)
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none\.out: cannot be read"):
        read_image(tmp_path / "none.out")


@given(st.binary(max_size=200), st.sampled_from([b"\xc0\0", b"\xc1\0", b"\xc2\0", b"\x92\0", b":"]))
def test_noise_is_refused_in_one_line(tmp_path_factory, noise, begin):
    path = tmp_path_factory.getbasetemp() / "noise"
    path.write_bytes(begin + noise)
    try:
        read_image(path)
    except InputError as error:
        assert "\n" not in str(error)


@given(st.data())
def test_a_damaged_coff_file_is_read_or_refused(data):
    """One byte of a good file changed: an image within its memories, or one line."""
    import tempfile
    from pathlib import Path

    whole = bytearray(coff(2, [RAM, section("a_long_name", 0x8100, [1, 2, 3])]))
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "program.out"
        path.write_bytes(whole)
        try:
            read = read_image(path)
        except InputError:
            return
    assert all(block.region is not None for block in read.blocks)


@given(st.integers(0x8000, 0x87F0), st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=16))
def test_coff_and_hex_of_the_same_program_are_the_same(address, words):
    from pathlib import Path

    from omnislip.flash.coff import read_coff
    from omnislip.flash.intel_hex import read_intel_hex

    path = Path("x")
    _, (of_coff,) = read_coff(path, coff(1, [section(".text", address, words)]))
    _, (of_hex,) = read_intel_hex(path, intel_hex(address, words).encode())
    assert (
        (of_coff.address, of_coff.words)
        == (of_hex.address, of_hex.words)
        == (
            address,
            tuple(words),
        )
    )
