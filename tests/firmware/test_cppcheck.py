"""cppcheck and its MISRA addon find nothing in the firmware but what firmware/MISRA.md explains."""

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
PLATFORM = ROOT / "tests/firmware/lf2407a.platform.xml"


def findings() -> dict[str, list[str]]:
    """Places by kind of finding."""
    command = [
        "cppcheck",
        "--quiet",
        "--std=c89",
        f"--platform={PLATFORM}",
        "--enable=warning,style,performance,portability",
        "--inconclusive",
        "--addon=misra",
        "-I.",
        "-DINT_MAX=32767",
        "--template={id} {file}:{line} {message}",
        *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "firmware").glob("*.c")),
    ]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    places: dict[str, list[str]] = {}
    for line in run.stderr.splitlines():
        kind, place = line.split(maxsplit=1)
        places.setdefault(kind, []).append(place)
    return places


def deviations() -> dict[str, str]:
    """Numbers of deviations by the kind of finding they explain."""
    rows = re.findall(
        r"^\| (D\d+) \| (\S+) \| \S.* \|$", (ROOT / "firmware/MISRA.md").read_text(), re.M
    )
    assert [number for number, _ in rows] == [f"D{i + 1}" for i in range(len(rows))]
    return {kind: number for number, kind in rows}


def test_findings_are_the_deviations():
    found = findings()
    allowed = deviations()
    unexplained = {kind: places for kind, places in found.items() if kind not in allowed}
    assert not unexplained
    assert sorted(allowed) == sorted(found), "a deviation that nothing needs any more"


def test_a_seeded_mistake_is_found(tmp_path):
    mistake = tmp_path / "mistake.c"
    mistake.write_text(
        "int f(void);\nint f(void) {\n    int a[2];\n    a[2] = 0;\n    return a[2];\n}\n"
    )
    run = subprocess.run(
        ["cppcheck", "--quiet", f"--platform={PLATFORM}", str(mistake)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "arrayIndexOutOfBounds" in run.stderr
