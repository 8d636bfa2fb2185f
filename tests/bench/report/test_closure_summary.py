"""A search for effects in a terminal of 80 columns."""

import io

import pytest
from rich.console import Console

from gyrobench.bench.report.closure_page import closure_findings
from gyrobench.bench.report.terminal.tables import section_view
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
    Console(file=stream, width=80).print(section_view(closure_findings(closure).chapter))
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
    assert printed(explained()).splitlines()[1].startswith("Explained. One effect explains the residual")
    assert printed(clean()).splitlines()[1].startswith("Clean. ")


def test_effects_and_candidates_are_tables():
    lines = [line.split() for line in printed(explained()).splitlines()]
    assert ["temperature", "rate", "x", "and", "y", "none"] in [line[:6] for line in lines]
    assert ["bias", "jump", "17", "%", "<1e-9", ">10^12", "to", "1"] in lines


def test_the_error_stands_beside_its_noise():
    rows = {line[:22].strip(): line[22:].split() for line in printed(explained()).splitlines()}
    for name, error_dph in (
        ("declared model", explained().error_before_dph),
        ("with the effects found", explained().error_after_dph),
        ("noise", 0.002),
    ):
        assert float(rows[name][3]) == pytest.approx(1000.0 * error_dph, abs=0.005)


def test_without_effects_there_is_one_error():
    text = printed(clean())
    assert "with the effects found" not in text
    assert "declared model " in text


def test_the_measurement_that_resolves_a_tie_is_stated():
    assert "separate the twins" in " ".join(printed(ambiguous()).split())
