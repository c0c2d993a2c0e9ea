"""Effects of a model beside what could stand in their place, and which of them is likelier."""

from collections.abc import Sequence
from dataclasses import dataclass

from omnislip.gap.inference import Data, Evidence, Fit, check_unseen, fit, weigh
from omnislip.gap.judge import (
    ALPHA,
    CURVES,
    FRICTION_OVER_SLIP,
    VARIES_SURELY,
    WANDERS,
    WEAK,
    drop_needless,
    fit_other_law,
    no_more_than_chance,
    within_law,
    within_row,
)
from omnislip.gap.machine import CURVE, Candidate
from omnislip.gap.noise import RunawayError
from omnislip.gap.refit import extend_effects, refit_each, settle_placed, whole_numbers
from omnislip.gap.screen import screen
from omnislip.gap.settle import Progress, likelihood_judges, log_posterior, settle
from omnislip.gap.side_by_side import side_by_side

RIVALS = 4
"""Of an effect that are refitted in its place."""
RIVAL_MARGIN, NEARLY = 10.0, 0.01
"""Gain beyond chance within which rivals cannot be told apart; and share of an effect's gain within
which the noise that was tuned beside it may have decided against a rival."""
NEARLY_AT_FIRST = 0.1
"""`NEARLY` where neither has been in the model: its noise fits neither."""


def swap_effects(
    data: Data,
    fitted: Fit,
    neighbours: dict[str, list[Candidate]],
    progress: Progress,
    tried: int = 0,
) -> tuple[Fit, dict[int, "Compared"]]:
    """Put another effect in the place of one where that explains clearly more, or as much simpler.

    The first effect was chosen while the others were still missing. Return also how the effects of
    the model that is left compare, by their numbers. The newest has been compared by its choice,
    unless what explained more was refused then, by noise that fits neither: then `tried` are how
    many could have been taken, and what takes its place must be no chance among them.
    """
    index, compared = 0, dict[int, Compared]()
    newest = len(fitted.hypothesis.effects) - 1
    count = newest + 1 if tried else newest
    while index < count:
        effect = fitted.hypothesis.effects[index]
        if index not in compared:
            others = range(index, count)
            compared |= _compare(data, fitted, others, neighbours, progress)
        own = compared[index]
        better = [one for one in own.rivals if _takes_its_place(data, effect, own, one)]
        if index == newest:
            told = [weigh(data, own.without, one, index) for one in better]
            better = [
                one
                for one, evidence in zip(better, told, strict=True)
                if evidence.p_value * tried < ALPHA
            ]
        if better:
            best = min(better, key=lambda one: one.objective)
            _may_stand_for(neighbours, best.hypothesis.effects[-1].name, effect)
            fitted, compared = fit(data, best.hypothesis, last=best.jacobian), {}
        else:
            index += 1
    return fitted, compared


def take_one_of_curve(
    data: Data, fitted: Fit, neighbours: dict[str, list[Candidate]], progress: Progress
) -> tuple[Data, Fit]:
    """Put another friction curve, or one and one effect, in the place of all that change it.

    Where that is likelier, each model by its own noise. No single exchange leads there: beside
    another effect the curve was refined, or by its first shape alone it is none (a floor of
    x / (1 + x) passed for grip of 0.79, which was 1,400 less likely).
    """
    machine, several = data.machine, curves_in(fitted)
    if several <= {CURVE}:
        return data, fitted
    alone = len(several) == 1
    others = [] if alone else [name for name in CURVES if {name, CURVE} != several]
    by = "another law of friction" if alone else f"{' or '.join(others)} beside a curve"
    progress(f"comparing {' and '.join(sorted(several))} with {by}")
    known = {candidate.name: candidate for candidate in machine.candidates()}
    hypothesis = fitted.hypothesis
    for index, effect in reversed(list(enumerate(hypothesis.effects))):
        if effect.effect in several:
            hypothesis = hypothesis.without(index)
    bare = fit(data, hypothesis)
    if alone:
        base, offered = bare, [fit_other_law(data, bare.hypothesis)]
    else:
        [base] = refit_each(data, bare, screen(data, bare, [known[CURVE]]))
        starts = screen(data, base, [known[name] for name in others])
        offered = side_by_side(lambda start: refit_each(data, base, [start])[0], starts)
    allowed = fitted.objective + NEARLY_AT_FIRST * (bare.objective - fitted.objective)
    best, likeliest, name = (data, fitted), log_posterior(data, fitted), ""
    for one in offered:
        if one.objective > allowed or within_law(data, base, one, -1):
            continue
        try:
            other = _with_own_noise(data, one)
        except RunawayError:
            continue
        likelihood = log_posterior(*other)
        if likelihood > likeliest:
            best, likeliest, name = other, likelihood, one.hypothesis.effects[-1].name
    if not name:
        return best
    own, margin = _with_own_noise(data, fitted), 0.0
    if alone:  # a law has more numbers
        index = fitted.hypothesis.place_of(*several)
        margin = 0.5 * RIVAL_MARGIN * weigh(data, bare, fitted, index).inflation
    if likeliest <= log_posterior(*own) + margin:
        return own
    neighbours[name] = [known[other] for other in CURVES]
    return best


def curves_in(fitted: Fit) -> set[str]:
    """What changes the friction over slip in this model, the curve itself among it."""
    return {effect.effect for effect in fitted.hypothesis.effects} & {*FRICTION_OVER_SLIP}


def _takes_its_place(data: Data, effect: Candidate, own: "Compared", rival: Fit) -> bool:
    """Whether a rival explains clearly more than an effect, or loses only what chance gives."""
    without, judged = own.without, own.evidence
    evidence = weigh(data, without, rival, len(without.hypothesis.effects))
    candidate, sizes = rival.hypothesis.effects[-1], rival.hypothesis.values_of(-1)
    lost = judged.gain - evidence.gain
    spared = len(effect.parameters) - len(candidate.parameters)
    as_good = spared > 0 and no_more_than_chance(lost, judged.inflation, spared)
    if not as_good and -lost <= RIVAL_MARGIN * evidence.inflation:
        return False
    if within_law(data, without, rival, -1):
        return False
    [check] = check_unseen(data, without, [rival])
    return check.helps and not within_row(data, candidate, sizes)


def _rivals_of(
    fitted: Fit, effect: Candidate, neighbours: dict[str, list[Candidate]]
) -> list[Candidate]:
    """What promised most when this effect was chosen, and is not in the model."""
    taken = {one.name for one in fitted.hypothesis.effects}
    return [
        c
        for c in neighbours.get(effect.name, [])
        if c.name not in taken and len(c.parameters) <= len(effect.parameters)
    ]


@dataclass(frozen=True)
class Compared:
    """An effect of a fitted model beside what could stand in its place, refitted there."""

    without: Fit
    evidence: Evidence
    rivals: list[Fit]

    def lost(self, final: Fit) -> list[float]:
        """Return the gain beyond chance that is lost with each rival in the place of the effect."""
        return [(one.objective - final.objective) / self.evidence.inflation for one in self.rivals]


def _compare(
    data: Data,
    fitted: Fit,
    places: Sequence[int],
    neighbours: dict[str, list[Candidate]],
    progress: Progress,
) -> dict[int, Compared]:
    """Compare effects of the model, by their numbers, with their nearest rivals."""
    for index in places:
        progress(f"comparing {fitted.hypothesis.effects[index].name} with its rivals")
    found = side_by_side(lambda index: _compared(data, fitted, index, neighbours), places)
    return dict(zip(places, found, strict=True))


def compare_all(
    data: Data,
    fitted: Fit,
    neighbours: dict[str, list[Candidate]],
    progress: Progress,
    known: dict[int, Compared] | None = None,
) -> list[Compared]:
    """Compare every effect of the model with its nearest rivals, beside what is known of that."""
    places, known = range(len(fitted.hypothesis.effects)), known or {}
    others = [index for index in places if index not in known]
    compared = known | _compare(data, fitted, others, neighbours, progress)
    return [compared[index] for index in places]


def _compared(
    data: Data, fitted: Fit, index: int, neighbours: dict[str, list[Candidate]]
) -> Compared:
    without = fitted.refitted_without(data, index)
    evidence = weigh(data, without, fitted, index)
    rivals = _rivals_of(fitted, fitted.hypothesis.effects[index], neighbours)
    nearest = screen(data, without, rivals)[:RIVALS] if rivals else []
    return Compared(without, evidence, refit_each(data, without, nearest, evidence.gain))


def take_likeliest(
    data: Data,
    final: Fit,
    neighbours: dict[str, list[Candidate]],
    tried: int,
    progress: Progress,
    known: dict[int, Compared] | None = None,
) -> tuple[Data, Fit, list[Compared]]:
    """Put another effect in the place of one where that is likelier, each model by its own noise.

    Noise that was tuned beside a wrong name takes a part of what that leaves for chance: a delay of
    1.4 ms lost 48 to a lag by noise that fits the lag, and is likelier by exp(143) by its own. What
    is better even by the noise of the other needs no margin. No likelihood judges where a
    controller answers within rows (answers.py).
    """
    settled = set[str]()
    compared = compare_all(data, final, neighbours, progress, known)
    while likelihood_judges(data):
        near = [
            (index, rival, lost)
            for index, one in enumerate(compared)
            for rival, lost in zip(one.rivals, one.lost(final), strict=True)
            if lost < max(RIVAL_MARGIN, NEARLY * one.evidence.beyond_chance)
            and rival.hypothesis.effects[-1].name not in settled
            and not within_row(data, rival.hypothesis.effects[-1], rival.hypothesis.values_of(-1))
        ]
        if not near:
            break
        own_likelihood = log_posterior(*_with_own_noise(data, final))
        likelier = []
        for index, rival, lost in near:
            effect, name = final.hypothesis.effects[index], rival.hypothesis.effects[-1].name
            progress(f"comparing {effect.name} and {name}, each by its own noise")
            try:
                own = _with_own_noise(data, rival)
            except RunawayError:
                continue
            likelihood = log_posterior(*own)
            margin = 0.0 if lost < -RIVAL_MARGIN else 0.5 * RIVAL_MARGIN
            enough = own_likelihood + margin * compared[index].evidence.inflation
            if likelihood <= enough or within_law(data, compared[index].without, rival, -1):
                continue
            if _helps_unseen(*own, name):
                likelier.append((likelihood, *own, effect, name))
        if not likelier:
            break
        _, data, final, effect, name = max(likelier, key=lambda one: one[0])
        settled.add(effect.name)
        _may_stand_for(neighbours, name, effect)
        data, final = settle_placed(data, final)
        final = whole_numbers(data, drop_needless(data, final, tried))
        compared = compare_all(data, final, neighbours, progress)
    return data, final, compared


def drop_wandering(
    data: Data,
    final: Fit,
    neighbours: dict[str, list[Candidate]],
    progress: Progress,
    compared: list[Compared],
) -> tuple[Fit, list[Compared]]:
    """Drop weak effects, weakest first, whose size is not the same throughout the logs."""
    while True:
        told = [one.evidence for one in compared]
        curve = [effect.effect == CURVE for effect in final.hypothesis.effects]
        named = sum(one.gain for one, is_curve in zip(told, curve, strict=True) if not is_curve)
        wandering = [
            index
            for index, (one, is_curve) in enumerate(zip(told, curve, strict=True))
            if one.inflation > VARIES_SURELY and one.variation > WANDERS
            if one.gain < WEAK * named and not is_curve
        ]
        if not wandering:
            return final, compared
        final = compared[min(wandering, key=lambda index: told[index].gain)].without
        compared = compare_all(data, final, neighbours, progress)


def _with_own_noise(data: Data, fitted: Fit) -> tuple[Data, Fit]:
    """Settle a model with the noise that fits it, and refine its effects."""
    own, one = settle(data.machine, data.runs, fitted.hypothesis, data.noise, last=fitted.jacobian)
    return own, extend_effects(data.machine, own, one)


def _helps_unseen(data: Data, fitted: Fit, name: str) -> bool:
    """Whether an effect of the model helps runs that were not fitted."""
    place = fitted.hypothesis.place_of(name)
    [check] = check_unseen(data, fitted.refitted_without(data, place), [fitted.moved_last(place)])
    return check.helps


def _may_stand_for(neighbours: dict[str, list[Candidate]], name: str, effect: Candidate) -> None:
    """Note that an effect which gave way to another may stand in its place."""
    others = [c for c in neighbours.get(effect.name, []) if c.name != effect.name]
    neighbours[name] = [effect, *others]
