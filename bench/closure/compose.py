"""Laws composed from the grammar of effects, for residuals that no known effect explains.

Every driver that the campaign has, with every memory, shape and factor, is fitted together with the effects
found. The posterior of :mod:`gyrobench.bench.closure.evidence` compares the laws with each other and with a
remainder; all laws are equally probable a priori. A law is a hypothesis from the data that it explains: only
cycles of other runs confirm it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import (
    Candidate,
    Hypothesis,
    after_fit,
    best_start,
    bic_penalty,
    fit_hypothesis,
    refine,
    solve_with,
)
from gyrobench.bench.closure.effects.effect_file import EffectFile
from gyrobench.bench.closure.effects.grammar import DRIVERS, EVENTS, driver_label, driver_values
from gyrobench.bench.closure.evidence import Evidences
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.closure.search import MAX_EFFECTS
from gyrobench.bench.closure.validation import measured_minus_model
from gyrobench.bench.foundations.arrays import FloatArray, nan_rms

#: Number of laws whose parameters are fitted: the best of all, and the best of each driver.
_FITTED, _FITTED_PER_DRIVER = 16, 3
#: Maximum number of laws that are listed, and their smallest probability.
_MAX_LISTED, _MIN_PROBABILITY = 5, 0.01
#: Drivers without a memory: time has none.
_TIMES = ("time_days", "since_power_on_h")
_SHAPES = ("linear", "polynomial", "onset", "saturation", "resonance")
#: Degree of a polynomial in the optics temperature, in which the declared model is cubic, and in other
#: drivers.
_OPTICS_DEGREE, _DEGREE = 5, 2


@dataclass(frozen=True)
class ComposedLaw:
    """A law as fitted."""

    file: EffectFile  #: As an effect file.
    candidate: Candidate  #: Its form and parameters.
    probability: float  #: Of this law, without a remainder.
    error_after_dph: float  #: Rms of measured minus predicted bias in the held-out dwells.

    @property
    def follows(self) -> str:
        """The term that the bias follows, with its parameters."""
        form = self.candidate.form
        values = ", ".join(
            f"{parameter.name} {value:.3g}"
            for parameter, value in zip(form.parameters, self.candidate.values, strict=True)
        )
        return f"{form.terms[0]}{f' ({values})' if values else ''}"


@dataclass(frozen=True)
class Composed:
    """Outcome of a search of the grammar."""

    tried: int  #: Number of laws.
    laws: tuple[ComposedLaw, ...]  #: Most probable first; at most one of each driver.
    #: Probability of each driver, summed over its laws without a remainder; most probable first.
    driver_probabilities: dict[str, float]
    #: Probability of something that no law of the grammar describes: no law, or a law and a remainder.
    other: float
    law_and_remainder: float  #: Part of ``other`` that is a law and a remainder.


def compose(problem: Problem, effects_found: Sequence[Candidate]) -> Composed:
    """Search the grammar for a law in addition to the effects found.

    ``problem`` has the declared model alone. ``effects_found``: strongest first; the weakest are dropped if
    there are as many as the search allows.
    """
    campaign, searched = problem.campaign, problem.searched
    found = list(effects_found)[: MAX_EFFECTS - 1]
    with_found = after_fit(problem, found)
    penalty, files = bic_penalty(problem), list(_all_laws(campaign, {each.effect.name for each in found}))
    starts: list[tuple[float, EffectFile, Candidate]] = []
    for file in files:
        effect = file.build()
        for form in effect.forms:
            candidate = best_start(with_found, effect, form)
            reduction, rank = with_found.chi2_reduction(candidate.columns(campaign))
            starts.append((penalty * (rank + len(candidate.values)) - reduction, file, candidate))
    chosen = _select_starts(sorted(starts, key=lambda each: each[0]))
    fitted = []
    for file, start in chosen:
        [candidate] = refine(with_found, [start])
        fitted.append((file, fit_hypothesis(problem, [*found, candidate])))
    effects = [*(each.effect for each in found), *(file.build() for file in files)]
    without_law = fit_hypothesis(problem, found) if found else Hypothesis((), problem.chi2, problem.chi2)
    best: dict[str, tuple[EffectFile, Hypothesis]] = {}
    for file, each in fitted:
        if file.effect not in best or each.is_better_than(best[file.effect][1]):
            best[file.effect] = file, each
    hypotheses = (
        Evidences(problem, effects).posterior([without_law, *(each for _, each in best.values())]).hypotheses
    )
    driver_probabilities = dict.fromkeys((file.driver for file, _ in best.values()), 0.0)
    laws = []
    for file, each in best.values():
        probability = sum(
            fit.probability
            for fit in hypotheses
            if fit.candidates is each.candidates and not fit.has_remainder
        )
        driver_probabilities[file.driver] += probability
        model = solve_with(problem, each.candidates)
        error_dph = measured_minus_model(campaign, searched, model)[~searched]
        laws.append(ComposedLaw(file, each.candidates[-1], probability, nan_rms(error_dph)))
    laws.sort(key=lambda law: -law.probability)
    best_of_driver = {law.file.driver: law for law in reversed(laws)}  # the most probable one of each driver
    listed = [
        law for law in laws if law is best_of_driver[law.file.driver] and law.probability >= _MIN_PROBABILITY
    ]
    ranked = dict(sorted(driver_probabilities.items(), key=lambda each: -each[1]))
    no_law = sum(fit.probability for fit in hypotheses if len(fit.candidates) == len(found))
    with_law = [fit for fit in hypotheses if len(fit.candidates) > len(found)]
    law_and_remainder = sum(fit.probability for fit in with_law if fit.has_remainder)
    return Composed(
        len(starts), tuple(listed[:_MAX_LISTED]), ranked, no_law + law_and_remainder, law_and_remainder
    )


def law_text(law: ComposedLaw) -> str:
    """Text of the effect file of a law."""
    content = law.file.model_dump(exclude_defaults=True)
    return (
        "# Composed from data: a hypothesis until cycles of other runs confirm it.\n"
        f"{yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)}"
    )


def _select_starts(starts: list[tuple[float, EffectFile, Candidate]]) -> list[tuple[EffectFile, Candidate]]:
    """The best starts of all, and the best of each driver."""
    chosen, counts = [], dict.fromkeys((file.driver for _, file, _ in starts), 0)
    for rank, (_, file, start) in enumerate(starts):
        if rank < _FITTED or counts[file.driver] < _FITTED_PER_DRIVER:
            counts[file.driver] += 1
            chosen.append((file, start))
    return chosen


def _all_laws(campaign: Campaign, used: set[str]) -> Iterator[EffectFile]:
    """All laws of a campaign; adds their names to ``used``."""
    columns = [each for each in campaign.columns if each not in DRIVERS]
    for driver in (*DRIVERS, *columns):
        values = driver_values(driver, campaign)
        if driver == "constant" or not np.isfinite(values).all() or np.ptp(values) == 0.0:
            continue
        for shape in _SHAPES:
            for memory in ("none",) if driver in _TIMES else ("none", "lag", "decay", "play"):
                # Few campaigns can show a nonlinear shape of decaying changes or of play.
                if shape == "linear" or memory in ("none", "lag"):
                    for factor in ("none", "up"):
                        yield _build_law(campaign, used, driver, values, shape, memory, factor)
    for event in EVENTS:
        yield _build_law(campaign, used, event, np.zeros(1), "linear", "decay", "up")


def _build_law(
    campaign: Campaign, used: set[str], driver: str, values: FloatArray, shape: str, memory: str, factor: str
) -> EffectFile:
    low, high = (float(each) for each in np.percentile(values, [2.0, 98.0]))
    span = float(np.ptp(values)) or 1.0
    dwell_s = float(np.median(campaign.end_s - campaign.start_s))
    length_s = float(campaign.end_s[-1] - campaign.start_s[0])
    centre, width = ("onset" if shape == "onset" else "centre"), [span / 50.0, span / 3.0]
    bounds = {}
    if shape in ("onset", "saturation", "resonance"):
        bounds[centre] = [low, max(high, low + 1e-6 * span)]
        bounds["half_width" if shape == "resonance" else "width"] = width
    if memory == "play":
        bounds["play"] = width
    elif memory != "none":
        bounds["tau_s"] = [dwell_s / 3.0, max(length_s / 2.0, dwell_s)]
    label = driver_label(driver) if driver not in EVENTS else driver.replace("_", " ")
    parts = [driver.replace("{axis}", "gyro"), shape, memory, factor]
    memory_text = {"none": "", "lag": " with a lag", "decay": " while it changes", "play": " with play"}[
        memory
    ]
    factor_text = "" if factor == "none" else " times gravity along the body axes"
    return EffectFile(
        effect=_unused_name("_".join(part for part in parts if part not in ("none", "linear")), used),
        statement=f"the bias follows the {label}{memory_text} by a law of shape {shape}{factor_text}",
        experiment=f"vary the {label} and hold all else, in a power cycle that the law was not composed from",
        driver=driver,
        shape=shape,  # type: ignore[arg-type]
        degree=_OPTICS_DEGREE if driver == "gyro_c" and factor == "none" else _DEGREE,
        memory=memory,  # type: ignore[arg-type]
        factor=factor,  # type: ignore[arg-type]
        bounds=bounds,
        composed_from=list(campaign.run_names),
        composed_from_dwells=campaign.fingerprints,
    )


def _unused_name(text: str, used: set[str]) -> str:
    """Name of a law that is valid in an effect file and not in ``used``, to which it is added."""
    stem = f"composed_{re.sub('[^a-z0-9]+', '_', text.lower()).strip('_')}"
    endings = ("", *(f"_{number}" for number in range(2, len(used) + 3)))
    name = next(each for ending in endings if (each := stem[: 60 - len(ending)] + ending) not in used)
    used.add(name)
    return name
