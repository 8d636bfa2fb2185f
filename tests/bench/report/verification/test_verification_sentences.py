"""A verification in sentences."""

import pytest

from gyrobench.bench.report.verification.verification_text import (
    change_sentences,
    model_sentences,
    new_conditions_sentence,
    outcome,
    outcome_sentence,
    reading_sentences,
)
from gyrobench.bench.verification.compensation_verification import VerificationResult
from tests.bench.report.made_up_verification import alone, confirmed, improved, inconclusive, not_confirmed


@pytest.mark.parametrize(
    ("comparison", "judgement", "reason"),
    [
        (confirmed, "confirmed", "The residual is consistent with noise"),
        (improved, "improved", "The residual exceeds the noise"),
        (not_confirmed, "not confirmed", "no improvement"),
        (inconclusive, "inconclusive", "Both residuals are consistent with noise"),
        (alone, "inconclusive", "Only one compensation was measured"),
    ],
)
def test_the_judgement_compares_the_varying_bias_with_the_noise(comparison, judgement, reason):
    assert outcome(comparison()) == judgement
    assert reason in outcome_sentence(comparison())


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
    assert "In the run none 1 of 15 dwells have flags." in change_sentences(inconclusive())


def test_every_definition_is_a_sentence():
    assert all(text.endswith(".") for text in reading_sentences(confirmed()))
    assert "Noise is the value expected" in reading_sentences(confirmed())[1]


def test_separate_power_cycles_are_stated_on_a_real_bench():
    real = VerificationResult(**{**vars(confirmed()), "is_same_seed": False})
    assert "separate power cycle and noise" in reading_sentences(real)[-1]
    assert "same emulated world and seed" in reading_sentences(confirmed())[-1]
