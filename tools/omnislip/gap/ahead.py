"""One step further than the search: by the noise an effect leaves, in pairs, far from none."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from omnislip.gap.inference import Data, Evidence, Fit, Hypothesis, check_unseen, fit, weigh
from omnislip.gap.judge import (
    AHEAD_GAIN,
    DELAY,
    LEAST_PROMISE,
    MOST_EFFECTS,
    SURE_GAIN,
    WITHIN_LAW,
    Trial,
    both_pass,
    fit_other_law,
    judge_candidate,
)
from omnislip.gap.machine import CURRENT_LIMIT, CURVE, Candidate, Machine, stall_acceleration_rad_s2
from omnislip.gap.noise import (
    DISTURBANCES,
    SHAFT,
    Noise,
    RunawayError,
    some_runs,
    track_all,
    tune_noise,
    tuned_likelihood,
)
from omnislip.gap.recordings import Run
from omnislip.gap.refit import place_again, refit_quickly
from omnislip.gap.screen import Screened, neutral_sizes, screen
from omnislip.gap.settle import FEW_TUNINGS, Progress, settle
from omnislip.gap.side_by_side import side_by_side

Array = npt.NDArray[np.float64]

BEAM, BEAM_REFITS = 3, 6
"""Candidates that are looked ahead from, and seconds that are refitted beside each."""
PULLED_BY = (1.5, 2.0, 3.0)
"""How much larger an effect may be than noise that covers it lets it seem."""
PLAY, SPRING = "gear_backlash", "shaft_compliance"
FAR_DELAYS_ROWS = (1.5, 2.0, 3.0, 4.0, 6.0)
AXIS_DELAYS_ROWS = (0.5, 1.0, *FAR_DELAYS_ROWS)
FAR_SIZES = {PLAY: (0.4, 1.35, 13), "bristle_relaxation": (0.2, 1.6, 12)}
"""Delays, in rows, and sizes where no derivative leads: the first in its scale, its factor to the
next and how many (plays of 4 to 150 mrad of a robot, bristles of 0.2 to 35 mm). Of 63 mrad a play
of 40 explains less than none. An axis has one command, and its noise takes a delay of a row for
chance whole (one of 0.93 rows promised nothing and is likelier by exp(1,670))."""
SHAKEN = 0.003
"""Of a motor's acceleration at stall, how much its shaft has to be shaken by what a model does not
foretell for play and springs to be looked for: 0.005 to 0.04 in ten sets of logs with springs that
it lacks, 0.006 to 0.013 in four with play, 0.0002 to 0.0036 in twelve nulls."""
SHAKEN_ALIKE = 0.4
"""Of how much the shaft that is shaken most is, how much that one has to be which is least: springs
behind all of them do that (0.72 to 0.95 in twelve such sets), not a driver that lets go (0.06)."""
PLAYS_APART, PLAY_STEPS = 3, (1.35, 1.16, 1.08)
"""Of the sizes of play every third, and factors from the best: by noise that fits each the
likelihood rises to its peak from a factor of 2.5 off on both sides (four sets of logs)."""
STIFFNESSES = 0.03 * 2.2 ** np.arange(6)
"""In the scale of a stiffness: a wheel that is free swings at 11 to 83 Hz. The likelihood goes up
to its peak from far off, so that these and those beside the best lead there as 18 in steps of 1.3
did (five sets of logs); derivatives do from 15 % off."""
STIFFNESSES_BESIDE = 1.3 ** np.array([-2.0, -1.0, 1.0, 2.0])
LOAD_SHARES, STIFFNESSES_NEAR = (0.12, 0.3, 0.42), (0.88, 1.14)
"""Shares of the inertia behind a spring, beside the usual, and factors of the stiffness then."""
HOPEFUL = 500.0
"""By how much the likeliest of the coarse sizes may be less likely than none for finer ones to be
asked: of springs and play that are there it is likelier, or less so by 20 (eight sets of logs), of
others by 200 to 4,800 (five sets)."""
SPRING_DAMPING_RATIO = 0.15
FAR_STEPS = (0.5, 0.25)
"""Steps from the best of them, in rows or steps from size to size."""


@dataclass(frozen=True)
class Further:
    """A model with one or two more effects, and that without them, by the noise that fits the
    first."""

    data: Data
    without: Fit
    fitted: Fit
    trial: Trial

    def gain(self) -> float:
        """Fall of Q: by another noise Q itself is another."""
        return self.without.objective - self.fitted.objective


@dataclass(frozen=True)
class _Likely:
    """Log-likelihood of a model by its own filter."""

    likelihood: float
    model: Hypothesis


_Likeliest = Callable[[Sequence[Hypothesis]], _Likely]
"""The likeliest of some models, each by noise that fits it."""


class Ahead:
    """One step further, where none was taken or what promises nothing at first explains more.

    Each of the best is judged again by the noise that is left beside it: noise that was tuned
    without an effect covers it and pulls its size, so that a fit gains little of what was promised.
    And two defects may each be refused without the other, so a second one is tried beside it.
    """

    def __init__(
        self,
        data: Data,
        current: Fit,
        candidates: Sequence[Candidate],
        step: int,
        tried: int,
        progress: Progress,
    ) -> None:
        self._data, self._current = data, current
        self._candidates, self._step, self._tried = candidates, step, tried * BEAM
        self._progress = progress
        self.trials: list[Trial] = []
        self.looked_for_loose = False

    def best(
        self, refused: Sequence[tuple[Trial, Fit]], screened: Sequence[Screened]
    ) -> Further | None:
        """Return the best model with one of `refused`, or with one of them and a second effect.

        What promised or gained much, but from few blocks, is judged alone: among pairs of such
        chance has too much choice. So is what gains little by the noise that fits it.
        Pairs with a weaker first effect are tried only where none with a stronger one passes, sizes
        far from none by noise that fits each only where no pair does and much is there.
        """
        hopes = _hopes(refused, screened)
        refused = [pair for pair in refused if pair[0].reason != WITHIN_LAW]
        clear = [pair for pair in refused if pair[0].evidence.beyond_chance > AHEAD_GAIN]
        clear = sorted(clear, key=lambda pair: pair[1].objective)[:BEAM]
        rest = {pair[0].candidate.name: pair for pair in refused}
        for trial, _ in clear:
            rest.pop(trial.candidate.name, None)
        covered = [rest[name] for name in sorted(rest, key=lambda name: -hopes[name])[:BEAM]]
        covered = [pair for pair in covered if hopes[pair[0].candidate.name] > SURE_GAIN]
        judged = side_by_side(
            lambda pair: self._by_its_noise(
                pair[0].candidate,
                self._larger(pair[0].candidate, pair[1].hypothesis),
                pair[1].jacobian,
            ),
            clear + covered,
        )
        followed = [one for one in judged if one is not None]
        self.trials += [one.trial for one in followed]
        passed = [one for one in followed if one.trial.accepted]
        if len(self._current.hypothesis.effects) + 2 <= MOST_EFFECTS:
            for first in judged[: len(clear)]:
                if not passed and first and first.trial.evidence.beyond_chance > AHEAD_GAIN:
                    passed = self._pairs(first)
        if not passed and max(hopes.values(), default=0.0) > SURE_GAIN:
            far = self._far_by_noise()
            self.trials += [one.trial for one in far]
            passed = [one for one in far if one.trial.accepted]
        best = max(passed, key=Further.gain, default=None)
        self.trials = [
            replace(trial, accepted=best is not None and trial is best.trial)
            for trial in self.trials
        ]
        return best

    def far(self, candidate: Candidate, accepted: Fit | None) -> Further | None:
        """Return the model with an effect far from none, if that explains more than anything.

        The predictor of a model without a delay loses the robot by one with it, or takes for chance
        what play or bristles do: each size has to be judged along its own filter. In a closed loop
        a row's mean command holds the answer to what happened within it, so a likelihood that takes
        commands as given prefers those of the row before (in one log without a delay: 3,500 more at
        1.25 rows): what ends nearer than the first of these sizes is none of them.
        """
        current, runs = self._current.hypothesis, self._data.runs
        if candidate.effect == DELAY:
            row_s = max(run.row_s for run in runs)
            rows = FAR_DELAYS_ROWS if self._data.machine.kind == "robot" else AXIS_DELAYS_ROWS
            sizes, apart, apart_share = row_s * np.array(rows), row_s, 0.0
            sizes = sizes[sizes <= candidate.parameters[0].high]
        else:
            sizes = _far_sizes(candidate)
            apart, apart_share = 0.0, FAR_SIZES[candidate.effect][1] - 1.0
        shapes = [list(start.values()) for start in candidate.starts]

        def likeliest(values: Iterable[Sequence[float]], runs: Sequence[Run]) -> _Likely:
            """Return the likeliest model with the candidate of some values."""
            models = [current.with_effect(candidate, own) for own in values]
            found = side_by_side(lambda model: self._likelihood(model, runs), models)
            none = _Likely(-np.inf, current)
            return max(map(_Likely, found, models), key=lambda one: one.likelihood, default=none)

        few = some_runs(runs)  # enough to see whether any is worth a look
        best = likeliest([[size, *shape] for size in sizes for shape in shapes], few)
        if best.likelihood <= self._likelihood(current, few):
            return None
        best = likeliest([best.model.values_of(-1)], runs)
        least = self._likelihood(accepted.hypothesis if accepted else current, runs)
        if best.likelihood < least + SURE_GAIN / 2:
            return None
        for share in FAR_STEPS:
            size, *shape = best.model.values_of(-1)
            step = share * (apart + apart_share * size)
            near = [one for one in (size - step, size + step) if one > 0.0]
            beside = likeliest([[one, *shape] for one in near], runs)
            best = max(best, beside, key=lambda one: one.likelihood)
        if best.model.values_of(-1)[0] < sizes[0]:
            return None
        found = self._by_its_noise(candidate, best.model)
        if found is None:
            return None
        self.trials.append(found.trial)
        size = found.fitted.hypothesis.values_of(len(current.effects))[0]
        return found if found.trial.accepted and size >= sizes[0] else None

    def loose(self, accepted: Fit | None) -> Further | None:
        """Return the model whose shafts are springs or have play, if that is likelier than all.

        Each size by noise that fits it, in the run that is driven most: what was tuned without
        covers what they do, and by its filter springs gain a tenth of what a heavier rotor does,
        which was named, and the rest unknown. So do plays that are a seventh off: of 127 mrad a
        spring was named and an inertia. What was accepted has to leave shafts shaken.
        """
        data = self._data
        machine = data.machine
        missing = {c.effect for c in self._candidates} & {SPRING, PLAY}
        offered = {c.effect: c for c in machine.candidates() if c.effect in missing}
        if machine.kind != "robot" or not offered or not _shakes(machine, data.noise):
            return None
        shaken = self._shaken()
        if shaken.min() < SHAKEN_ALIKE * shaken.max():
            return None
        run = max(data.runs, key=lambda one: float(np.std(np.diff(one.command, axis=0))))
        if accepted is not None and not self._still_shakes(accepted.hypothesis, run):
            return None
        self.looked_for_loose = True
        self._progress(f"step {self._step}: looking for play and springs")

        def likelihoods(models: Sequence[Hypothesis]) -> list[float]:
            return side_by_side(lambda model: _by_own_noise(data, model, [run]), models)

        def likeliest(models: Sequence[Hypothesis]) -> _Likely:
            found = map(_Likely, likelihoods(models), models)
            return max(found, key=lambda one: one.likelihood)

        others = likelihoods([one.hypothesis for one in (self._current, accepted) if one])
        least = others[0] - HOPEFUL
        looks = {SPRING: self._likeliest_spring, PLAY: self._likeliest_play}
        found = [looks[effect](one, likeliest, least) for effect, one in offered.items()]
        best = max(found, key=lambda one: one.likelihood)
        if best.likelihood < max(others) + SURE_GAIN / 2:
            return None
        return self._if_it_passes(best.model)

    def clipped(self, accepted: Fit | None) -> Further | None:
        """Return the model with a limit of currents where logged ones end, if likelier than all.

        By the filter of a model that lets 40 A through the limit of 2 A that is there promised
        nothing, and a driver that is not linear was named, and springs.
        """
        data = self._data
        limit_a = data.machine.clipped_at_a(data.runs)
        candidate = next((c for c in self._candidates if c.effect == CURRENT_LIMIT), None)
        if candidate is None or limit_a is None:
            return None
        self._progress(f"step {self._step}: looking where currents end")
        model = self._current.hypothesis.with_effect(candidate, [limit_a])
        others = [one.hypothesis for one in (self._current, accepted) if one]
        few = some_runs(data.runs)
        own, *theirs = side_by_side(lambda one: _by_own_noise(data, one, few), [model, *others])
        if own < max(theirs) + SURE_GAIN / 2:
            return None
        return self._if_it_passes(model)

    def _likeliest_play(self, candidate: Candidate, likeliest: _Likeliest, least: float) -> _Likely:
        """Return the likeliest model with play, from coarse sizes to finer ones.

        Those only where the coarse ones are as likely as `least`; so for springs.
        """

        def with_play(size: float) -> Hypothesis:
            return self._current.hypothesis.with_effect(candidate, [size])

        best = likeliest([with_play(size) for size in _far_sizes(candidate)[::PLAYS_APART]])
        if best.likelihood < least:
            return best
        for step in PLAY_STEPS:
            [size] = best.model.values_of(-1)
            beside = likeliest([with_play(size / step), with_play(size * step)])
            best = max(best, beside, key=lambda one: one.likelihood)
        return best

    def _likeliest_spring(
        self, candidate: Candidate, likeliest: _Likeliest, least: float
    ) -> _Likely:
        """Return the likeliest model with springs, from coarse stiffnesses to finer ones."""
        machine, current = self._data.machine, self._current.hypothesis
        [share] = machine.refinements(candidate)
        values = machine.model.values
        inertia = values["motor.inertia_kg_m2"] * values["motor.gear_ratio"] ** 2
        usual = machine.believed[share.parameters[0].places[0]]

        def sprung(stiffness: float, load_share: float) -> Hypothesis:
            reduced = load_share * (1.0 - load_share) * inertia
            damping = 2.0 * SPRING_DAMPING_RATIO * np.sqrt(stiffness * reduced)
            spring = current.with_effect(candidate, [stiffness, damping])
            return spring.with_effect(share, [load_share]).last_two_joined()

        def beside(
            best: _Likely, factors: Iterable[float], load_shares: Sequence[float] = ()
        ) -> _Likely:
            stiffness, _, load_share = best.model.values_of(-1)
            others = [
                sprung(stiffness * factor, share)
                for factor in factors
                for share in (load_shares or (load_share,))
            ]
            return max(best, likeliest(others), key=lambda one: one.likelihood)

        scale = candidate.parameters[0].scale
        best = likeliest([sprung(scale * size, usual) for size in STIFFNESSES])
        if best.likelihood < least:
            return best
        best = beside(best, STIFFNESSES_BESIDE)
        best = beside(best, [1.0], LOAD_SHARES)
        return beside(best, STIFFNESSES_NEAR)

    def by_another_law(self, refused: Sequence[Trial]) -> Further | None:
        """Return the model with the friction curve of another law, if that helps.

        Where an effect explains surely something, but no more than friction is off its law (a floor
        of 1 - exp(-x) called unknown in a closed loop, where grip_falloff gained 1,400).
        """
        have = {effect.effect for effect in self._current.hypothesis.effects}
        surely = any(
            one.reason == WITHIN_LAW and one.evidence.beyond_chance > SURE_GAIN for one in refused
        )
        if not surely or CURVE in have:
            return None
        self._progress(f"step {self._step}: trying other laws of friction")
        data, current = self._data, self._current
        fitted = fit_other_law(data, current.hypothesis)
        index = len(current.hypothesis.effects)
        evidence = weigh(data, current, fitted, index)
        [check] = check_unseen(data, current, [fitted])
        law = fitted.hypothesis.effects[-1]
        trial = judge_candidate(
            data, current, fitted, law, evidence, check, self._step, self._tried
        )
        self.trials.append(trial)
        return Further(data, current, fitted, trial) if trial.accepted else None

    def _still_shakes(self, model: Hypothesis, run: Run) -> bool:
        """Whether a model leaves shafts shaken in a run, by the noise that fits it there."""
        data = self._data
        try:
            noise = tune_noise(data.machine, [run], model.flat(data.believed), data.noise, paths=1)
        except RunawayError:
            return True
        return _shakes(data.machine, noise)

    def _shaken(self) -> Array:
        """Root mean squares (wheels,) of what shakes the shafts and the model does not foretell."""
        data = self._data
        values = self._current.hypothesis.flat(data.believed)
        tracks = track_all(data.machine, data.runs, values, data.noise)
        settled = [
            track.state.reshape(len(run.t_s), -1)[run.t_s >= run.settled_s, DISTURBANCES]
            for run, track in zip(data.runs, tracks, strict=True)
        ]
        return np.sqrt(np.mean(np.concatenate(settled)[:, SHAFT] ** 2, axis=0))

    def _likelihood(self, hypothesis: Hypothesis, runs: Sequence[Run]) -> float:
        """Logarithm of that of a model's own filter, by the noise that is known."""
        values = hypothesis.flat(self._data.believed)
        try:
            tracks = track_all(self._data.machine, runs, values, self._data.noise)
        except RunawayError:
            return -np.inf
        return float(np.nan_to_num(sum(t.log_likelihood for t in tracks), nan=-np.inf))

    def _larger(self, candidate: Candidate, start: Hypothesis) -> Hypothesis:
        """Return a model whose last effect was fitted with it of the likeliest of some sizes.

        From a size that was pulled settling creeps: play of 5 mrad for 13 went to 8 in six rounds.
        """
        sizes = start.values_of(-1)
        absent = neutral_sizes(self._data, self._current.hypothesis, candidate)
        amplitudes = [i for i in candidate.amplitudes if np.isfinite(absent[i])]
        if not amplitudes:
            return start
        low, high = ([getattr(p, end) for p in candidate.parameters] for end in ("low", "high"))
        offered = [start]
        for factor in PULLED_BY:
            larger = sizes.copy()
            larger[amplitudes] += (factor - 1.0) * (sizes - absent)[amplitudes]
            offered.append(
                self._current.hypothesis.with_effect(candidate, np.clip(larger, low, high))
            )
        return max(offered, key=lambda one: self._likelihood(one, self._data.runs))

    def _if_it_passes(self, model: Hypothesis) -> Further | None:
        """Judge a model by the noise that fits its last effect; None where that does not pass."""
        further = self._by_its_noise(model.effects[-1], model)
        if further is None:
            return None
        self.trials.append(further.trial)
        return further if further.trial.accepted else None

    def _by_its_noise(
        self, candidate: Candidate, start: Hypothesis, last: Array | None = None
    ) -> Further | None:
        """Judge a candidate by the noise that fits it; None where its own filter loses the robot.

        What pulls as hard as a motor, tooth by tooth, may gain along the filter of another model.
        `last`: as `settle` has it.
        """
        self._progress(f"step {self._step}: looking ahead from {candidate.name}")
        machine, noise = self._data.machine, self._data.noise
        try:
            data, first = settle(machine, self._data.runs, start, noise, FEW_TUNINGS, last)
        except RunawayError:
            return None
        without = fit(data, self._current.hypothesis, last=self._current.jacobian)
        evidence = weigh(data, without, first, len(without.hypothesis.effects))
        [check] = check_unseen(data, without, [first])
        trial = judge_candidate(
            data,
            without,
            first,
            candidate,
            evidence,
            check,
            self._step,
            self._tried,
        )
        trial = replace(trial, reason=f"by the noise that is left beside it: {trial.reason}")
        return Further(data, without, first, trial)

    def _pairs(self, first: Further) -> list[Further]:
        """Return the models with this effect and a second one that pass.

        The second is judged only when both are fitted: a patch in the floor, say, lies somewhere
        else beside the right friction curve.
        """
        data, name = first.data, first.trial.candidate.name
        others = [c for c in self._candidates if c.name != name]
        worth = [
            s for s in screen(data, first.fitted, others)[:BEAM_REFITS] if s.promise > LEAST_PROMISE
        ]
        self._progress(f"step {self._step}: trying others beside {name}")
        index = len(first.fitted.hypothesis.effects)
        found = [
            (fitted, weigh(data, first.fitted, fitted, index))
            for fitted in refit_quickly(data, first.fitted, worth)
        ]
        found.sort(key=lambda one: -one[1].beyond_chance)

        def judge(one: tuple[Fit, Evidence]) -> Further:
            quick, evidence = one
            both = fit(data, quick.hypothesis, last=quick.jacobian)
            both = place_again(data, both, len(first.without.hypothesis.effects))
            return self._pair(data, first, first.without, both, evidence)

        judged = side_by_side(judge, found[:BEAM])
        far = [self._far_beside(first, c) for c in others if c.effect in FAR_SIZES]
        judged += [one for one in far if one is not None]
        self.trials += [one.trial for one in judged]
        return [one for one in judged if one.trial.accepted]

    def _far_by_noise(self) -> list[Further]:
        """Return the models with an effect far from none, each likelier by noise that fits it."""
        found = []
        for candidate in self._candidates:
            if candidate.effect in FAR_SIZES:
                start = _likeliest_far(self._data, self._current.hypothesis, candidate)
                found.append(self._by_its_noise(candidate, start) if start else None)
        return [one for one in found if one is not None]

    def _far_beside(self, first: Further, candidate: Candidate) -> Further | None:
        """Return the model with an effect far from none beside the first, if that is likelier."""
        data, before = first.data, first.fitted.hypothesis
        start = _likeliest_far(data, before, candidate)
        if start is None:
            return None
        name = first.trial.candidate.name
        self._progress(f"step {self._step}: looking ahead from {name} and {candidate.name}")
        try:
            data, both = settle(data.machine, data.runs, start, data.noise, FEW_TUNINGS)
        except RunawayError:
            return None
        without = fit(data, self._current.hypothesis, last=self._current.jacobian)
        index = len(before.effects)
        evidence = weigh(data, both.refitted_without(data, index), both, index)
        return self._pair(data, first, without, both, evidence)

    def _pair(
        self, data: Data, first: Further, without: Fit, both: Fit, evidence: Evidence
    ) -> Further:
        """Judge a model with the first effect and a second one of this evidence beside it."""
        tried, name = self._tried * BEAM, first.trial.candidate.name
        [check] = check_unseen(data, without, [both])
        passes = both_pass(data, without, both, check, tried)
        reason = f"{name} and this {'pass' if passes else 'do not pass'} together"
        chance, checked = min(1.0, evidence.p_value * tried), bool(check.voters.any())
        second, values = both.hypothesis.effects[-1], both.hypothesis.values_of(-1)
        trial = Trial(
            self._step, second, values, evidence, chance, check.gain, checked, reason, passes
        )
        return Further(data, without, both, trial)


def _shakes(machine: Machine, noise: Noise) -> bool:
    """Whether shafts are shaken by more than a model foretells, as by springs that it lacks."""
    shaken_rad_s2 = float(np.sqrt(noise.coloured[0, 0]))
    return shaken_rad_s2 >= SHAKEN * stall_acceleration_rad_s2(machine)


def _hopes(refused: Sequence[tuple[Trial, Fit]], screened: Sequence[Screened]) -> dict[str, float]:
    """Return what each candidate explains or promises to, as inflated as it may be."""
    promised = {one.candidate.name: one.promise for one in screened}
    gained = {trial.candidate.name: trial.evidence.gain for trial, _ in refused}
    return {name: max(promised.get(name, 0.0), gain) for name, gain in gained.items()}


def _likeliest_far(data: Data, before: Hypothesis, candidate: Candidate) -> Hypothesis | None:
    """Return the likeliest model with an effect far from none; None if none is surely likelier.

    Each size by noise that fits it: noise that fits the model without holds what bristles do, too
    (beside a cogging torque it made them 5,000 to 11,000 less likely than none; by its own they
    are 23,000 likelier. A tyre's relaxation length of 37 mm: 4,000, and 2,600).
    """
    models = [
        before.with_effect(candidate, [size, *start.values()])
        for size in _far_sizes(candidate)[1::3]
        for start in candidate.starts
    ]
    least, *found = side_by_side(
        lambda model: _by_own_noise(data, model, data.runs), [before, *models]
    )
    if max(found) < least + SURE_GAIN / 2:
        return None
    return models[int(np.argmax(found))]


def _by_own_noise(data: Data, model: Hypothesis, runs: Sequence[Run]) -> float:
    """Log-likelihood of runs with a model by noise that fits it."""
    try:
        values = model.flat(data.believed)
        return tuned_likelihood(data.machine, runs, values, data.noise)
    except RunawayError:
        return -np.inf


def _far_sizes(candidate: Candidate) -> Array:
    """Return sizes (sizes,) of an effect to which no derivative leads from none."""
    first, factor, count = FAR_SIZES[candidate.effect]
    sizes = candidate.parameters[0].scale * first * factor ** np.arange(count)
    return sizes[sizes <= candidate.parameters[0].high]
