"""Mutation score of the control modules: how many small changes of the code the tests notice.

Mutants are made by universalmutator and drawn at random, the same ones at each run. One that does
not compile, or compiles to the same code as the original or as another mutant, is none. Each is
linked into the tests, the quick ones first, until one fails; a test that needs more than ten times
its processor time has failed. Prints the survivors; MUTATION.md explains them.

Example: python tests/firmware/mutation.py UNITY_FOLDER 30 traction motor
         (30 mutants of each of these modules; without names of all)
"""

import os
import random
import resource
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
# In order of the time they take; the last has no Unity.
TESTS = (
    *("test_wheel", "test_supervisor", "test_slip_observer", "test_arithmetic"),
    *("test_outside_pose", "test_link", "test_robot", "test_safe_states", "test_pose_control"),
    *("test_control_loop", "test_impact", "test_motion"),
    "fixed_point_error",
)
GOAL = 0.9


def compile_module(source: Path, folder: Path) -> bytes | None:
    """The object code, which stays in the folder; None when it does not compile."""
    shutil.copy(source, folder / "module.c")  # the name goes into the object
    command = ["gcc", "-O1", "-fPIC", "-w", f"-I{ROOT}", "-c", "module.c"]
    if subprocess.run(command, cwd=folder, capture_output=True).returncode != 0:
        return None
    return (folder / "module.o").read_bytes()


def build(folder: Path, unity: Path) -> None:
    """The tests, to be linked to a shared library of the firmware."""
    flags = ["-O1", "-fPIC", f"-I{ROOT}", f"-I{unity}", "-DUNITY_INCLUDE_DOUBLE", CONVERSATION]
    run("gcc", *flags, "-c", *sorted((ROOT / "firmware").glob("*.c")), cwd=folder)
    firmware = sorted(folder.glob("*.o"))
    run("gcc", "-shared", *firmware, "-o", "libfirmware.so", cwd=folder)
    for test in TESTS:
        frame = [unity / "unity.c"] if test.startswith("test_") else []
        run(
            *("gcc", *flags, HERE / f"{test}.c", *PLANTS, *frame, "-L."),
            *("-lfirmware", "-lm", "-Wl,-rpath,.,--export-dynamic", "-o", test),
            cwd=folder,
        )


def link(folder: Path, instead_of: str) -> None:
    """The library with module.o in the place of this module."""
    objects = [path for path in folder.glob("*.o") if path.stem not in ("module", instead_of)]
    run("gcc", "-shared", *objects, "module.o", "-o", "libfirmware.so", cwd=folder)


def passes(test: str, folder: Path, limit_s: int) -> bool:
    """Whether the test passes within this processor time."""
    return (
        subprocess.run(
            [f"./{test}"],
            cwd=folder,
            capture_output=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s)),
        ).returncode
        == 0
    )


def time_limits(folder: Path) -> dict[str, int]:
    """Ten times the processor time of each test on the firmware as it is, s, rounded up."""
    limits = {}
    for test in TESTS:
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        if not passes(test, folder, 600):
            raise RuntimeError(f"{test} fails without any change")
        used_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        limits[test] = int(10 * used_s) + 1
    return limits


def mutants_of(module: str, folder: Path) -> list[Path]:
    """All mutants in random order."""
    into = folder / f"mutants_{module}"
    into.mkdir()
    run(
        *(Path(sys.executable).parent / "mutate", ROOT / f"firmware/{module}.c", "c"),
        *("--noCheck", "--mutantDir", into),
        cwd=folder,
    )
    mutants = sorted(into.iterdir())
    random.Random(module).shuffle(mutants)
    return mutants


def change_of(module: str, mutant: Path) -> str:
    """The line that differs, as it is and as it was made."""
    before = (ROOT / f"firmware/{module}.c").read_text().splitlines()
    after = mutant.read_text().splitlines()
    for number, (old, new) in enumerate(zip(before, after, strict=False), start=1):
        if old != new:
            return f"{module}.c:{number}: {old.strip()}  ->  {new.strip()}"
    return f"{module}.c: end"


def score(module: str, folder: Path, limits: dict[str, int], number: int) -> tuple[int, int]:
    """Mutants noticed and mutants made."""
    codes = {compile_module(ROOT / f"firmware/{module}.c", folder)}
    noticed = made = 0
    for mutant in mutants_of(module, folder):
        code = compile_module(mutant, folder)
        if code is None or code in codes:
            continue
        codes.add(code)
        made += 1
        link(folder, module)
        if all(passes(test, folder, limits[test]) for test in TESTS):
            print("survives", change_of(module, mutant), flush=True)
        else:
            noticed += 1
        if made == number:
            break
    compile_module(ROOT / f"firmware/{module}.c", folder)
    link(folder, module)
    print(f"{noticed:4d} of {made:4d}  {module}", flush=True)
    return noticed, made


def main() -> int:
    unity, number = Path(sys.argv[1]).resolve(), int(sys.argv[2])
    os.nice(10)
    noticed = made = 0
    with TemporaryDirectory() as name:
        folder = Path(name)
        build(folder, unity)
        limits = time_limits(folder)
        for module in sys.argv[3:] or MODULES:
            noticed_here, made_here = score(module, folder, limits, number)
            noticed += noticed_here
            made += made_here
    print(f"{noticed:4d} of {made:4d}  mutants noticed, {100 * noticed / made:.1f} %")
    return 0 if noticed >= GOAL * made else 1


if __name__ == "__main__":
    sys.exit(main())
