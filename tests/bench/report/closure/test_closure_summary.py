"""A search for effects in a terminal of 80 columns."""

import io

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.report.closure.closure_summary import closure_summary
from tests.bench.report.made_up_closure import (
    ambiguous,
    clean,
    explained,
    faint,
    quiet,
    quiet_unexplained,
    unexplained,
    without_boards,
)


def printed(closure):
    stream = io.StringIO()
    Console(file=stream, width=80).print(closure_summary(closure))
    return stream.getvalue()


@pytest.mark.parametrize(
    "search", [clean, explained, ambiguous, faint, unexplained, quiet, quiet_unexplained, without_boards]
)
def test_it_fits_a_terminal_without_colour_and_nothing_is_cut_off(search):
    text = printed(search())
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    assert "\x1b" not in text
    assert "nan" not in text.split()


def test_it_begins_with_the_verdict():
    assert printed(explained()).startswith("Explained. One effect explains the residual")
    assert printed(clean()).startswith("Clean. ")


def test_effects_and_candidates_are_tables():
    lines = [line.split() for line in printed(explained()).splitlines()]
    assert ["temperature", "rate", "x", "and", "y", "none"] in [line[:6] for line in lines]
    assert ["bias", "jump", "17", "%", "<1e-9", ">10^12", "to", "1"] in lines


def test_the_error_stands_beside_its_noise():
    text = printed(explained())
    table = text[text.index("Error in cycle 3 (held out), rms in 0.001 deg/h") :].splitlines()
    assert table[1].split() == ["before", "after", "noise"]
    before, sigma_before, after, sigma_after, noise = map(float, table[3].replace("±", "").split())
    sigmas_dph = explained().error_before_sigma_dph, explained().error_after_sigma_dph
    assert (sigma_before, sigma_after) == pytest.approx(1000.0 * np.array(sigmas_dph), abs=0.005)
    assert before == pytest.approx(1000.0 * explained().error_before_dph, abs=0.005)
    assert after == pytest.approx(1000.0 * explained().error_after_dph, abs=0.005)
    assert noise == pytest.approx(2.0)


def test_without_effects_there_is_one_error():
    text = printed(clean())
    assert "Effects found" not in text
    assert text[text.index("Error in cycle") :].splitlines()[1].split() == ["error", "noise"]


def test_the_measurement_that_resolves_a_tie_is_stated():
    assert "separate the twins" in " ".join(printed(ambiguous()).split())
