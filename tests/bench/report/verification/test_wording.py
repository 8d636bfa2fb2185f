"""What is said of a compensation that was tried on new measurements."""

import pytest

from gyrobench.bench.report.verification.wording import (
    chain,
    model_sentences,
    newness_sentence,
    outcome,
    outcome_sentence,
    reading_sentences,
)
from gyrobench.bench.verification.comparison import Comparison
from tests.bench.report.made_up_comparison import alone, better, confirmed, not_confirmed, nothing_to_tell


@pytest.mark.parametrize(
    ("comparison", "judgement", "reason"),
    [
        (confirmed, "confirmed", "Noise accounts for what is left"),
        (better, "better", "More is left than noise"),
        (not_confirmed, "not confirmed", "no better"),
        (nothing_to_tell, "nothing to tell", "Neither leaves more than noise"),
        (alone, "nothing to tell", "nothing to compare with"),
    ],
)
def test_the_judgement_rests_on_what_varies_against_the_noise(comparison, judgement, reason):
    assert outcome(comparison()) == judgement
    assert reason in outcome_sentence(comparison())


def test_each_size_is_told_for_each_compensation_with_the_noise():
    topics = dict(chain(confirmed()))
    assert list(topics) == ["New", "Bias", "Positions", "24 h"]  # no navigation showed a velocity
    assert "0.04" in topics["Positions"]
    assert topics["Positions"].count("with the") == 2
    assert "noise alone shows 0.0032" in topics["Positions"]


def test_what_is_new_is_counted():
    assert newness_sentence(confirmed()).endswith(
        "14 of 14 dwells begin in a position and azimuth that no dwell of the campaign began in."
    )


def test_what_is_loaded_is_told_and_what_is_not():
    loaded = model_sentences(confirmed().closure, confirmed().models)
    assert "a polynomial for each gyro, and one with temperature rate." in loaded[0]
    assert "are held at these" in loaded[0]
    assert "one power-on" in loaded[1]
    clean = model_sentences(nothing_to_tell().closure, nothing_to_tell().models)
    assert "there is no effect to add" in clean[0]


def test_notes_are_told():
    assert ("Note", "In the run none 1 of 15 dwells have flags.") in chain(nothing_to_tell())


def test_power_ons_of_their_own_are_told_where_the_bench_is_real():
    real = Comparison(**{**vars(confirmed()), "is_same_seed": False})
    assert "a power-on and noise of its own" in reading_sentences(real)[-1]
    assert "same seed" in reading_sentences(confirmed())[-1]
