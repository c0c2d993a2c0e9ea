"""What can be checked of the LF2407A build without TI's compiler: language, storage, memory map."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DRIVERS = ROOT / "hal/lf2407a"
SOURCES = sorted(DRIVERS.glob("*.c")) + sorted((ROOT / "firmware").glob("*.c"))
STRICT = ["-std=c89", "-pedantic", "-Wall", "-Wextra", "-Wdeclaration-after-statement", "-I", ROOT]
# What only TI's compiler knows, so that another one can read the sources as they go to the chip.
TI_WORDS = ["-Dioport=", "-Dinterrupt=", "-Dasm(x)=((void)0)"]
DATA_RAM_WORDS = 2048  # SARAM
STACK_WORDS = 512  # blocks B0 and B1
FLASH_WORDS = 0x7FBC


def section_bytes(size_tool: str, target: Path) -> dict[str, int]:
    """Size of each section of an object file."""
    table = subprocess.run([size_tool, "-A", target], check=True, capture_output=True, text=True)
    return {n: int(size) for n, size in re.findall(r"^(\.\S+)\s+(\d+)", table.stdout, re.MULTILINE)}


def compile_with(compiler: str, source: Path, target: Path, *flags: str) -> None:
    subprocess.run([compiler, *STRICT, *flags, "-c", source, "-o", target], check=True)


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_no_object_needs_constant_storage(source: Path, tmp_path: Path):
    """TI's compiler puts const objects and string literals where the chip has no memory."""
    target = tmp_path / "object.o"
    compile_with("cc", source, target, "-O0", "-fno-jump-tables", "-DOMNISLIP_VIRTUAL_BOARD")
    sections = section_bytes("size", target)
    assert not {name for name, size in sections.items() if name.startswith(".rodata") and size}


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="needs gcc-avr")
def test_it_fits_the_chip_as_far_as_another_16_bit_compiler_can_tell(tmp_path: Path):
    """RAM to the word: every datum has 16 or 32 bits on both. Code: only the order of magnitude."""
    ram_bytes = code_bytes = 0
    for source in SOURCES:
        target = tmp_path / "object.o"
        compile_with("avr-gcc", source, target, "-Os", "-mmcu=atmega1280", *TI_WORDS)
        for name, size in section_bytes("avr-size", target).items():
            ram_bytes += size * name.startswith((".data", ".bss", ".rodata"))
            code_bytes += size * name.startswith((".text", ".progmem"))
    ram_words, code_words = ram_bytes // 2, code_bytes // 2
    print(f"RAM {ram_words} of {DATA_RAM_WORDS} words, code about {code_words} of {FLASH_WORDS}")
    assert ram_words < DATA_RAM_WORDS
    assert code_words < FLASH_WORDS


def test_the_image_cannot_reach_the_flash_password():
    command_file = re.sub(r"/\*.*?\*/", "", (DRIVERS / "link.cmd").read_text(), flags=re.DOTALL)
    regions = {
        name: (int(origin, 16), int(length, 16))
        for name, origin, length in re.findall(
            r"(\w+)\s*: origin = (\w+)h, length = (\w+)h", command_file
        )
    }
    placed = dict(re.findall(r"^\s*(\.?\w+)\s*:\s*>\s*(\w+)\s*PAGE 0", command_file, re.MULTILINE))
    assert set(placed) == {"vectors", ".text", ".cinit", ".switch"}
    for region in placed.values():
        origin, length = regions[region]
        assert origin + length <= 0x40 or origin >= 0x44
    assert regions["SARAM"] == (0x0800, DATA_RAM_WORDS)
    assert regions["DARAM"] == (0x0200, STACK_WORDS)
    stack = re.search(r"-stack (\w+)", command_file)
    assert stack is not None
    assert int(stack[1], 16) == STACK_WORDS


def test_every_vector_goes_where_the_virtual_board_goes():
    table = re.search(r'"vectors"\n(.*?)\.text', (DRIVERS / "vectors.asm").read_text(), re.DOTALL)
    assert table is not None
    targets = re.findall(r"^\s+B\s+(\w+)\s*; (\w\w)", table[1], re.MULTILINE)
    assert [int(address, 16) for _, address in targets] == list(range(0, 0x40, 2))
    routines = {int(a, 16): t for t, a in targets if t != "trap"}
    assert routines == {0x00: "start", 0x06: "_board_int3", 0x0A: "_board_int5"}
    vectors = (ROOT / "sim/board/board_hal.cpp").read_text()
    assert "{nullptr, nullptr, board_int3, nullptr, board_int5, nullptr}" in vectors


STAND_IN = """#!/bin/sh
echo "$(basename "$0") $*" >> "$TI_LOG"
for word in "$@"; do
    case "$word" in
        -fo*) : > "${word#-fo}" ;;
        -fr=*) : > "${word#-fr=}/vectors.obj" ;;
    esac
done
"""


@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs cmake")
def test_the_toolchain_file_asks_for_every_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """With stand-ins for TI's tools that only write down how they were called."""
    for name in ("dspcl", "dsplnk"):
        tool = tmp_path / "bin" / name
        tool.parent.mkdir(exist_ok=True)
        tool.write_text(STAND_IN)
        tool.chmod(0o755)
    monkeypatch.setenv("C24X_ROOT", str(tmp_path))
    monkeypatch.setenv("TI_LOG", str(tmp_path / "log"))
    build = tmp_path / "build"
    toolchain = f"-DCMAKE_TOOLCHAIN_FILE={DRIVERS / 'dspcl.cmake'}"
    for command in (["-G", "Ninja", "-S", DRIVERS, "-B", build, toolchain], ["--build", build]):
        subprocess.run(["cmake", *command], check=True, capture_output=True)
    calls = (tmp_path / "log").read_text().splitlines()
    compiled = {Path(call.split()[-1]).name for call in calls if "dspcl" in call.split()[0]}
    assert compiled == {source.name for source in SOURCES} | {"vectors.asm"}
    link = next(call for call in calls if call.startswith("dsplnk"))
    assert link.endswith("link.cmd")
    assert all(f"{source.name}.obj" in link for source in SOURCES)
