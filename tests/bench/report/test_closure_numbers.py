"""Numbers behind figures and sentences of a search for effects."""

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.foundations.arrays import rms
from gyrobench.bench.report.closure_text import held_out_cycles, is_noise_only, smallest_visible_dph
from tests.bench.report.made_up_closure import EFFECTS, clean, explained, made_up_rows, unexplained


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
