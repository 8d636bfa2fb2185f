"""The chain from residual to cause in sentences."""

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.report.closure import closure_text as wording
from tests.bench.report.made_up_closure import (
    EFFECTS,
    SENSITIVITY,
    ambiguous,
    clean,
    explained,
    made_up_rows,
    quiet,
    quiet_unexplained,
    unexplained,
    without_boards,
)


@pytest.mark.parametrize(
    ("search", "verdict", "said"),
    [
        (clean, "clean", "what it leaves is noise"),
        (explained, "explained", "one cause, which the data tell from all else tried: temperature rate"),
        (ambiguous, "ambiguous", "temperature rate fits best, twin nearly as well"),
        (unexplained, "unexplained", "no effect tried accounts for it"),
    ],
)
def test_each_verdict_is_said_in_plain_words(search, verdict, said):
    assert search().verdict == verdict
    assert said in wording.verdict_sentence(search())


def test_the_residual_stands_beside_the_noise_with_its_test():
    assert "leaves 0.0050 deg/h rms in the 96 dwells searched" in wording.before_sentence(explained())
    assert "noise of a measured bias is 0.0020 deg/h" in wording.before_sentence(explained())
    assert "Chance does not explain that (p < 1e-09)" in wording.before_sentence(explained())
    assert "Chance explains that" in wording.before_sentence(clean())


def test_the_cause_comes_with_chance_and_the_cycles_left_out():
    [cause] = wording.cause_sentences(explained())
    assert "on the x and y gyros" in cause
    assert "Chance gives as much with p < 1e-09" in cause
    assert "85 % in cycle 1 and 86 % in cycle 2, each left out in its turn" in cause


def test_what_comes_next_is_told_with_how_far_it_is_behind():
    assert "bias jump alone comes nearest, with 17 %" in wording.runner_up_sentence(explained())
    assert "prefer temperature rate to it by more than 10^12 to 1" in wording.runner_up_sentence(explained())
    assert "do not prefer temperature rate to it" in wording.runner_up_sentence(ambiguous())
    assert "takes away 3 %" in wording.runner_up_sentence(unexplained())
    assert wording.runner_up_sentence(clean()) == ""


def test_where_nothing_is_beyond_the_noise_there_are_chances_in_the_place_of_shares():
    assert quiet().verdict == "explained"
    assert "%" not in wording.runner_up_sentence(quiet())
    assert quiet_unexplained().verdict == "unexplained"
    sentence = wording.runner_up_sentence(quiet_unexplained())
    assert "chance gives as much" in sentence
    assert "%" not in sentence


def test_a_tie_comes_with_the_measurement_that_splits_it():
    tie, separating = wording.tie_sentences(ambiguous())
    assert "twin would do nearly as well" in tie
    assert "separate the twins" in separating
    assert wording.tie_sentences(explained()) == ["Nothing else that was tried would do in its place."]
    assert wording.tie_sentences(clean()) == []


def test_effects_that_lack_an_input_are_named_with_it():
    [sentence] = wording.lacks_sentences(without_boards())
    assert sentence.startswith("Not tried: thermal gradient, for want of temperature sensors")
    assert wording.lacks_sentences(explained()) == []


def test_the_error_is_told_before_and_after_with_the_noise_beside_it():
    sentence = wording.error_sentence(explained())
    assert "In cycle 3, which the search did not see (48 dwells)" in sentence
    assert "0.0051 deg/h rms by the declared model and 0.0020 with temperature rate" in sentence
    assert "its noise is 0.0020 deg/h" in sentence
    assert "with" not in wording.error_sentence(clean()).partition("predicted bias")[2]


def test_a_constant_that_nobody_could_know_is_told():
    assert wording.constants_sentence(explained()) == ""
    closure = close_loop(campaign_of(made_up_rows(runs=3)), effects=EFFECTS)
    assert "1 run that the search did not see" in wording.constants_sentence(closure)


def test_what_is_left_is_told_with_its_whereabouts():
    assert "7.3 times the noise" in wording.after_sentence(unexplained())
    assert "follows neither" in wording.after_sentence(explained())


def test_scatter_beyond_the_stated_uncertainties_is_told():
    closure = close_loop(campaign_of(made_up_rows(SENSITIVITY, scatter=1.3)), effects=EFFECTS)
    assert wording.scale_sentence(closure).startswith("The biases scatter 1.2")
    assert wording.scale_sentence(explained()) == ""


def test_a_clean_search_says_what_it_would_have_seen():
    assert dict(wording.chain(clean()))["Limit"].startswith("An effect on one gyro from about 0.00076 deg/h")
    assert "Limit" not in dict(wording.chain(explained()))


def test_the_chain_begins_with_the_residual_and_ends_with_what_is_left():
    topics = [topic for topic, _ in wording.chain(explained()) if topic]
    assert topics == ["Residual", "Cause", "Rivals", "Held out", "Left"]


@pytest.mark.parametrize(
    ("size_dph", "text"),
    [(0.0092, "0.0092"), (0.00002, "0.000020"), (0.12, "0.12"), (3.21, "3.2"), (0.0, "0")],
)
def test_sizes_have_two_digits_and_no_exponent(size_dph, text):
    assert wording.size_text(size_dph) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [(1.0, "100 %"), (1.02, "100 %"), (0.99996, "99.9 %"), (0.987, "98.7 %"), (0.4, "40 %"), (-0.001, "0 %")],
)
def test_less_than_all_is_never_rounded_to_all(share, text):
    assert wording.share_text(share) == text


@pytest.mark.parametrize(
    ("odds", "text"), [(1.0, "1 to 1"), (30.0, "30 to 1"), (1e5, "10^5 to 1"), (1e40, ">10^12 to 1")]
)
def test_odds_read_as_odds(odds, text):
    assert wording.odds_text(2.0 * np.log(odds)) == text
