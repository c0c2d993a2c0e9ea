"""The paper's experiment (Cao, Huang, Leng, Fig. 6) in closed loop.

Pure X translation at 1500 mm/s. A sideways impulse hits the robot at x = 2350 mm under the
controller without slip (a) and at x = 1850 mm under the one with the slip model (b). The paper
gives neither the impulse nor figures, so both controllers are also hit at both places with the
same impulse, over a range of impulses.

For each run:  speed overshoot   100 (max vx / 1.5 m/s - 1), before the impact
               speed error       100 (mean vx of the last 0.2 s before the impact / 1.5 m/s - 1)
               peak |y|          from the impact on
               remaining |y|     mean over the last 0.2 s of the run, 1.5 s after the impact
"""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from omnislip import plots
from omnislip.animation import Take, write_film
from omnislip.files import write_text
from omnislip.log_file import write_log
from omnislip.model_file import NOMINAL_ROBOT, Model, read_model
from omnislip.scenario import Scenario
from omnislip.simulate import make_log, simulate_truth

Array = npt.NDArray[np.float64]

SPEED_M_S = 1.5
IMPACT_X_M = {"a": 2.35, "b": 1.85}
CONTROLLERS = ("plain", "slip")
CONTROLLER_LABELS = {"plain": "without slip model", "slip": "with slip model"}
CONTROLLER_COLOURS = {"plain": plots.ORANGE, "slip": plots.BLUE}
SWEEP_N_S = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0)
REFERENCE_IMPULSE_N_S = 10.0
AFTER_IMPACT_S = 1.5
MEAN_WINDOW_S = 0.2


@dataclass(frozen=True)
class Case:
    """One run of the experiment."""

    controller: str
    impact_x_m: float
    impulse_y_n_s: float


@dataclass(frozen=True)
class Outcome:
    """What is read off one run; see the head of this file."""

    controller: str
    impact_x_m: float
    impulse_y_n_s: float
    impact_t_s: float
    speed_overshoot_percent: float
    speed_error_percent: float
    peak_y_m: float
    remaining_y_m: float


def all_cases() -> list[Case]:
    """Return the sweep: both controllers, both places, all impulses."""
    return [
        Case(controller, impact_x_m, impulse)
        for impact_x_m in IMPACT_X_M.values()
        for impulse in SWEEP_N_S
        for controller in CONTROLLERS
    ]


def run_experiment(cases: Iterable[Case], out: Path) -> dict[str, object]:
    """Run `cases`, write paper.json, figures and logs to `out`; return what paper.json holds."""
    model = read_model(NOMINAL_ROBOT)
    outcomes, references = [], {}
    for case in cases:
        scenario = case_scenario(case, model)
        truth = simulate_truth(scenario)
        outcomes.append(measure(case, truth))
        if case.impulse_y_n_s == REFERENCE_IMPULSE_N_S:
            references[case] = truth
            write_log(make_log(scenario, truth), out / f"{scenario.name}.csv")
    plot_figure_6(references, out / "figure_6.png")
    plot_same_impact(references, out / "same_impact.png")
    plot_sweep(outcomes, out / "sweep.png")
    film_push(references, model, out / "push.gif")
    result = {
        "schema": "omnislip-paper/1",
        "speed_m_s": SPEED_M_S,
        "reference_impulse_n_s": REFERENCE_IMPULSE_N_S,
        "runs": [asdict(outcome) for outcome in outcomes],
        "ratios": ratios(outcomes),
    }
    write_text(out / "paper.json", json.dumps(result, indent=1) + "\n")
    return result


def case_scenario(case: Case, model: Model) -> Scenario:
    """Return the scenario of one run; it ends about AFTER_IMPACT_S after the impact."""
    # The acceleration to 1.5 m/s costs well under half a second against driving at full speed.
    duration_s = case.impact_x_m / SPEED_M_S + 0.5 + AFTER_IMPACT_S
    place = f"{case.impact_x_m * 1000:.0f}_mm"
    return Scenario(
        name=f"{case.controller}_{place}",
        duration_s=round(duration_s, 3),
        model=model,
        commands=[{"t_s": 0.0, "kind": "velocity", "value": [SPEED_M_S, 0.0, 0.0]}],
        impulses=[
            {
                "x_m": case.impact_x_m,
                "impulse_x_n_s": 0.0,
                "impulse_y_n_s": case.impulse_y_n_s,
                "impulse_theta_n_m_s": 0.0,
            }
        ],
        slip_compensation=case.controller == "slip",
    )


def measure(case: Case, truth: dict[str, Array]) -> Outcome:
    """Read the figures of one run off its 1 kHz arrays."""
    impact = int(np.argmax(truth["pose"][:, 0] >= case.impact_x_m))
    t_s, x_speed_m_s, y_m = truth["t_s"], truth["velocity"][:, 0], truth["pose"][:, 1]
    before = (t_s >= t_s[impact] - MEAN_WINDOW_S) & (t_s < t_s[impact])
    last = t_s >= t_s[-1] - MEAN_WINDOW_S
    return Outcome(
        **asdict(case),
        impact_t_s=float(t_s[impact]),
        speed_overshoot_percent=100 * float(x_speed_m_s[:impact].max() / SPEED_M_S - 1),
        speed_error_percent=100 * float(x_speed_m_s[before].mean() / SPEED_M_S - 1),
        peak_y_m=float(np.abs(y_m[impact:]).max()),
        remaining_y_m=float(np.abs(y_m[last]).mean()),
    )


def ratios(outcomes: list[Outcome]) -> list[dict[str, float]]:
    """Return peak and remaining |y| without over with the slip model, per place and impulse."""
    plain = {
        (outcome.impact_x_m, outcome.impulse_y_n_s): outcome
        for outcome in outcomes
        if outcome.controller == "plain"
    }
    rows = []
    for slip in outcomes:
        key = (slip.impact_x_m, slip.impulse_y_n_s)
        if slip.controller == "slip" and key in plain:
            rows.append(
                {
                    "impact_x_m": slip.impact_x_m,
                    "impulse_y_n_s": slip.impulse_y_n_s,
                    "peak_y_ratio": plain[key].peak_y_m / slip.peak_y_m,
                    "remaining_y_ratio": plain[key].remaining_y_m / slip.remaining_y_m,
                }
            )
    return rows


def _draw_y_over_x(
    axis: Axes, truth: dict[str, Array], key: str, colour: str, style: str, label: str
) -> None:
    x_mm, y_mm = 1000 * truth[key][:, 0], 1000 * truth[key][:, 1]
    axis.plot(x_mm, y_mm, color=colour, linestyle=style, label=label)


def plot_figure_6(references: dict[Case, dict[str, Array]], path: Path) -> None:
    """Draw the paper's two runs: (a) without slip, (b) with the slip model; true and believed."""
    figure, axes = plots.new_figure(2, 1, (8, 7))
    for axis, part, controller in zip(axes, "ab", CONTROLLERS, strict=True):
        truth = references[Case(controller, IMPACT_X_M[part], REFERENCE_IMPULSE_N_S)]
        colour = CONTROLLER_COLOURS[controller]
        _draw_y_over_x(axis, truth, "pose", colour, "-", "true path")
        _draw_y_over_x(axis, truth, "odometry", "0.4", "--", "odometry of the firmware")
        axis.axvline(1000 * IMPACT_X_M[part], color="0.7", linestyle=":")
        axis.set(xlabel="x / mm", ylabel="y / mm")
        axis.set_title(
            f"({part}) control {CONTROLLER_LABELS[controller]}, impact of "
            f"{REFERENCE_IMPULSE_N_S:g} N s at x = {1000 * IMPACT_X_M[part]:.0f} mm",
            loc="left",
        )
        axis.legend(frameon=False)
    axes[1].sharey(axes[0])
    plots.save_figure(figure, path)


def plot_same_impact(references: dict[Case, dict[str, Array]], path: Path) -> None:
    """Draw the true paths of both controllers for the same impact, one panel per place."""
    figure, axes = plots.new_figure(2, 1, (8, 7))
    for axis, impact_x_m in zip(axes, IMPACT_X_M.values(), strict=True):
        for controller in CONTROLLERS:
            truth = references[Case(controller, impact_x_m, REFERENCE_IMPULSE_N_S)]
            label = f"control {CONTROLLER_LABELS[controller]}"
            style = "--" if controller == "plain" else "-"
            _draw_y_over_x(axis, truth, "pose", CONTROLLER_COLOURS[controller], style, label)
        axis.axvline(1000 * impact_x_m, color="0.7", linestyle=":")
        axis.set(xlabel="x / mm", ylabel="y / mm")
        title = f"{REFERENCE_IMPULSE_N_S:g} N s sideways at x = {1000 * impact_x_m:.0f} mm"
        axis.set_title(title, loc="left")
        axis.legend(frameon=False)
    plots.save_figure(figure, path)


def film_push(references: dict[Case, dict[str, Array]], model: Model, path: Path) -> None:
    """Film both controllers side by side under the same impact, where (a) has it."""
    impact_x_m = IMPACT_X_M["a"]
    takes = tuple(
        Take(
            f"control {CONTROLLER_LABELS[controller]}",
            CONTROLLER_COLOURS[controller],
            references[Case(controller, impact_x_m, REFERENCE_IMPULSE_N_S)],
        )
        for controller in CONTROLLERS
    )
    title = f"a push of {REFERENCE_IMPULSE_N_S:g} N s; wheels turn red where they slip"
    write_film(takes, model, impact_x_m, title, path)


def plot_sweep(outcomes: list[Outcome], path: Path) -> None:
    """Draw peak and remaining |y| over the impulse, both controllers, both places."""
    figure, axes = plots.new_figure(1, 2, (11, 4.5))
    labels = {"peak_y_m": "peak |y| / mm", "remaining_y_m": "remaining |y| / mm"}
    for axis, (name, label) in zip(axes, labels.items(), strict=True):
        for controller in CONTROLLERS:
            for impact_x_m, marker in zip(IMPACT_X_M.values(), "os", strict=True):
                points = [
                    (outcome.impulse_y_n_s, 1000 * getattr(outcome, name))
                    for outcome in outcomes
                    if (outcome.controller, outcome.impact_x_m) == (controller, impact_x_m)
                ]
                axis.plot(
                    *zip(*points, strict=True),
                    color=CONTROLLER_COLOURS[controller],
                    linestyle="--" if controller == "plain" else "-",
                    marker=marker,
                    label=f"{CONTROLLER_LABELS[controller]}, x = {1000 * impact_x_m:.0f} mm",
                )
        axis.set(xlabel="sideways impulse / (N s)", ylabel=label, ylim=(0, None))
    axes[0].legend(frameon=False)
    plots.save_figure(figure, path)
