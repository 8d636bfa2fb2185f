import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.plateaus import PlannedDwell
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, read_acceptance, write_acceptance
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.report.run_text import acceptance_sentence

LIMITS = AcceptanceLimits(position_difference_dph=0.006)
SIGMA_DPH = 0.001
PLATEAUS_C = (60.0, 20.0, -10.0)


def dwell(
    number, position, chamber_c, bias_dph, sigma_dph=SIGMA_DPH, gyro_c=None, flags=(), cycle=1, run="1"
):
    nothing = (math.nan, math.nan, math.nan)
    gyro_c = chamber_c + 12.0 if gyro_c is None else gyro_c
    return DwellRow(
        unit="1001", run=run, dwell=number, cycle=cycle, position=position, start_s=0.0, end_s=1200.0,
        since_power_on_s=0.0, gyro_c=(gyro_c,) * 3, gyro_rate_c_per_h=nothing, bias_dph=tuple(bias_dph),
        sigma_dph=(sigma_dph,) * 3, chamber_set_c=chamber_c, chamber_c=chamber_c, case_c=math.nan,
        board_c=nothing, flags=flags,
    )  # fmt: skip


def campaign(true_dph=None, sigma_dph=SIGMA_DPH):
    """One dwell in each position and at each plateau; true biases by position for all gyros and plateaus."""
    places = [(chamber_c, position) for chamber_c in PLATEAUS_C for position in POSITIONS]
    return [
        dwell(number, position, chamber_c, ((true_dph or {}).get(position, 0.0),) * 3, sigma_dph)
        for number, (chamber_c, position) in enumerate(places, 1)
    ]


def plan_of(rows):
    return [
        PlannedDwell(row.dwell, row.cycle, row.position, row.chamber_set_c, (row.chamber_set_c,) * 3)
        for row in rows
    ]


PLANNED = plan_of(campaign())


def judged(rows, limits=LIMITS, planned=PLANNED):
    return judge(rows, limits, planned)


def test_equal_positions_are_accepted():
    result = judged(campaign())
    assert result.verdict == "accepted"
    assert result.gyros == {"x": "pass", "y": "pass", "z": "pass"}
    assert len(result.judgements) == 9
    assert not result.not_measured


def test_a_position_far_off_is_rejected_and_named():
    result = judged(campaign({"y_up": 0.03}))
    assert result.verdict == "rejected"
    deciding = result.deciding("x")
    assert deciding.worst[0] == "y_up"
    assert deciding.value_dph == pytest.approx(0.03)
    assert deciding.at_least_dph < 0.03 < deciding.at_most_dph


@pytest.mark.parametrize(
    ("difference_dph", "verdict"), [(0.002, "accepted"), (0.006, "marginal"), (0.02, "rejected")]
)
def test_near_the_limit_the_uncertainty_makes_a_marginal_band(difference_dph, verdict):
    assert judged(campaign({"z_down": difference_dph})).verdict == verdict


def test_the_bounds_by_hand():
    rows = [dwell(1, "z_up", 20.0, (0.0,) * 3, 0.003), dwell(2, "z_down", 20.0, (0.010,) * 3, 0.004)]
    result = judged(rows, LIMITS, plan_of(rows)).deciding("z")
    assert result.sigma_dph == pytest.approx(0.005)
    assert result.at_most_dph == pytest.approx(0.010 + 1.644854 * 0.005)
    # Six differences in all, each of three gyros in both orders: 0.05 / 6 beyond 2.394 sigma.
    assert result.at_least_dph == pytest.approx(max(0.010 - 2.394 * 0.005, 0.0), abs=1e-5)


def test_a_run_cut_short_is_not_judged_and_says_what_lacks():
    result = judged(campaign()[:9])
    assert result.verdict == "not judged"
    assert result.gyros["x"] == "not measured"
    lacking = {(each.chamber_set_c, each.position) for each in result.not_measured}
    assert (20.0, "x_down") in lacking
    assert (-10.0, "z_up") in lacking
    assert (60.0, "z_up") not in lacking


def test_a_run_cut_short_is_rejected_for_what_it_shows():
    assert judged(campaign({"y_up": 0.03})[:9]).verdict == "rejected"


def test_a_flagged_dwell_counts_as_not_measured():
    rows = campaign()
    rows[2] = dwell(3, "y_up", PLATEAUS_C[0], (0.0,) * 3, flags=("the INS fell silent",))
    (lacking, *_) = judged(rows).not_measured
    assert (lacking.chamber_set_c, lacking.position) == (60.0, "y_up")


def test_a_flagged_dwell_without_temperatures_does_not_part_its_stop():
    nothing = math.nan
    rows = campaign()
    rows[2] = replace(rows[2], chamber_set_c=nothing, gyro_c=(nothing,) * 3, flags=("the INS fell silent",))
    assert {each.position for each in judged(rows).not_measured} == {"y_up"}


def test_a_dwell_too_far_in_temperature_from_its_plateau_is_not_compared():
    rows = campaign()
    rows[2] = dwell(3, "y_up", PLATEAUS_C[0], (0.0,) * 3, gyro_c=PLATEAUS_C[0] + 25.0)
    result = judged(rows)
    assert result.verdict == "not judged"
    assert {each.position for each in result.not_measured if each.chamber_set_c == PLATEAUS_C[0]} >= {"y_up"}


def test_a_dwell_that_one_cycle_lacks_is_reported_although_another_has_it():
    rows = campaign()
    again = [replace(row, dwell=row.dwell + len(rows), cycle=2) for row in rows]
    planned = plan_of([*rows, *again])
    assert judged([*rows, *again], planned=planned).verdict == "accepted"
    again[2] = replace(again[2], flags=("the INS fell silent",))
    result = judged([*rows, *again], planned=planned)
    assert result.verdict == "not judged"
    assert {(each.cycle, each.position) for each in result.not_measured} == {(2, "y_up")}


def test_biases_known_too_badly_count_as_not_measured():
    limits = AcceptanceLimits(position_difference_dph=0.1, bias_sigma_dph=0.5 * SIGMA_DPH)
    assert judged(campaign(), limits).verdict == "not judged"


def test_the_size_of_the_bias_has_a_limit_of_its_own():
    limits = AcceptanceLimits(position_difference_dph=0.006, bias_dph=0.01)
    result = judged(campaign(dict.fromkeys(POSITIONS, -0.05)), limits)
    assert result.verdict == "rejected"
    deciding = result.deciding("x")
    assert (deciding.quantity, deciding.verdict) == ("bias", "fail")
    assert deciding.value_dph == pytest.approx(0.05)


def test_a_difference_decides_on_a_gyro_before_a_bias_with_the_same_verdict():
    limits = AcceptanceLimits(position_difference_dph=0.006, bias_dph=1.0)
    deciding = judged(campaign(dict.fromkeys(POSITIONS, -0.05)), limits).deciding("x")
    assert (deciding.quantity, deciding.verdict) == ("position difference", "pass")


def test_without_limits_nothing_is_judged():
    assert judged(campaign(), None) == Acceptance()
    assert Acceptance().verdict == "not judged"


def test_a_single_position_can_not_be_judged():
    rows = [dwell(1, "z_up", 20.0, (0.0,) * 3)]
    result = judged(rows, LIMITS, plan_of(rows))
    assert result.verdict == "not judged"
    assert result.deciding("x") is None


def test_positions_that_no_plateau_compares_are_not_accepted():
    pairs = (("z_up", "z_down"), ("x_up", "x_down"), ("y_up", "y_down"))
    rows = [
        dwell(10 * cycle + number, position, 20.0, (0.0,) * 3, cycle=cycle)
        for cycle, pair in enumerate(pairs, 1)
        for number, position in enumerate(pair)
    ]
    result = judged(rows, LIMITS, plan_of(rows))
    assert result.verdict == "not judged"
    assert result.unconnected == [list(pairs[0]), list(pairs[2]), list(pairs[1])]
    assert "No plateau compares Z-Up and Z-Down with Y-Up and Y-Down" in acceptance_sentence(result)
    linked = [*rows, *(replace(rows[0], dwell=10 * cycle + 5, cycle=cycle) for cycle in (2, 3))]
    linked.sort(key=lambda row: row.dwell)
    assert judged(linked, LIMITS, plan_of(linked)).verdict == "accepted"
    assert not judged(linked, LIMITS, plan_of(linked)).unconnected


def test_a_run_without_chamber_is_judged_at_the_temperature_that_it_has():
    rows = [
        dwell(number, position, math.nan, (0.0,) * 3, gyro_c=30.0)
        for number, position in enumerate(POSITIONS, 1)
    ]
    assert judged(rows, LIMITS, plan_of(rows)).verdict == "accepted"


def test_a_verdict_is_read_as_it_was_written(tmp_path):
    result = judged(campaign({"y_up": 0.03})[:9])
    write_acceptance(tmp_path / "acceptance.json", result)
    assert read_acceptance(tmp_path / "acceptance.json") == result


@pytest.mark.parametrize(
    "text", ["", "[]", '{"verdict": "splendid"}', '{"verdict": "accepted", "more": 1}', "{" * 9999]
)
def test_a_file_that_holds_no_verdict_is_refused(tmp_path, text):
    path = tmp_path / "acceptance.json"
    path.write_text(text)
    with pytest.raises(DocumentError, match=r"acceptance\.json: holds no verdict"):
        read_acceptance(path)


def test_the_difference_between_up_and_down_has_a_separate_limit():
    limits = AcceptanceLimits(position_difference_dph=0.05, vertical_difference_dph=0.01)
    result = judged(campaign({"y_up": 0.03}), limits)
    assert result.gyros == {"x": "pass", "y": "fail", "z": "pass"}
    deciding = result.deciding("y")
    assert (deciding.quantity, deciding.limit_dph) == ("vertical difference", 0.01)
    assert deciding.worst == ["y_up", "y_down"]
    assert len(result.judgements) == 18


def after_cycles(cycles, difference_dph, common_dph=0.0):
    """The judgement that decides on x, with an error of each position that is the same in each cycle."""
    rows = [
        replace(row, cycle=cycle, dwell=row.dwell + 100 * cycle)
        for cycle in range(cycles)
        for row in campaign({"y_up": difference_dph})
    ]
    units = dict(zip(POSITIONS, np.eye(len(POSITIONS)), strict=True))
    shared = {row.dwell: common_dph * np.tile(units[row.position], (3, 1)) for row in rows}
    return judge(rows, LIMITS, plan_of(rows), shared=shared).deciding("x")


@pytest.mark.parametrize("common_dph", [0.0, 0.0003])
@pytest.mark.parametrize(("difference_dph", "verdict"), [(0.0045, "pass"), (0.008, "fail")])
def test_the_stated_number_of_cycles_decides_a_marginal_gyro(difference_dph, verdict, common_dph):
    def after(cycles):
        return after_cycles(cycles, difference_dph, common_dph)

    first = after(1)
    assert not first.is_limited_by_common_errors
    decided = first.cycles_to_decide
    assert decided > 2
    assert [after(cycles).verdict for cycles in (1, 2, decided - 1, decided)] == ["marginal"] * 3 + [verdict]
    assert after(2).cycles_to_decide == pytest.approx(decided, abs=1)


def test_no_number_of_cycles_decides_where_an_error_common_to_all_is_too_large():
    for cycles in (1, 4):
        result = after_cycles(cycles, 0.0045, 0.0007)
        assert (result.verdict, result.cycles_to_decide) == ("marginal", math.inf)
        assert result.is_limited_by_common_errors
        assert result.common_sigma_dph == pytest.approx(0.0007 * math.sqrt(2.0))


def test_no_number_of_cycles_decides_a_difference_at_the_limit():
    assert judged(campaign({"y_up": 0.006})).deciding("x").cycles_to_decide > 1000


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ({"position_difference_dph": 6.0}, "6 deg/h for differences between positions is 2"),
        ({"position_difference_dph": 0.006 / 3600}, "for differences between positions is 8"),
        ({"position_difference_dph": 0.006, "bias_dph": 10.0}, "10 deg/h for biases is 6"),
    ],
)
def test_a_limit_in_another_unit_than_deg_per_h_is_in_doubt(limits, sentence):
    text = acceptance_sentence(judged(campaign(), AcceptanceLimits(**limits)))
    assert sentence in text
    assert text.endswith("Check its unit, deg/h.")


@pytest.mark.parametrize(
    ("limits_dph", "words"),
    [
        ((0.008, None, 5.0), "0.008 deg/h between positions, with"),
        ((5.0, 0.006, 5.0), "0.006 deg/h with the gyro up and down, with"),
        ((0.008, 0.006, 5.0), "0.008 deg/h between positions (0.006 with the gyro up and down), with"),
        ((5.0, None, 0.05), "0.05 deg/h for the bias, with"),
        ((0.008, 5.0, 0.05), "0.008 deg/h between positions or that of 0.05 deg/h for the bias, with"),
    ],
)
def test_only_the_limits_that_decide_a_verdict_are_named(limits_dph, words):
    names = ("position_difference_dph", "vertical_difference_dph", "bias_dph")
    limits = AcceptanceLimits(**dict(zip(names, limits_dph, strict=True)))
    text = acceptance_sentence(judged(campaign({"z_up": 0.3}), limits))
    assert f"beyond the limit of {words} 95 % confidence" in text


@pytest.mark.parametrize("largest_dph", [0.0, 0.002, 0.006, 0.05])
def test_a_limit_of_the_size_of_the_data_is_not_in_doubt(largest_dph):
    limits = AcceptanceLimits(position_difference_dph=0.008, vertical_difference_dph=0.006, bias_dph=0.2)
    assert "unit, deg/h" not in acceptance_sentence(judged(campaign({"y_up": largest_dph}), limits))
