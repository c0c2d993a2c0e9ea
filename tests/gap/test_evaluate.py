"""`gap evaluate` prints the figures of `gap find`, and refuses what cannot be replayed."""

from dataclasses import replace

import numpy as np
import pytest
from axis_bench import Bench, make_log, model_text, silent, true_noise
from omnislip.errors import InputError
from omnislip.gap import evaluate
from omnislip.gap.evaluate import evaluate_model
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json, write_results
from omnislip.gap.truth import TruthCase, write_case
from omnislip.log_file import read_log, write_log
from omnislip.model_file import Effect, read_model, write_model

CHANNEL = "axis/position_m"


def axis_files(folder, logs, effects=""):
    """Write the believed axis and logs of one with Coulomb friction of 2 N."""
    (folder / "axis.toml").write_text(model_text(effects=effects))
    paths = [folder / f"{log.name}.csv" for log in logs]
    for log, path in zip(logs, paths, strict=True):
        write_log(log, path)
    return folder / "axis.toml", paths


def rubbing(seeds, **changed):
    return [make_log(Bench(coulomb_n=2.0), seed, **changed) for seed in seeds]


def without_rows(log, begin, end):
    columns = {name: np.delete(values, slice(begin, end)) for name, values in log.columns.items()}
    return replace(log, t_s=np.delete(log.t_s, slice(begin, end)), columns=columns)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Findings, their table of the axis, both models and the held-out log: it lacks 0.6 s."""
    folder = tmp_path_factory.mktemp("found")
    logs = rubbing(range(6))
    model, paths = axis_files(folder, [*logs[:-1], without_rows(logs[-1], 300, 420)])
    findings = find_gap(model, paths, silent)
    write_results(findings, folder / "gap", "report")
    gap = to_json(findings)["gap"]
    assert gap["held_out_runs"] == ["run_05"]
    models = {"believed": model, "after": folder / "gap" / "robot.toml"}
    return findings, gap["channels"][CHANNEL], models, paths[-1:]


def test_the_figures_are_those_of_find_but_for_the_noise(found, monkeypatch):
    findings, told, models, held_out = found
    monkeypatch.setattr(evaluate, "tune_noise", lambda *_: findings.outcome.data.noise)
    for name, model in models.items():
        figures = evaluate_model(model, held_out, silent)["channels"][CHANNEL]
        assert figures["rmse"] == pytest.approx(told[name], rel=1e-6)
    assert figures["noise_floor"] == pytest.approx(told["noise_floor"], rel=1e-6)


def test_the_noise_of_the_evaluated_model_changes_them_little(found):
    """But for the floor of a model that lacks something, which is too high."""
    _, told, models, held_out = found
    believed, after = (
        evaluate_model(models[name], held_out, silent)["channels"][CHANNEL]
        for name in ("believed", "after")
    )
    assert after["rmse"] == pytest.approx(told["after"], rel=0.02)
    assert after["noise_floor"] == pytest.approx(told["noise_floor"], rel=0.2)
    assert believed["rmse"] == pytest.approx(told["believed"], rel=0.1)
    assert believed["noise_floor"] > after["noise_floor"]


def test_evaluate_tells_the_better_model(tmp_path):
    def evaluated(effects=""):
        files = axis_files(tmp_path, rubbing(range(4)), effects)
        return evaluate_model(*files, silent)["channels"][CHANNEL]

    worse, better = evaluated(), evaluated("[[effects.coulomb_friction]]\nforce_n = 2.0\n")
    assert better["rmse"] < 0.3 * worse["rmse"]
    assert 0.5 < better["rmse"] / better["noise_floor"] < 2.0


def test_runs_of_one_name_in_two_folders_are_two(tmp_path, monkeypatch):
    """Each counts as much as the other, however long."""
    monkeypatch.setattr(evaluate, "tune_noise", lambda *_: true_noise())
    files = []
    for day, bench in enumerate((Bench(), Bench(coulomb_n=2.0))):
        (tmp_path / f"day_{day}").mkdir()
        log = make_log(bench, 1, duration_s=3.0 + day)
        model, paths = axis_files(tmp_path / f"day_{day}", [log])
        files += paths
    one, other, both = (
        evaluate_model(model, some, silent)["channels"][CHANNEL]["rmse"]
        for some in (files[:1], files[1:], files)
    )
    assert both == pytest.approx(np.sqrt((one**2 + other**2) / 2))


PUSH = {"time_s": 2.5, "impulse_x_n_s": -0.5, "impulse_y_n_s": 6.0, "impulse_theta_n_m_s": 0.1}


def encoder_rmse(folder, hidden, named):
    """RMSE of encoder 1 of a robot with `hidden` effects by the model with `named` ones."""
    write_case(TruthCase(seed=3, effects=hidden, runs=1, run_duration_s=5.0), folder)
    model = read_model(folder / "robot.toml")
    model.effects.extend(named)
    write_model(model, folder / "named.toml")
    result = evaluate_model(folder / "named.toml", [folder / "run_01.csv"], silent)
    return result["channels"]["wheel/1/encoder_counts"]["rmse"]


def test_a_push_that_the_model_names_is_no_error_of_it(tmp_path):
    hidden = {"name": "impact", "parameters": PUSH, "run": "run_01", "wheel": None}
    unpushed = encoder_rmse(tmp_path, (), [])
    assert encoder_rmse(tmp_path, (hidden,), []) > 5.0 * unpushed
    named = encoder_rmse(tmp_path, (hidden,), [Effect("impact", PUSH, run="run_01")])
    assert named == pytest.approx(unpushed, rel=0.5)


def test_a_log_that_find_would_refuse_is_refused(tmp_path):
    write_case(TruthCase(seed=3, runs=1, run_duration_s=3.0), tmp_path)
    log = read_log(tmp_path / "run_01.csv", "robot")
    millimetres = {name: 1e3 * log.columns[name] for name in ("pose/x_m", "pose/y_m")}
    write_log(replace(log, columns=log.columns | millimetres), tmp_path / "run_01.csv")
    with pytest.raises(InputError, match=r"run_01: pose/x_m .* millimetres"):
        evaluate_model(tmp_path / "robot.toml", [tmp_path / "run_01.csv"], silent)


def test_what_was_cut_is_told(found):
    _, _, models, held_out = found
    [told] = evaluate_model(models["after"], held_out, silent)["recording"]
    assert told == "run_05: rows are missing, the log is cut there: 1.495 s"


def test_evaluate_refuses_logs_in_which_nothing_moves(tmp_path):
    model, [path] = axis_files(tmp_path, rubbing([1]))
    log = read_log(path, "axis")
    write_log(replace(log, columns={name: 0 * v for name, v in log.columns.items()}), path)
    with pytest.raises(InputError, match="the logs cannot be used: the command never changes"):
        evaluate_model(model, [path], silent)


def test_evaluate_refuses_a_log_in_milliseconds(tmp_path):
    model, [path] = axis_files(tmp_path, rubbing([1]))
    log = read_log(path, "axis")
    write_log(replace(log, t_s=1e3 * log.t_s), path)
    with pytest.raises(InputError, match=r"rows of run_01 are 5 s apart.*t_s counts seconds"):
        evaluate_model(model, [path], silent)


@pytest.mark.parametrize("duration_s", [0.02, 0.2, 0.9])
def test_a_log_that_is_too_short_is_refused(duration_s, tmp_path):
    files = axis_files(tmp_path, rubbing([1], duration_s=duration_s))
    with pytest.raises(InputError, match=r"run_01.csv: too short .* more than 1 s .* 50 rows"):
        evaluate_model(*files, silent)


@pytest.mark.parametrize("with_rows", [False, True])
def test_held_commands_jump_where_the_motion_says(tmp_path, monkeypatch, with_rows):
    write_case(TruthCase(seed=4, runs=2, run_duration_s=3.0), tmp_path)
    judged, judging = [], evaluate.judging_noise

    def spied(machine, runs, *rest):
        judged.append((machine.holds_commands, machine.jumps_with_rows))
        assert all((run.parted is not None) == with_rows for run in runs)
        return judging(machine, runs, *rest)

    monkeypatch.setattr(evaluate, "judging_noise", spied)
    monkeypatch.setattr(evaluate, "likelier_held", lambda *_: 1.0)
    monkeypatch.setattr(evaluate, "likelier_with_rows", lambda *_: 1.0 if with_rows else -1.0)
    evaluate_model(tmp_path / "robot.toml", sorted(tmp_path.glob("run_*.csv")), silent)
    assert judged == [(True, with_rows)]
