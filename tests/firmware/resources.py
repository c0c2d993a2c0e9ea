"""What the firmware takes of a small processor: data memory, stack, instructions of a tick.

Data memory is counted on an AVR, whose `int`, pointers and enumerations have 16 bits as those of
the TMS320LF2407A: two bytes there are one word here. The stack is the deepest path through the call
graph, which has no cycle and no pointer to a function, with the frames of a 32-bit x86 (-m32 -Os).
Two of its bytes are taken for one word, a safe guess but not the TI compiler's own figure: an `int`
or a pointer takes two words there and one here. Instructions are those of this PC (valgrind's
callgrind) over the drive of golden_drive.c.

Example: python tests/firmware/resources.py
"""

import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
HERE = ROOT / "tests/firmware"
SOURCES = sorted((ROOT / "firmware").glob("*.c"))
RAM_LIMIT_WORDS = 2000
ENTRIES = ("robot_init", "robot_tick")


def run(*command: str, cwd: Path) -> str:
    """What the command prints; it must succeed."""
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=True).stdout


def data_words() -> dict[str, int]:
    """Words of the robot and of the static data of each file that has any."""
    words = {}
    with TemporaryDirectory() as folder:
        where = Path(folder)
        (where / "robot.c").write_text('#include "firmware/robot.h"\nrobot the_robot;\n')
        for source in (where / "robot.c", *SOURCES):
            run(
                *("avr-gcc", "-mmcu=atmega1280", "-Os", f"-I{ROOT}", "-fno-common"),
                *("-c", str(source), "-o", "part.o"),
                cwd=where,
            )
            sections = run("avr-size", "-A", "part.o", cwd=where)
            size = sum(map(int, re.findall(r"^\.(?:data|bss|rodata)\S*\s+(\d+)", sections, re.M)))
            name = "struct robot" if source.parent == where else f"tables of {source.name}"
            if size > 0:
                words[name] = (size + 1) // 2
    return words


def call_graph() -> tuple[dict[str, int], dict[str, set[str]]]:
    """Bytes of the frame of each function, and the functions it calls."""
    frame: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    with TemporaryDirectory() as folder:
        for source in SOURCES:
            run(
                *("gcc", "-m32", "-Os", "-ffreestanding", "-fno-pic", "-fcallgraph-info=su"),
                *("-D_LIBC_LIMITS_H_", f"-I{ROOT}", "-c", str(source), "-o", "part.o"),
                cwd=Path(folder),
            )
            (graph,) = Path(folder).glob("*.ci")
            text = graph.read_text()
            graph.unlink()
            bounded = r"(\d+) bytes \((?:static|dynamic,bounded)\)"
            for title, size in re.findall(
                r'node: \{ title: "([^"]+)" label: "[^"]*?' + bounded, text
            ):
                frame[title] = int(size) + 4  # and the return address
            for caller, called in re.findall(
                r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text
            ):
                calls.setdefault(caller, set()).add(called)
    assert "__indirect_call" not in {name for names in calls.values() for name in names}
    return frame, calls


def deepest(entry: str) -> tuple[int, list[str]]:
    """Bytes of the deepest path from a function and the functions on it; RecursionError when the
    graph has a cycle."""
    frame, calls = call_graph()

    def below(name: str, path: tuple[str, ...]) -> tuple[int, list[str]]:
        if name in path:
            raise RecursionError(" -> ".join((*path, name)))
        paths = [below(called, (*path, name)) for called in sorted(calls.get(name, ()))]
        depth, way = max(paths, default=(0, []))
        return depth + frame.get(name, 0), [name.split(":")[-1], *way]

    return below(entry, ())


def tick_instructions() -> dict[str, int]:
    """Instructions per tick of the largest functions, what they call included."""
    with TemporaryDirectory() as folder:
        where = Path(folder)
        run(
            *("gcc", "-O2", "-g", "-fno-inline", f"-I{ROOT}", "-o", "drive"),
            *(str(HERE / "golden_drive.c"), str(HERE / "integer_hal.c"), *map(str, SOURCES)),
            cwd=where,
        )
        run(
            *("valgrind", "--tool=callgrind", "--callgrind-out-file=out", "./drive"),
            cwd=where,
        )
        listing = run("callgrind_annotate", "--inclusive=yes", "--threshold=100", "out", cwd=where)
    found = re.findall(r"^\s*([\d,]+) \([ \d.]+%\)\s+\S*?:(\w+)", listing, re.M)
    total = {name: int(count.replace(",", "")) for count, name in found}
    return {name: count // 12000 for name, count in total.items()}


def main() -> int:
    words = data_words()
    for name, count in words.items():
        print(f"{count:6d} words  {name}")
    stack = 0
    for entry in ENTRIES:
        depth, path = deepest(entry)
        stack = max(stack, depth // 2)
        print(f"{depth // 2:6d} words  stack of {entry}: {' > '.join(path)}")
    total = sum(words.values()) + stack
    print(f"{total:6d} words  in all, of {RAM_LIMIT_WORDS}")
    ticks = tick_instructions()
    text = "".join(source.read_text() for source in SOURCES)
    for name in sorted(ticks, key=ticks.get, reverse=True):
        if ticks[name] >= 500 and f" {name}(" in text:
            print(f"{ticks[name]:6d} instructions per tick  {name}")
    return 0 if total <= RAM_LIMIT_WORDS else 1


if __name__ == "__main__":
    sys.exit(main())
