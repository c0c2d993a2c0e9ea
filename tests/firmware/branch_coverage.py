"""Branch coverage of the firmware by its Unity tests.

Compiles the firmware once with gcc's --coverage and links each test with it; prints the share of
branches taken per file and every branch that no test takes. Exit status 1 below the limit.

Example: python tests/firmware/branch_coverage.py UNITY_FOLDER
"""

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
HERE = ROOT / "tests/firmware"
LIMIT = 0.98
PLANTS = [
    HERE / "reference_plant.c",
    HERE / "closed_loop.c",
    HERE / "robot_bench.c",
    ROOT / "hal/host/hal_host.c",
    ROOT / "hal/host/hal_host_store.c",
]
CONVERSATION = f'-DOMNISLIP_CONVERSATION="{HERE / "link_conversation.txt"}"'


def run(*command: str | Path, cwd: Path) -> str:
    return subprocess.run(
        list(map(str, command)), cwd=cwd, capture_output=True, text=True, check=True
    ).stdout


def run_tests(folder: Path, unity: Path) -> None:
    """Leaves the counters of all tests in the folder."""
    flags = [f"-I{ROOT}", f"-I{unity}", "-DUNITY_INCLUDE_DOUBLE", CONVERSATION]
    firmware = sorted((ROOT / "firmware").glob("*.c"))
    run("gcc", "-O0", "--coverage", *flags, "-c", *firmware, cwd=folder)
    objects = sorted(folder.glob("*.o"))
    run("gcc", "-O1", *flags, "-c", *PLANTS, unity / "unity.c", cwd=folder)
    others = sorted(set(folder.glob("*.o")) - set(objects))
    for test in sorted(HERE.glob("test_*.c")):
        run(
            "gcc",
            "-O1",
            "--coverage",
            *flags,
            test,
            *objects,
            *others,
            "-lm",
            "-o",
            "test",
            cwd=folder,
        )
        run("./test", cwd=folder)


def main() -> int:
    taken = there = 0
    missed = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        run_tests(folder, Path(sys.argv[1]).resolve())
        for source in sorted((ROOT / "firmware").glob("*.c")):
            report = json.loads(
                run("gcov", "--json-format", "--stdout", "-b", f"{source.stem}.gcno", cwd=folder)
            )
            lines = [
                line
                for file in report["files"]
                if Path(file["file"]).parent.name == "firmware"
                for line in file["lines"]
            ]
            counts = [branch["count"] for line in lines for branch in line["branches"]]
            missed += [
                f"{source.name}:{line['line_number']}"
                for line in lines
                for branch in line["branches"]
                if branch["count"] == 0
            ]
            taken += sum(count > 0 for count in counts)
            there += len(counts)
            if counts:
                print(f"{sum(count > 0 for count in counts):4d} of {len(counts):4d}  {source.name}")
    print(f"{taken:4d} of {there:4d}  branches, {100 * taken / there:.1f} %")
    print("never taken:", *missed)
    return 0 if taken >= LIMIT * there else 1


if __name__ == "__main__":
    sys.exit(main())
