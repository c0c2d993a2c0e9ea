"""Programs for flash sectors: which sectors, and the steps with the tools that write them."""

import json

import pytest
from omnislip.flash.image import FLASH_SECTORS, Block, make_image
from omnislip.flash.sectors import HOST_PROGRAMS, KERNEL_FILES, ways
from program_files import coff, intel_hex, section

FIRMWARE = coff(1, [section("vectors", 0, [0x7980, 0x44] * 32), section(".text", 0x44, [1] * 9000)])


@pytest.fixture
def firmware(tmp_path):
    path = tmp_path / "omnislip.out"
    path.write_bytes(FIRMWARE)
    return path


@pytest.fixture
def package(tmp_path):
    """A folder with the names of TI's package, as an old Windows spells them."""
    folder = tmp_path / "SFLASH"
    folder.mkdir()
    for name in (*KERNEL_FILES, HOST_PROGRAMS[1]):
        (folder / name.upper()).write_text("")
    return folder


def image(*blocks):
    return make_image("x.out", "test", [Block(f"b{a:x}", a, (7,) * n) for a, n in blocks])


@pytest.mark.parametrize(
    ("blocks", "expected"),
    [
        ([(0x0FFF, 1)], [0]),
        ([(0x0FFF, 2)], [0, 1]),
        ([(0x1000, 1), (0x7000, 1)], [1, 3]),
        ([(0x0044, 0x7FBC)], [0, 1, 2, 3]),
        ([(0x8000, 1)], []),
        ([(0xFF00, 1)], []),
    ],
)
def test_sectors_that_hold_something(blocks, expected):
    assert image(*blocks).flash_sectors == expected


def test_the_sectors_are_all_of_the_flash_in_order():
    assert [n for sector in FLASH_SECTORS for n in sector] == list(range(0x8000))


def test_a_program_in_ram_needs_no_other_tool():
    assert ways(image((0x8000, 3))) == []


def test_the_tools_are_named_with_their_steps(omnislip, firmware):
    status, output, _ = omnislip("flash", firmware)
    assert status == 0
    assert "flash sectors: 0 (0000h-0FFFh), 1 (1000h-3FFFh)" in output
    assert "dsphex -romwidth 16 -memwidth 16 -i -o omnislip.hex omnislip.out" in output
    assert "--kernel FOLDER" in output
    assert "prg2xxw95 -p 240 -w 6 c2xx_bpX.out omnislip.out" in output


def test_the_steps_with_the_package_of_the_user(omnislip, firmware, package):
    status, output, _ = omnislip("flash", firmware, "--kernel", package)
    assert status == 0
    steps = [line.strip() for line in output.splitlines() if line.strip()[:2] in "1 2 3 4 "]
    assert f"copy {firmware} to {package} as omnisli.out" in steps[0]  # names of at most 7
    assert "f240_hex omnisli.out" in steps[1]
    assert "COM2" in steps[2] and "BOOT_EN" in steps[2]
    assert steps[3].endswith("serhost2 omnisli.hex")
    assert "nothing has been sent to the chip" in output


def test_the_steps_for_machines(omnislip, firmware, package):
    found = json.loads(omnislip("flash", firmware, "--kernel", package, "--json").stdout)
    assert found["flash_sectors"] == [0, 1]
    assert any("f240_hex omnisli.out" in step for step in found["steps"])


def refused(ended):
    status, output, errors = ended
    assert status == 2 and output == "" and errors.count("\n") == 1
    return errors


@pytest.mark.parametrize("missing", [*KERNEL_FILES, HOST_PROGRAMS[1]])
def test_a_file_of_the_package_that_is_missing_is_named(omnislip, firmware, package, missing):
    (package / missing.upper()).unlink()
    errors = refused(omnislip("flash", firmware, "--kernel", package))
    assert "not TI's serial programmer SPRC074" in errors and missing in errors


def test_what_the_package_cannot_do_is_refused(omnislip, firmware, package, tmp_path):
    assert "none: cannot be read" in refused(
        omnislip("flash", firmware, "--kernel", tmp_path / "none")
    )
    newer = tmp_path / "newer.out"
    newer.write_bytes(coff(2, [section(".text", 0x44, [1])]))
    assert "is TI COFF 2; f240_hex reads COFF version 1 only" in refused(
        omnislip("flash", newer, "--kernel", package)
    )
    hex_file = tmp_path / "program.hex"
    hex_file.write_text(intel_hex(0x0044, [1, 2, 3]))
    assert "is Intel HEX" in refused(omnislip("flash", hex_file, "--kernel", package))
    monitor = tmp_path / "monitor.out"
    monitor.write_bytes(coff(1, [section(".text", 0x8000, [1])]))
    assert "goes to RAM; --port loads it" in refused(
        omnislip("flash", monitor, "--kernel", package)
    )
    assert "protocol of TI's kernel was never published" in refused(
        omnislip("flash", firmware, "--kernel", package, "--port", "COM1")
    )
