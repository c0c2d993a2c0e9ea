"""Mutation score of the control modules: how many small changes of the code the Unity tests notice.

Mutants are made by universalmutator and drawn at random, the same ones at each run. One that does
not compile, or compiles to the same code, is no mutant. Prints the survivors; those that were
looked into are explained in MUTATION.md.

Example: python tests/firmware/mutation.py UNITY_FOLDER 20      (20 mutants of each module)
"""

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from branch_coverage import CONVERSATION, HERE, PLANTS, ROOT, run

MODULES = (
    *("contact", "control_loop", "fixed_point", "kinematics", "motor", "odometry"),
    *("outside_pose", "slip_observer", "supervisor", "traction", "trajectory"),
    *("wheel_monitor", "wheel_pid", "wheel_speed"),
)
TESTS = (
    *("arithmetic", "wheel", "motion", "slip_observer", "supervisor", "outside_pose"),
    *("control_loop", "link", "robot"),
)
LONGEST_TEST_S = 60


def compile_module(source: Path, folder: Path) -> bytes | None:
    """The object code, which stays in the folder; None when it does not compile."""
    shutil.copy(source, folder / "module.c")  # the name goes into the object
    command = ["gcc", "-O1", "-fPIC", "-w", f"-I{ROOT}", "-c", "module.c"]
    if subprocess.run(command, cwd=folder, capture_output=True).returncode != 0:
        return None
    return (folder / "module.o").read_bytes()


def build(folder: Path, unity: Path) -> None:
    """The tests, linked to a shared library of the firmware."""
    flags = ["-O1", "-fPIC", f"-I{ROOT}", f"-I{unity}", "-DUNITY_INCLUDE_DOUBLE", CONVERSATION]
    run("gcc", *flags, "-c", *sorted((ROOT / "firmware").glob("*.c")), cwd=folder)
    firmware = sorted(folder.glob("*.o"))
    run("gcc", "-shared", *firmware, "-o", "libfirmware.so", cwd=folder)
    for test in TESTS:
        run(
            *("gcc", *flags, HERE / f"test_{test}.c", *PLANTS, unity / "unity.c", "-L."),
            *("-lfirmware", "-lm", "-Wl,-rpath,.,--export-dynamic", "-o", f"test_{test}"),
            cwd=folder,
        )


def noticed(module: str, folder: Path) -> bool:
    """Whether a test fails with module.o in the place of the module."""
    objects = [path for path in folder.glob("*.o") if path.stem not in ("module", module)]
    run("gcc", "-shared", *objects, "module.o", "-o", "libfirmware.so", cwd=folder)
    for test in TESTS:
        try:
            result = subprocess.run(
                [f"./test_{test}"], cwd=folder, capture_output=True, timeout=LONGEST_TEST_S
            )
        except subprocess.TimeoutExpired:
            return True
        if result.returncode != 0:
            return True
    return False


def mutants_of(module: str, folder: Path, number: int) -> list[Path]:
    """At most `number` mutants, drawn at random."""
    into = folder / f"mutants_{module}"
    into.mkdir()
    run(
        *(Path(sys.executable).parent / "mutate", ROOT / f"firmware/{module}.c", "c"),
        *("--noCheck", "--mutantDir", into),
        cwd=folder,
    )
    mutants = sorted(into.iterdir())
    return random.Random(module).sample(mutants, min(number, len(mutants)))


def change_of(module: str, mutant: Path) -> str:
    """The line that differs, as it is and as it was made."""
    before = (ROOT / f"firmware/{module}.c").read_text().splitlines()
    after = mutant.read_text().splitlines()
    for number, (old, new) in enumerate(zip(before, after, strict=False), start=1):
        if old != new:
            return f"{module}.c:{number}: {old.strip()}  ->  {new.strip()}"
    return f"{module}.c: end"


def main() -> int:
    unity, number = Path(sys.argv[1]).resolve(), int(sys.argv[2])
    os.nice(10)
    killed = made = 0
    with TemporaryDirectory() as name:
        folder = Path(name)
        build(folder, unity)
        for module in MODULES:
            original = compile_module(ROOT / f"firmware/{module}.c", folder)
            if noticed(module, folder):
                raise RuntimeError(f"the tests fail without any change of {module}")
            killed_here = made_here = 0
            for mutant in mutants_of(module, folder, number):
                code = compile_module(mutant, folder)
                if code is None or code == original:
                    continue
                made_here += 1
                if noticed(module, folder):
                    killed_here += 1
                else:
                    print("survives", change_of(module, mutant), flush=True)
            print(f"{killed_here:4d} of {made_here:4d}  {module}", flush=True)
            killed += killed_here
            made += made_here
    print(f"{killed:4d} of {made:4d}  mutants noticed, {100 * killed / made:.1f} %")
    return 0 if killed >= 0.9 * made else 1


if __name__ == "__main__":
    sys.exit(main())
