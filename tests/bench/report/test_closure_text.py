"""Numbers behind figures and sentences of a search for effects."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loadable_model import declared_model
from gyrobench.bench.closure.loop import close_loop, without_search
from gyrobench.bench.closure.quantity import GYRO_BIAS
from gyrobench.bench.foundations.arrays import rms
from gyrobench.bench.report import closure_text
from gyrobench.bench.report.closure_page import closure_sections
from gyrobench.bench.report.closure_text import held_out_cycles, is_noise_only, smallest_visible_dph
from gyrobench.bench.report.verification_text import model_sentences
from tests.bench.report.made_up_closure import (
    EFFECTS,
    SENSITIVITY,
    ambiguous,
    clean,
    explained,
    faint,
    made_up_rows,
    quiet,
    quiet_unexplained,
    unexplained,
    without_boards,
)


def test_the_residuals_of_the_dwells_held_out_give_the_errors_of_the_closure():
    closure = explained()
    held_out = ~closure.searched
    assert rms(closure.residuals_dph(closure.declared)[held_out]) == pytest.approx(closure.error_before_dph)
    assert rms(closure.residuals_dph(closure.model)[held_out]) == pytest.approx(closure.error_after_dph)


def test_the_mean_of_a_run_not_searched_is_removed():
    closure = close_loop(campaign_of(made_up_rows(runs=3)), effects=EFFECTS)
    assert closure.residuals_dph(closure.model)[~closure.searched].mean(axis=0) == pytest.approx(
        0.0, abs=1e-12
    )


def test_only_a_clean_campaign_is_noise_only():
    assert is_noise_only(clean())
    assert not is_noise_only(explained())
    assert not is_noise_only(unexplained())


@pytest.mark.parametrize(("part", "verdict"), [(0.5, "clean"), (2.0, "explained")])
def test_an_effect_is_found_from_about_the_stated_size(part, verdict):
    limit_dph = smallest_visible_dph(clean())
    slope = clean().campaign.rate_c_per_h[clean().searched, 0]
    rows = made_up_rows([part * limit_dph / np.std(slope), 0.0, 0.0])
    assert close_loop(campaign_of(rows), effects=EFFECTS).verdict == verdict


def test_held_out_cycles_are_named_in_a_sentence():
    assert held_out_cycles(explained()) == "cycle 3"
    two = close_loop(campaign_of(made_up_rows(cycles=4)), [2, 4], EFFECTS)
    assert held_out_cycles(two) == "cycles 2 and 4"


@pytest.mark.parametrize(
    ("search", "verdict", "said"),
    [
        (clean, "clean", "the residual of the declared model is noise"),
        (explained, "explained", "is the best of those tried: temperature rate (P > 0.999)."),
        (ambiguous, "ambiguous", "temperature rate (P = 0.50) or twin (P = 0.50)"),
        (unexplained, "unexplained", "no candidate effect explains it"),
    ],
)
def test_each_verdict_has_a_sentence(search, verdict, said):
    assert search().verdict == verdict
    assert said in closure_text.verdict_sentence(search())


def test_a_tie_beside_an_unexplained_residual_names_both_causes_and_what_is_left():
    sentence = closure_text.verdict_sentence(replace(ambiguous(), verdict="unexplained"))
    assert sentence.endswith(
        "A part is explained by temperature rate (P = 0.50) or twin (P = 0.50), which the data do not "
        "distinguish; a residual remains."
    )


def test_an_effect_that_may_be_there_too_is_named_beside_the_one_found():
    closure = ambiguous()
    [found] = [replace(each, tied_with=()) for each in closure.effects]
    alone, twin = closure.posterior.hypotheses[:2]
    both = replace(twin, names=alone.names | twin.names, probability=0.25)
    weighed = replace(closure.posterior, hypotheses=(replace(alone, probability=0.75), both))
    assert closure_text.verdict_sentence(replace(closure, effects=(found,), posterior=weighed)) == (
        "An effect is present, but temperature rate (P > 0.999) alone, temperature rate with twin "
        "(P = 0.25), and twin instead of temperature rate can't be distinguished."
    )


def test_one_cycle_that_was_not_searched_is_compensated_by_the_declared_model():
    closure = without_search(campaign_of(made_up_rows(cycles=1)))
    assert (closure.verdict, closure.effects, closure.searched.all()) == ("not searched", (), True)
    assert "a second cycle" in closure_text.verdict_sentence(closure)
    models = {"declared": declared_model(closure)}
    assert "No effect was searched." in model_sentences(closure, models)[0]


def test_without_an_accepted_effect_the_most_probable_cause_is_stated_with_the_objection():
    assert faint().verdict == "ambiguous"
    assert not faint().effects
    assert faint().posterior.no_effect_probability < 0.5
    sentence = closure_text.verdict_sentence(faint())
    assert sentence.startswith("It is not settled whether the residual is noise (P = 0.32, required 0.5).")
    assert (
        "The most probable effect, temperature rate (P = 0.68), is not accepted: not significant (p = 0.002"
        in sentence
    )


def test_the_residual_is_compared_with_the_noise():
    assert "is 0.0050 deg/h rms in the 96 dwells searched" in closure_text.declared_residual_sentence(
        explained()
    )
    assert "noise of a measured bias is 0.0020 deg/h" in closure_text.declared_residual_sentence(explained())
    assert "The lack of fit is significant (p < 1e-9)" in closure_text.declared_residual_sentence(explained())
    assert "The residual is consistent with noise" in closure_text.declared_residual_sentence(clean())


def test_an_effect_has_its_p_value_and_cross_validation():
    [sentence] = closure_text.effect_sentences(explained())
    assert "on the x and y gyros" in sentence
    assert "p < 1e-9, corrected for 5 candidate fits." in sentence
    assert "85 % of chi2 in cycle 1 and 86 % of chi2 in cycle 2" in sentence


def test_an_effect_that_a_cycle_contradicts_is_said_to_depend_on_the_one_held_out():
    closure = explained()
    assert "depends on which cycle" not in " ".join(closure_text.effect_sentences(closure))
    first = replace(closure.effects[0], gains={1: 0.9, 2: -0.3})
    [sentence, *_] = closure_text.effect_sentences(replace(closure, effects=(first,)))
    assert sentence.endswith("It depends on which cycle is held out: cycle 2 contradicts it.")


def test_rejected_effects_are_listed_by_reason():
    closure = explained()
    assert closure_text.rejection_sentences(closure) == [
        "Rejected although significant alone: bias jump. Reason: not significant beside temperature rate."
    ]
    beside = "not significant beside temperature rate (p = {}, required below 0.001)"
    reasons = [
        "",
        beside.format(0.02),
        beside.format(0.3),
        "it rests on dwell 7 alone (p = 0.1 without it)",
        "",
    ]
    evidence = tuple(
        replace(each, rejected=reason) for each, reason in zip(closure.evidence, reasons, strict=True)
    )
    first, second, third = (each.effect.display_name for each in evidence[1:4])
    assert closure_text.rejection_sentences(replace(closure, evidence=evidence)) == [
        f"Rejected although significant alone: {first} (p = 0.02) and {second} (p = 0.3). "
        "Reason: not significant beside temperature rate.",
        f"Rejected although significant alone: {third} (p = 0.1 without it). "
        "Reason: it rests on dwell 7 alone.",
    ]


def test_an_effect_beside_which_noise_is_not_excluded_is_called_likely():
    closure = ambiguous()
    assert closure_text.verdict_sentence(closure).startswith("An effect is present, but")
    weighed = [
        replace(
            each, probability=0.2 if not each.names and not each.has_remainder else 0.8 * each.probability
        )
        for each in closure.posterior.hypotheses
    ]
    likely = replace(closure, posterior=replace(closure.posterior, hypotheses=tuple(weighed)))
    assert closure_text.verdict_sentence(likely).startswith("An effect is likely (P = 0.80), but")


def test_the_best_alternative_has_its_share_and_odds():
    assert "bias jump alone (explains 17 % of the excess variance)" in closure_text.alternative_sentence(
        explained()
    )
    assert "prefer temperature rate by odds of more than 10^12 to 1" in closure_text.alternative_sentence(
        explained()
    )
    assert "do not prefer temperature rate" in closure_text.alternative_sentence(ambiguous())
    assert "explains 3 % of the excess variance" in closure_text.alternative_sentence(unexplained())
    assert closure_text.alternative_sentence(clean()) == ""


def test_without_excess_variance_there_are_p_values_and_no_shares():
    assert quiet().verdict == "explained"
    assert "%" not in closure_text.alternative_sentence(quiet())
    assert quiet_unexplained().verdict == "unexplained"
    sentence = closure_text.alternative_sentence(quiet_unexplained())
    assert "most significant candidate alone" in sentence
    assert "%" not in sentence


def test_a_tie_comes_with_the_measurement_that_resolves_it():
    tie, separating = closure_text.tie_sentences(ambiguous())
    assert "Tied with temperature rate: twin." in tie
    assert "separate the twins" in separating
    assert closure_text.tie_sentences(explained()) == ["No other candidate of those tried fits equally well."]
    assert closure_text.tie_sentences(clean()) == []


def test_effects_not_fitted_are_listed_with_the_missing_input():
    [sentence] = closure_text.missing_input_sentences(without_boards())
    assert sentence.startswith("Not fitted: thermal gradient. Missing input: temperature sensors")
    assert closure_text.missing_input_sentences(explained()) == []


def test_the_held_out_error_is_stated_before_and_after_with_the_noise():
    sentence = closure_text.held_out_error_sentence(explained())
    assert "In cycle 3 (held out, 48 dwells)" in sentence
    assert re.search(
        r"0\.00506 ± 0\.000\d+ deg/h rms with the declared model and 0\.00\d+ ± 0\.000\d+", sentence
    )
    assert "the noise is 0.0020 deg/h. A predicted bias has a standard uncertainty of 0.000" in sentence
    sentence = closure_text.held_out_error_sentence(clean())
    assert " and " not in sentence.partition("predicted bias")[2].partition(";")[0]
    assert re.search(r"Noise and this uncertainty explain the errors \(p = [01]\.\d+\)\.$", sentence)


def test_a_removed_mean_is_stated():
    assert closure_text.removed_means_sentence(explained()) == ""
    closure = close_loop(campaign_of(made_up_rows(runs=3)), effects=EFFECTS)
    assert "1 power cycle that the search did not use" in closure_text.removed_means_sentence(closure)


def test_the_remaining_residual_is_located_or_noise():
    assert "7.3 times the noise" in closure_text.remaining_residual_sentence(unexplained())
    assert "follows neither" in closure_text.remaining_residual_sentence(explained())


def test_scatter_above_the_stated_uncertainties_is_stated():
    closure = close_loop(campaign_of(made_up_rows(SENSITIVITY, scatter=1.3)), effects=EFFECTS)
    [sentence] = closure.noise.sentences(GYRO_BIAS, is_structureless=True)
    assert sentence.startswith("The noise is 1.")
    assert "times the stated uncertainties; the residual has no structure" in sentence
    assert explained().noise.sentences(GYRO_BIAS, is_structureless=True) == []


def test_a_gyro_that_scatters_otherwise_than_stated_is_named():
    rows = made_up_rows()
    rows = [
        replace(row, sigma_dph=(row.sigma_dph[0], row.sigma_dph[1] / 3.0, row.sigma_dph[2])) for row in rows
    ]
    [sentence] = close_loop(campaign_of(rows), effects=EFFECTS).noise.sentences(
        GYRO_BIAS, is_structureless=True
    )
    assert re.match(r"The noise of the y gyro is [23]\.\d\d times the stated uncertainties; ", sentence)


def test_a_clean_search_states_its_sensitivity():
    assert "An effect on one gyro is detectable from about 0.00076 deg/h" in sentences(clean())
    assert "is detectable from about" not in sentences(explained())


def sentences(closure):
    return " ".join(text for section in closure_sections(closure) for text in section.paragraphs)
