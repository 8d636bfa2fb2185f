"""A verification in sentences."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.engine.verification_runs import flags_note
from gyrobench.bench.report.verification_text import (
    change_sentences,
    comparability_sentences,
    definition_sentences,
    degradation_sentences,
    loading_problem_sentences,
    model_sentences,
    new_conditions_sentence,
    outcome,
    outcome_sentence,
)
from gyrobench.bench.verification.coefficient_verification import CoefficientRun, compare_coefficients
from gyrobench.bench.verification.compensation_verification import (
    MeasuredRun,
    VerificationResult,
    compare_runs,
)
from gyrobench.drivers.ins.compensation import Compensation
from tests.bench.report.made_up_closure import explained
from tests.bench.report.made_up_verification import (
    SITE,
    alone,
    compare,
    confirmed,
    degraded,
    improved,
    inconclusive,
    not_confirmed,
    rows_of,
    without_a_plateau,
)
from tests.bench.verification.missions_once import missions_once
from tests.bench.verification.test_coefficient_verification import rows_of as coefficients_of

COEFFICIENT_NAMES = [f"{each.name}_{each.axis}" for each in COEFFICIENTS if each.name != "gyro_bias"]
PHRASES = ("without compensation", "with the declared model", "with the effects")


@pytest.fixture(scope="module", autouse=True)
def shared_missions():
    with missions_once():
        yield


@pytest.mark.parametrize(
    ("comparison", "judgement", "reason"),
    [
        (confirmed, "confirmed", "The residual with the effects is consistent with noise"),
        (improved, "improved", "The residual with the effects exceeds the noise"),
        (not_confirmed, "not confirmed", "no improvement"),
        (inconclusive, "inconclusive", "Both residuals are consistent with noise"),
        (alone, "inconclusive", "Only the run without compensation was measured"),
    ],
)
def test_the_judgement_compares_the_varying_bias_with_the_noise(comparison, judgement, reason):
    assert outcome(comparison()) == judgement
    assert reason in outcome_sentence(comparison())


def test_a_residual_that_the_uncertainty_of_the_compensation_explains_is_said_to_be_so():
    *before, last = improved().results
    p_values = {0.116: "; the uncertainty of the compensation itself explains that (p = 0.116).", 1e-7: ")."}
    for p_value, end in p_values.items():
        total = replace(last.total, agreement_p_value=p_value)
        sentence = outcome_sentence(replace(improved(), results=(*before, replace(last, total=total))))
        assert "exceeds the noise (p" in sentence
        assert sentence.endswith(end)


def test_each_size_is_stated_for_each_compensation_with_the_noise():
    _, bias, positions, day = change_sentences(confirmed())  # no navigation showed a velocity
    assert bias.startswith("Bias in deg/h")
    assert day.startswith("Largest position error of a rotational INS in nmi")
    assert "0.04" in positions
    assert positions.count("with the") == 2
    assert "noise 0.0032" in positions


def test_new_conditions_are_counted():
    assert new_conditions_sentence(confirmed()).endswith(
        "14 of 14 dwells begin in a position and azimuth that are not in the campaign."
    )


def test_loaded_and_omitted_parts_are_stated():
    loaded = model_sentences(confirmed().closure, confirmed().models)
    assert "(a polynomial for each gyro), and one with temperature rate." in loaded[0]
    assert "are limited to the fitted range" in loaded[0]
    assert "one power cycle" in loaded[1]
    clean = model_sentences(inconclusive().closure, inconclusive().models)
    assert "No effect was found" in clean[0]


def test_notes_are_listed():
    note = "In the run without compensation 1 of 15 dwells has flags and is not used."
    assert note in change_sentences(inconclusive())
    assert (
        flags_note("effect", 2, 15)
        == "In the run with the effects 2 of 15 dwells have flags and are not used."
    )


def test_the_varying_bias_of_each_run_is_in_the_headline():
    sentence = outcome_sentence(confirmed())
    assert [phrase in sentence for phrase in PHRASES] == [True] * 3
    assert sentence.index(PHRASES[0]) < sentence.index(PHRASES[1]) < sentence.index(PHRASES[2])


@pytest.mark.parametrize("comparison", [confirmed, improved, inconclusive, alone])
def test_a_compensation_that_helps_or_changes_nothing_does_not_degrade(comparison):
    assert degradation_sentences(comparison()) == []


def test_a_model_that_is_worse_than_none_is_named_in_the_headline():
    result = degraded()
    [sentence] = degradation_sentences(result)
    none, declared, _ = (f"{each.total.varying_rms_dph:.4f}" for each in result.results)
    assert sentence == (
        "The varying bias is larger with the declared model than without compensation "
        f"({declared} against {none} deg/h): do not load this model alone, it makes this unit worse."
    )
    assert sentence in outcome_sentence(result)
    assert outcome(result) == "confirmed"
    [sentence] = degradation_sentences(not_confirmed())
    assert "do not load this model, it makes this unit worse" in sentence


def test_a_model_with_effects_that_is_better_than_the_declared_one_alone_is_not_confirmed():
    result = compare(explained(), {"none": 0.008, "declared": 0.03, "effect": 0.015})
    assert outcome(result) == "not confirmed"
    assert len(degradation_sentences(result)) == 2


def judgements(sizes_dph, seeds):
    """How often each judgement comes of runs that leave biases along Up."""
    base = confirmed()
    found = []
    for seed in range(100, 100 + seeds):
        runs = [
            MeasuredRun(name, rows_of(size, seed=10 * seed + place), [])
            for place, (name, size) in enumerate(sizes_dph.items())
        ]
        found.append(outcome(replace(base, results=compare_runs(runs, SITE, np.full((1, 3), 20.0)))))
    return Counter(found)


@pytest.mark.parametrize(
    ("size_dph", "seeds"),
    [(0.005, 8), *(pytest.param(each, 40, marks=pytest.mark.long) for each in (0.001, 0.0012, 0.005, 0.02))],
)
def test_a_compensation_that_changes_nothing_neither_improves_nor_is_confirmed(size_dph, seeds):
    for names in (("none", "effect"), ("none", "declared", "effect")):
        assert judgements(dict.fromkeys(names, size_dph), seeds).keys() <= {"not confirmed", "inconclusive"}


@cache
def coefficients_left(each_left):
    """Coefficients of which 20 is left without a compensation, and another value with the declared model."""
    left = {"none": 20.0, "declared": each_left}
    return compare_coefficients(
        [
            CoefficientRun(name, coefficients_of({each: [size] for each in COEFFICIENT_NAMES}, seed=seed), {})
            for seed, (name, size) in enumerate(left.items())
        ],
        SITE,
    )


@pytest.mark.parametrize(
    ("each_left", "along_up_dph", "judgement"),
    [
        (0.0, 0.0, "confirmed"),
        (20.0, 0.0, "not confirmed"),
        (20.0, 0.02, "not confirmed"),
        (0.0, 0.04, "not confirmed"),
        (10.0, 0.0, "improved"),
    ],
)
def test_coefficients_are_judged_beside_their_noise_and_with_the_biases(each_left, along_up_dph, judgement):
    sizes_dph = {"none": 0.02, "declared": along_up_dph}
    runs = [
        MeasuredRun(name, rows_of(size, seed=seed), []) for seed, (name, size) in enumerate(sizes_dph.items())
    ]
    results = compare_runs(runs, SITE, np.full((1, 3), 20.0))
    result = replace(confirmed(), results=results, coefficients=coefficients_left(each_left))
    assert outcome(result) == judgement


@pytest.mark.parametrize("seeds", [8, pytest.param(40, marks=pytest.mark.long)])
def test_effects_that_add_nothing_to_the_declared_model_are_not_confirmed(seeds):
    assert judgements({"none": 0.02, "declared": 0.01, "effect": 0.01}, seeds) == {"not confirmed": seeds}


def test_a_residual_that_may_have_fallen_by_chance_is_inconclusive():
    result = compare(explained(), {"none": 0.0018, "effect": 0.0})
    assert outcome(result) == "inconclusive"
    assert "consistent with noise" in outcome_sentence(result)


def test_the_change_that_was_loaded_confirms_what_is_small_and_one_that_was_not_is_stated():
    small = Compensation(
        np.zeros((3, 1)), np.full(3, -40.0), np.full(3, 80.0), gravity_dph_per_g=0.002 * np.eye(3)
    )

    def verified(left_dph, loaded):
        runs = [
            MeasuredRun("none", rows_of(0.002, seed=1), []),
            MeasuredRun("effect", rows_of(left_dph, seed=2), [], None, loaded),
        ]
        return replace(confirmed(), results=compare_runs(runs, SITE, np.full((1, 3), 20.0)))

    assert outcome(verified(0.0, None)) == "inconclusive"
    assert outcome(verified(0.0, small)) == "confirmed"
    large = replace(small, gravity_dph_per_g=0.02 * np.eye(3))
    assert loading_problem_sentences(verified(0.0, small)) == []
    [sentence] = loading_problem_sentences(verified(0.002, large))
    assert "check that the INS applies the compensation once" in sentence
    assert sentence in outcome_sentence(verified(0.002, large))


def test_a_constant_that_makes_the_bias_larger_is_stated_beside_a_residual_that_is_noise():
    runs = [
        MeasuredRun("none", rows_of(0.02, constant_dph=0.05, seed=1), []),
        MeasuredRun("effect", rows_of(0.0, constant_dph=0.1, seed=2), []),
    ]
    result = replace(confirmed(), results=compare_runs(runs, SITE, np.full((1, 3), 20.0)))
    [sentence] = loading_problem_sentences(result)
    assert "the constant loaded does not fit this power cycle" in sentence
    assert loading_problem_sentences(confirmed()) == []


def test_what_a_run_lacks_is_stated():
    missing, dwells = comparability_sentences(without_a_plateau())
    assert missing == (
        "The plateau at 32 °C (cycle 2) has no valid dwell with the declared model: it is not part of the "
        "numbers for all plateaus."
    )
    assert dwells == "11 of 14 dwells are valid in all runs; only these are compared."
    assert comparability_sentences(confirmed()) == []


def test_runs_without_a_dwell_in_common_are_not_judged():
    lost = [("none", number) for number in range(1, 15)]
    result = compare(explained(), {"none": 0.02, "effect": 0.0}, lost=lost)
    assert outcome(result) == "inconclusive"
    assert "No dwell is valid in all runs" in outcome_sentence(result)


def test_one_plateau_and_one_dwell_are_in_the_singular():
    one = replace(confirmed(), new_attitudes=1)
    assert "1 of 3 plateaus is at a gyro temperature that was not fitted (" in new_conditions_sentence(one)
    assert "1 of 14 dwells begins in a position" in new_conditions_sentence(one)


def test_every_definition_is_a_sentence():
    assert all(text.endswith(".") for text in definition_sentences(confirmed()))
    assert "Noise is the value expected" in definition_sentences(confirmed())[1]


def test_separate_power_cycles_are_stated_on_a_real_bench():
    real = VerificationResult(**{**vars(confirmed()), "is_same_seed": False})
    assert "separate power cycle and noise" in definition_sentences(real)[-1]
    assert "same emulated world and seed" in definition_sentences(confirmed())[-1]
