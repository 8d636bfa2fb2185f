"""Tables for a terminal of 80 columns without colour."""

import base64
import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.plateaus import PlannedDwell
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.foundations.text import hours_minutes
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.procedure.timeline import timeline_rows
from gyrobench.bench.report.bias_sections import acceptance_summary, bins_summary
from gyrobench.bench.report.journal_sections import KindDuration, durations_section
from gyrobench.bench.report.page import Box, Section, SectionFigure, SectionTable, render_page
from gyrobench.bench.report.terminal.tables import preflight_report, section_view, timeline_table
from gyrobench.bench.station.check_result import Check
from tests.bench.report.plain_terminal import printed, printed_lines


def coldest_of_x(bins):
    return [each for each in bins if each.gyro == "x" and each.bin_low_c == -25.0]


def test_papers_method_is_explained_where_it_is_shown(bins):
    lines = printed_lines(section_view(bins_summary(bins)))
    assert sum(line.startswith("Second line: result of the paper's method") for line in lines) == 1
    assert sum(line.startswith("The paper's method disagrees") for line in lines) == 3


def test_run_without_the_papers_method_says_why(bins):
    alone = [replace(each, paper_bias_dph=math.nan, paper_sigma_dph=math.nan) for each in bins]
    lines = printed_lines(section_view(bins_summary(alone)))
    assert not any(line.startswith("Second line") for line in lines)
    assert (
        sum(line.startswith("The paper's method needs two windows half a turn apart") for line in lines) == 1
    )


def test_bins_table_shows_bias_and_p_value(bins):
    lines = [line.replace(" ± ", "±") for line in printed_lines(section_view(bins_summary(bins)))]
    assert lines[0] == "X gyro"
    head = lines.index("Bias±standard uncertainty in 0.001 deg/h by gyro temperature") + 1
    assert " ".join(lines[head + 1].split()) == "bin / °C Z-Up Z-Down Y-Up Y-Down X-Up X-Down equal"
    coldest, by_paper = next((line, below) for line, below in pairwise(lines) if line.startswith("-25..-20"))
    assert coldest.split()[1:] == [
        "-6.8±0.6",
        "-5.0±0.6",
        "-2.1±0.6",
        "3.0±0.6",
        "5.2±0.6",
        "8.2±0.6",
        "<1e-9*",
    ]
    assert by_paper.split() == [
        *(f"{1e3 * each.paper_bias_dph:.1f}±{1e3 * each.paper_sigma_dph:.1f}" for each in coldest_of_x(bins)),
        "<1e-9*",
    ]
    assert next(line for line in lines if line.startswith("-20..5")).split()[1:] == ["empty"] * 6
    hottest = next(line for line in lines if line.startswith("75..80"))
    assert not hottest.endswith("*")
    assert [line for line in lines if line.endswith(" gyro")] == ["X gyro", "Y gyro", "Z gyro"]
    assert sum(line.startswith("The bias differs between positions") for line in lines) == 3


def test_sentences_of_a_run_without_differences_say_so(equal_bins):
    lines = printed_lines(section_view(bins_summary(equal_bins)))
    assert sum(line.startswith("No significant difference between positions") for line in lines) == 3
    assert all(line.startswith(" ") for line in lines if line.endswith("*"))
    assert any(line.endswith("*") for line in lines)


@pytest.mark.parametrize(("bias_dph", "narrowing"), [(0.9, 30.0), (123.0, 1000.0), (0.0, 0.01)])
def test_wide_numbers_put_the_uncertainty_below(bins, bias_dph, narrowing):
    wide = [
        replace(each, bias_dph=each.bias_dph - bias_dph, sigma_dph=each.sigma_dph / narrowing)
        for each in bins
        if each.gyro == "x"
    ]
    lines = printed_lines(section_view(bins_summary(wide)))
    assert sum(line.count("±") for line in lines if not line.startswith(("X gyro", "Largest"))) >= 36


@pytest.mark.parametrize("width", [60, 50])
def test_a_narrow_terminal_shows_the_bin_of_each_row_of_biases(bins, width):
    lines = printed_lines(section_view(bins_summary(bins)), width)
    first_words = [line.split(" ")[0] for line in lines if line and not line.startswith(" ")]
    assert "bin" in first_words
    lows = [
        word.split("..")[0].rstrip(".") for word in first_words if word[:1] in "-123456789" and ".." in word
    ]
    assert lows[:2] == ["-25", "-20"]


def test_p_values_are_beside_the_biases_that_they_are_of_where_uncertainties_are_below(bins):
    lines = printed_lines(section_view(bins_summary(bins)), 60)
    first = next(number for number, line in enumerate(lines) if line.startswith("-25..-20"))
    assert [line.endswith("<1e-9*") for line in lines[first : first + 4]] == [True, False, True, False]
    assert ["±" in line for line in lines[first : first + 4]] == [False, True, False, True]


def test_both_bins_that_divide_a_plateau_show_the_p_value_of_their_positions(bins):
    first, *others = coldest_of_x(bins)
    moved = [replace(first, bin_low_c=-20.0, bin_high_c=-15.0), *others]
    lines = printed_lines(section_view(bins_summary(moved)))
    assert [line.split()[-1] for line in lines if line.startswith(("-25..-20", "-20..-15"))] == ["<1e-9*"] * 2


def test_single_position_is_not_compared_and_that_is_said_once(bins):
    alone = [each for each in bins if each.position == "z_up"]
    lines = printed_lines(section_view(bins_summary(alone)))
    assert sum(line.startswith("Nothing to compare") for line in lines) == 1
    assert not any("p equal" in line for line in lines)


def test_a_gyro_without_anything_to_compare_says_so_beside_the_others(bins):
    some = [each for each in bins if each.position == "z_up" or each.gyro == "y"]
    lines = printed_lines(section_view(bins_summary(some)))
    assert sum(line.startswith("Nothing to compare") for line in lines) == 2


def test_run_without_biases_says_so():
    assert printed_lines(section_view(bins_summary([])))[0].startswith("No dwell gave a bias")


@pytest.mark.parametrize("name", ["six_position_fig7", "ten_minute_check", "three_temperature_shift"])
def test_timeline_shows_all_rows_and_the_total(name):
    plan = expand(*load_procedure(find_document("procedures", name)))
    rows = timeline_rows(plan)
    lines = printed_lines(timeline_table(rows, plan.duration_s))
    starts = [line.split()[0] for line in lines if line[:5].strip()]
    assert [hours_minutes(row.start_s) for row in rows] == [start for start in starts if start[0].isdigit()]
    assert lines[-1].split()[0] == "all"
    assert lines[-1].split()[-1] == str(plan.dwell_count)


def test_durations_by_kind_end_with_all():
    lines = printed_lines(
        section_view(
            durations_section(
                [KindDuration("go to", 60, 1380.0, 1500.0), KindDuration("soak", 1, 5400.0, 3700.0)]
            )
        )
    )
    assert lines[-1].split()[:4] == ["all", "61", "1:53:00", "1:26:40"]
    assert ["go", "to", "60", "0:23:00", "0:25:00"] in [line.split()[:5] for line in lines]


def test_nothing_done_says_so():
    assert printed_lines(section_view(durations_section([]))) == [
        "Planned and actual duration",
        "No step was finished.",
    ]


LONG = "can't open /dev/serial/by-id/usb-adapter-of-the-chamber: [Errno 2] No such file or directory"
CHECKS = [
    Check.of("rate table", "answers", True, "Acutrol", "never said"),
    Check.of("chamber", "answers", False, LONG, "Check the cable."),
    Check.skipped("disk", "space for the run", "unknown", "Give --procedure."),
]


def test_every_check_is_stated_in_80_columns_with_what_to_do_where_it_did_not_pass():
    text = printed(preflight_report(CHECKS))
    lines = [line.split() for line in text.splitlines()]
    assert ["pass", "answers", "Acutrol"] in lines
    assert lines.index(["rate", "table"]) < lines.index(["chamber"]) < lines.index(["disk"])
    assert "FAIL    answers" in text
    assert "Check the cable." in text
    assert "Give --procedure." in text
    assert "never said" not in text


def test_the_sum_says_whether_the_bench_is_ready():
    assert "1 passed, 1 failed, 1 skipped: not ready for a run." in printed(preflight_report(CHECKS))
    assert "1 passed, 0 failed, 1 skipped: ready for a run as far as checked." in printed(
        preflight_report([CHECKS[0], CHECKS[2]])
    )


def printed_acceptance(acceptance):
    return printed_lines(section_view(acceptance_summary(acceptance)))


@pytest.mark.parametrize(
    ("limit_dph", "verdict"), [(0.1, "accepted"), (0.0165, "marginal"), (0.006, "rejected")]
)
def test_each_gyro_has_one_line_and_the_unit_a_verdict(dwells, limit_dph, verdict):
    lines = printed_acceptance(judge(dwells, AcceptanceLimits(position_difference_dph=limit_dph)))
    assert [line[:6] for line in lines if line[1:6] == " gyro"] == ["X gyro", "Y gyro", "Z gyro"]
    assert " ".join(lines).count(f"Unit {verdict}.") == 1


def test_a_run_without_limits_says_so():
    assert printed_acceptance(Acceptance()) == ["Unit not judged. The procedure has no acceptance limits."]


def test_what_was_not_measured_is_counted(dwells):
    limits = AcceptanceLimits(position_difference_dph=0.1)
    planned = [PlannedDwell(900 + i, 9, name, 99.0, (99.0,) * 3) for i, name in enumerate(("z_up", "z_down"))]
    lines = printed_acceptance(judge(dwells, limits, planned))
    text = " ".join(lines)
    assert "Unit not judged. 2 planned dwells were not compared with the others of the plateau" in text
    assert "Measure all positions of cycle 9 at 99 °C in the chamber again in one power cycle." in text


def test_a_run_without_comparisons_says_so(dwells):
    assert printed_acceptance(judge(dwells[:1], AcceptanceLimits(position_difference_dph=0.1))) == [
        "Unit not judged. No plateau has good dwells in two positions."
    ]


def test_a_marginal_unit_has_the_number_of_cycles_that_decide(dwells):
    text = " ".join(printed_acceptance(judge(dwells, AcceptanceLimits(position_difference_dph=0.0165))))
    assert re.search(r"too large for a verdict. \d+ cycles in one run, instead of 2, give one", text), text


def test_a_marginal_unit_that_no_number_of_cycles_decides_has_the_reason(dwells):
    limits = AcceptanceLimits(position_difference_dph=0.0165)
    shared = {row.dwell: np.diag(row.sigma_dph) for row in dwells}
    of_positions = {row.dwell: shared[row.dwell] * (-1.0) ** row.dwell for row in dwells}
    text = " ".join(printed_acceptance(judge(dwells, limits, shared=of_positions)))
    assert "More cycles do not decide, because 0.0" in text


def test_a_separate_limit_of_up_and_down_is_stated(dwells):
    limits = AcceptanceLimits(position_difference_dph=0.2, vertical_difference_dph=0.1)
    assert "0.2 deg/h between positions (0.1 with the gyro up and down)" in " ".join(
        printed_acceptance(judge(dwells, limits))
    )


def test_micro_g_has_one_form_on_page_and_terminal_and_names_stay():
    drift = "20 ug/h (ug): accelerometer_x_ug of runs/ug"
    section = Section(
        drift,
        boxes=[Box("open", drift, drift, [drift])],
        paragraphs=[drift],
        facts={"unit": drift},
        tables=[SectionTable(drift, ["ug", "1"], [[drift, "5 ug/sqrt(Hz)\n3 ug"]])],
    )
    text = printed(section_view(replace(section, title="")))
    for shown in (text, "".join(render_page(section, drift, ""))):
        assert "20 µg/h (µg): accelerometer_x_ug of" in " ".join(shown.split())
        assert "5 µg/sqrt(Hz)" in shown
        assert not re.search(r"[\d(>] ?ug", shown)
        assert "runs/ug" in shown


def test_a_figure_on_a_page_keeps_each_byte(tmp_path):
    figure = tmp_path / "figure.png"
    figure.write_bytes(base64.b64decode("A+ug+/ug"))
    section = Section("Run", figures=[SectionFigure("figure", "Biases", figure)])
    assert "base64,A+ug+/ug" in "".join(render_page(section, "runs/a", ""))
