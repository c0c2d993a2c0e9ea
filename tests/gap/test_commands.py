"""`omnislip gap ...` on the command line: what it prints, leaves behind, and how it refuses."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from axis_bench import Bench, make_log, model_text
from omnislip.gap import plan as planning
from omnislip.gap.truth import TruthCase, write_case
from omnislip.log_file import Log, write_log
from omnislip.model_file import NOMINAL_ROBOT
from omnislip.scenario import read_scenario
from omnislip.simulate import simulate_truth

ROBOT_TEXT = NOMINAL_ROBOT.read_text()


@pytest.fixture(autouse=True)
def empty_folder(monkeypatch, tmp_path):
    """Every command runs in an empty folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def robot_csv(tmp_path_factory):
    """The text of a log of the generator."""
    folder = tmp_path_factory.mktemp("log")
    write_case(TruthCase(seed=1, runs=1, run_duration_s=1.0), folder)
    return (folder / "run_01.csv").read_text()


def files_below(path):
    return sorted(str(item.relative_to(path)) for item in path.rglob("*"))


# ---- good input ----


@pytest.fixture
def axis_files(tmp_path):
    """A model and six logs of an axis with Coulomb friction of 2 N in the current folder."""
    (tmp_path / "axis.toml").write_text(model_text())
    for seed in range(6):
        write_log(make_log(Bench(coulomb_n=2.0), seed), tmp_path / f"run_{seed:02d}.csv")
    return [f"run_{seed:02d}.csv" for seed in range(6)]


def test_find_says_what_it_found_and_where_it_is(omnislip, axis_files, tmp_path):
    ended = omnislip("gap", "find", "--robot", "axis.toml", "--out", "gap", *axis_files)
    assert ended.status == 0
    words = " ".join(ended.stdout.split())
    said = re.search(r"Missing: coulomb_friction \(force_n ([\d.]+)", words)
    assert float(said[1]) == pytest.approx(2.0, rel=0.02)
    assert "gap/report.html" in ended.stdout
    assert files_below(tmp_path / "gap") == ["gap.json", "report.html", "robot.toml"]
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "effect_found"


def test_find_as_json_prints_what_it_writes(omnislip, axis_files, tmp_path):
    ended = omnislip("gap", "find", "--robot", "axis.toml", "--out", "gap", "--json", *axis_files)
    assert ended.status == 0
    assert json.loads(ended.stdout) == json.loads((tmp_path / "gap" / "gap.json").read_text())


def test_evaluate_judges_the_amended_model_better(omnislip, axis_files):
    omnislip("gap", "find", "--robot", "axis.toml", "--out", "gap", *axis_files)
    rmse = [
        json.loads(omnislip("gap", "evaluate", "--robot", robot, "--json", *axis_files).stdout)[
            "channels"
        ]["axis/position_m"]["rmse"]
        for robot in ("axis.toml", "gap/robot.toml")
    ]
    assert rmse[1] < 0.3 * rmse[0]


def test_results_of_an_earlier_run_are_replaced(omnislip, axis_files, tmp_path):
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "gap.json").write_text("old")
    omnislip("gap", "find", "--robot", "axis.toml", "--out", "gap", *axis_files)
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["schema"] == "omnislip-gap/1"
    assert len(files_below(tmp_path / "gap")) == 3


PATCH = {"x_min_m": 0.2, "x_max_m": 0.6, "scale": 0.5}


def gap_json(folder, name, rival, sizes):
    """A gap.json whose only effect cannot be told from a rival."""
    parameters = {label: {"value": value} for label, value in sizes.items()}
    found = {"name": name, "wheel": None, "parameters": parameters, "ambiguous_with": [rival]}
    path = folder / "gap.json"
    path.write_text(json.dumps({"effects": [found], "gap": None}))
    return path


def test_plan_drives_over_the_patch_that_a_gap_json_names(omnislip, tmp_path):
    path = gap_json(tmp_path, "slippery_patch", "low_grip", PATCH)
    ended = omnislip("gap", "plan", "--robot", NOMINAL_ROBOT, "--out", "plan", "--gap", path)
    assert ended.status == 0
    assert "telling apart slippery_patch, low_grip" in ended.stdout
    [written] = (tmp_path / "plan").iterdir()
    best = read_scenario(written)
    assert f"{best.name}: " in ended.stdout
    assert f"rehearse it: omnislip simulate plan/{written.name}" in ended.stdout
    body_x_m = simulate_truth(best)["pose"][:, 0]
    assert np.any((body_x_m > PATCH["x_min_m"]) & (body_x_m < PATCH["x_max_m"]))


@pytest.mark.parametrize(
    ("separation", "told"),
    [(3.9, "hardly tell them apart"), (4.0, "Drive it 6 times: then it is right in 99 of 100")],
)
def test_plan_says_whether_and_how_often_to_drive(
    separation, told, omnislip, tmp_path, monkeypatch
):
    """A lead of (2 * 2.33)^2 = 21.6 is wrong once in a hundred."""
    drive = planning.Manoeuvre("twist", "twists", 1.0, [])
    ranked = [planning.Separation(drive, separation, 0.0)]
    monkeypatch.setattr(planning, "plan", lambda *_: ranked)
    monkeypatch.setattr(planning, "write_plan", lambda *_: tmp_path / "twist.toml")
    names = ["driver_lag", "actuation_delay"]
    ended = omnislip("gap", "plan", "--robot", NOMINAL_ROBOT, "--out", "plan", *names)
    assert ended.status == 0 and told in ended.stdout


def test_plan_knows_an_effect_that_the_robot_file_defines(omnislip, tmp_path):
    definition = (NOMINAL_ROBOT.parents[1] / "effects" / "cubic_wheel_drag.toml").read_text()
    (tmp_path / "own.toml").write_text(f"{ROBOT_TEXT}\n{definition}")
    names = ["cubic_wheel_drag", "quadratic_wheel_drag"]
    ended = omnislip("gap", "plan", "--robot", "own.toml", "--out", "plan", "--json", *names)
    assert ended.status == 0
    result = json.loads(ended.stdout)
    assert result["effects"] == names
    assert result["manoeuvres"][0]["expected_separation"] > 0
    assert (tmp_path / result["scenario"]).is_file()


COMMANDS = ["find", "plan", "evaluate", "benchmark"]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_gives_an_example(command, omnislip):
    ended = omnislip("gap", command, "--help")
    assert ended.status == 0
    assert f"Example: omnislip gap {command}" in ended.stdout


# ---- too little data ----


def still_log(rows, **columns):
    t_s = np.arange(rows) * 0.005
    values = {f"wheel/{w}/duty": 0.3 * np.sin(5 * t_s) for w in range(1, 5)}
    turned = np.round(-3000 * np.cos(5 * t_s))
    values |= {f"wheel/{w}/encoder_counts": turned for w in range(1, 5)}
    return Log("run", t_s, values | columns)


TOO_LITTLE = {
    "0.2 s": lambda: still_log(40),
    "zeros": lambda: still_log(2000, **{c: np.zeros(2000) for c in still_log(2).columns}),
    "a wheel that never moves": lambda: still_log(
        2000, **{"wheel/2/encoder_counts": np.zeros(2000)}
    ),
    "milliseconds": lambda: replace(still_log(2000), t_s=5.0 * np.arange(2000)),
}


@pytest.mark.parametrize("case", TOO_LITTLE)
def test_too_little_data_is_work_done(case, omnislip, tmp_path):
    write_log(TOO_LITTLE[case](), tmp_path / "run.csv")
    ended = omnislip("gap", "find", "--robot", NOMINAL_ROBOT, "--out", "gap", "run.csv")
    assert ended.status == 0
    assert "Not enough data" in ended.stdout
    assert files_below(tmp_path / "gap") == ["gap.json", "report.html", "robot.toml"]
    result = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert result["verdict"] == "insufficient_data"
    report = (tmp_path / "gap" / "report.html").read_text()
    assert report.rstrip().endswith("</html>")


def test_find_does_not_replace_the_model_that_it_is_given(omnislip, axis_files, tmp_path):
    (tmp_path / "robot.toml").write_text((tmp_path / "axis.toml").read_text())
    before = (tmp_path / "robot.toml").read_bytes()
    ended = omnislip("gap", "find", "--robot", "robot.toml", "--out", ".", *axis_files)
    assert_refused(ended, ["robot.toml", "another folder"])
    assert (tmp_path / "robot.toml").read_bytes() == before


@pytest.mark.parametrize("command", [["evaluate"], ["find", "--out", "gap"]], ids=lambda c: c[0])
def test_a_model_too_stiff_to_simulate_is_refused(command, omnislip, tmp_path):
    stiff = re.sub(r"(slip_stiffness_s_m) = [0-9.]+", r"\1 = 1e9", NOMINAL_ROBOT.read_text())
    (tmp_path / "robot.toml").write_text(stiff)
    write_log(still_log(2000), tmp_path / "run.csv")
    ended = omnislip("gap", *command, "--robot", "robot.toml", "run.csv")
    assert ended.status == 2
    last = ended.stderr.splitlines()[-1]  # after progress
    assert last.startswith("omnislip: error: the model is too stiff")
    assert "Traceback" not in ended.stderr


def test_evaluate_refuses_a_log_that_is_too_short(omnislip, tmp_path):
    write_log(still_log(40), tmp_path / "run.csv")
    ended = omnislip("gap", "evaluate", "--robot", NOMINAL_ROBOT, "run.csv")
    assert_refused(ended, ["run.csv", "more than 1 s"])


# ---- bad input ----


def edited(text, line, cell, value):
    """CSV text with one cell changed; line 1 is the header."""
    lines = text.split("\n")
    cells = lines[line - 1].split(",")
    cells[cell] = value
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines)


def without_column(text, name):
    lines = [line.split(",") for line in text.rstrip("\n").split("\n")]
    gone = lines[0].index(name)
    return "\n".join(",".join(c for i, c in enumerate(row) if i != gone) for row in lines) + "\n"


# What is spoilt in model and log (cells: 0 t_s, 1 wheel/1/duty, 5 wheel/1/encoder_counts), and what
# the one line must name.
BAD_FILES = {
    "unknown key": (
        lambda m: m.replace("mass_kg", "weight_kg"),
        lambda c: c,
        ["bad.toml", "robot.weight_kg"],
    ),
    "wrong unit": (
        lambda m: m.replace("mass_kg = 20.0", "mass_g = 20000.0"),
        lambda c: c,
        ["bad.toml", "robot.mass_g", "robot.mass_kg"],
    ),
    "missing key": (
        lambda m: m.replace("supply_v = 24.0", ""),
        lambda c: c,
        ["bad.toml", "motor.supply_v"],
    ),
    "unknown effect": (
        lambda m: m + "\n[[effects.suply_sag]]\nsource_resistance_ohm = 0.1\n",
        lambda c: c,
        ["bad.toml", "suply_sag", "supply_sag"],
    ),
    "broken TOML": (lambda m: m + "\n[robot\n", lambda c: c, ["bad.toml", "line"]),
    "missing column": (
        lambda m: m,
        lambda c: without_column(c, "wheel/3/encoder_counts"),
        ["bad.csv", "wheel/3/encoder_counts"],
    ),
    "unknown column": (
        lambda m: m,
        lambda c: c.replace("gyro/z_rad_s", "gyro/z_deg_s", 1),
        ["bad.csv", "gyro/z_deg_s"],
    ),
    "blank required cell": (
        lambda m: m,
        lambda c: edited(c, 30, 1, ""),
        ["bad.csv", "line 30", "wheel/1/duty"],
    ),
    "NaN in a required cell": (
        lambda m: m,
        lambda c: edited(c, 31, 5, "nan"),
        ["bad.csv", "line 31", "wheel/1/encoder_counts"],
    ),
    "text in a cell": (
        lambda m: m,
        lambda c: edited(c, 32, 5, "many"),
        ["bad.csv", "line 32", "wheel/1/encoder_counts", "many"],
    ),
    "time running backwards": (
        lambda m: m,
        lambda c: edited(c, 40, 0, "0.001"),
        ["bad.csv", "line 40", "t_s"],
    ),
    "duty beyond 1": (
        lambda m: m,
        lambda c: edited(c, 50, 1, "1.2"),
        ["bad.csv", "line 50", "wheel/1/duty", "-1 to 1"],
    ),
    "empty file": (lambda m: m, lambda c: "", ["bad.csv"]),
    "header only": (lambda m: m, lambda c: c.split("\n")[0] + "\n", ["bad.csv", "2 rows"]),
    "log of another machine": (
        lambda m: m,
        lambda c: "t_s,axis/command,axis/position_m\n0.0,1.0,0.0\n0.1,1.0,0.1\n",
        ["bad.csv", "axis/command"],
    ),
    "model of another machine": (
        lambda m: model_text(),
        lambda c: c,
        ["bad.csv", "axis"],
    ),
}


def assert_refused(ended, expected):
    assert ended.status == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("omnislip: error: ")
    assert ended.stderr.count("\n") == 1
    assert [word for word in expected if word not in ended.stderr] == []


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_one_line_and_leaves_nothing(case, omnislip, robot_csv, tmp_path):
    spoil_model, spoil_log, expected = BAD_FILES[case]
    (tmp_path / "bad.toml").write_text(spoil_model(ROBOT_TEXT))
    (tmp_path / "good.csv").write_text(robot_csv)
    (tmp_path / "bad.csv").write_text(spoil_log(robot_csv))
    ended = omnislip("gap", "find", "--robot", "bad.toml", "--out", "gap", "bad.csv", "good.csv")
    assert_refused(ended, expected)
    assert [f for f in files_below(tmp_path) if f.startswith("gap/")] == []
    assert_refused(omnislip("gap", "evaluate", "--robot", "bad.toml", "bad.csv"), expected)


@pytest.mark.parametrize("out", ["file", "file/folder"])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(
    out, omnislip, tmp_path, robot_csv
):
    (tmp_path / "file").write_text("kept")
    (tmp_path / "run.csv").write_text(robot_csv)
    ended = omnislip("gap", "find", "--robot", NOMINAL_ROBOT, "--out", out, "run.csv")
    assert_refused(ended, [out])
    assert (tmp_path / "file").read_text() == "kept"


def test_files_that_are_not_there_are_named(omnislip, robot_csv, tmp_path):
    (tmp_path / "run.csv").write_text(robot_csv)
    ended = omnislip("gap", "find", "--robot", "none.toml", "--out", "gap", "run.csv")
    assert_refused(ended, ["none.toml"])
    ended = omnislip("gap", "find", "--robot", NOMINAL_ROBOT, "--out", "gap", "none.csv")
    assert_refused(ended, ["none.csv"])


NO_PLANS = {
    "of an effect of one's own": (["cubic_wheel_drag", "dead_zone"], ["robot file"]),
    "of a patch without a place": (["slippery_patch", "low_grip"], ["slippery_patch", "--gap"]),
    "of one effect": (["dead_zone"], ["at least two"]),
    "of nothing": ([], ["--gap"]),
}


@pytest.mark.parametrize("case", NO_PLANS)
def test_what_cannot_be_planned_is_one_line(case, omnislip, tmp_path):
    names, expected = NO_PLANS[case]
    ended = omnislip("gap", "plan", "--robot", NOMINAL_ROBOT, "--out", "plan", *names)
    assert_refused(ended, expected)
    assert files_below(tmp_path) == []


def test_a_gap_json_with_a_patch_as_rival_only_cannot_be_planned_for(omnislip, tmp_path):
    path = gap_json(tmp_path, "low_grip", "slippery_patch", {"scale": 0.8})
    ended = omnislip("gap", "plan", "--robot", NOMINAL_ROBOT, "--out", "plan", "--gap", path)
    assert_refused(ended, ["slippery_patch"])


def test_unknown_class_of_the_benchmark_is_named(omnislip):
    ended = omnislip("gap", "benchmark", "--out", "cases", "--kind", "singel")
    assert_refused(ended, ["singel"])


def test_wrong_usage_ends_with_2(omnislip):
    assert omnislip("gap", "find", "--out", "gap").status == 2
    assert omnislip("gap", "find", "--robot", NOMINAL_ROBOT, "--out", "gap").status == 2
