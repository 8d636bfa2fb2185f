"""How often a verdict is wrong where temperature, cycles and power-ons do what real ones do."""

import math
from collections import Counter

import numpy as np
import pytest

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.plateaus import PlannedDwell
from gyrobench.bench.bias.verdicts import AcceptanceLimits
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.procedure_file import load_procedure

LIMIT_DPH = 0.006
LIMITS = AcceptanceLimits(position_difference_dph=LIMIT_DPH)
SIGMA_DPH = 0.0011
SIGMAS_DPH = np.full((len(POSITIONS), 3), SIGMA_DPH)
PLATEAUS_C = (72.5, 32.5, 2.5, -22.5)


@pytest.fixture(params=[20, pytest.param(60, marks=pytest.mark.long)])
def draws(request):
    """Number of runs of a unit; the quick ones find what is wrong by far."""
    return request.param


def most(draws):
    """Errors in some draws with a chance of 5 % each, with three standard deviations of luck."""
    return draws * 0.05 + 3 * math.sqrt(draws * 0.05 * 0.95)


def steady(place):
    return 0.0


def drifting(place):
    """Temperature above that of the plateau, K: 4.8 K in the course of it, as the positions go on."""
    return -2.4 + 4.8 * place / 5


def one_power_on(cycle, plateau, place):
    return 0


def verdicts(
    true_dph,
    draws,
    *,
    drift=steady,
    cycles=2,
    power_on=one_power_on,
    turn_on_dph=0.0,
    plateaus_c=PLATEAUS_C,
    shared_dph=0.0,
    sigma_dph=SIGMAS_DPH,
    scatter_dph=None,
    limits=LIMITS,
):
    """Count the verdicts on runs of a unit.

    ``true_dph``: biases of the three gyros from cycle, index of the plateau, index of the position, and
    temperature; ``drift``, ``power_on``: temperature within the plateau, and number of the power-on;
    ``turn_on_dph``: standard deviation of the constants of the power-ons; ``shared_dph``: part of the
    standard uncertainty by an error of each position that is the same in all its dwells; ``sigma_dph``,
    ``scatter_dph`` (6, 3): standard uncertainties by position and gyro, and the scatter; by default as large.
    """
    random = np.random.default_rng(1)
    places = [(c, s, p) for c in range(cycles) for s in range(len(plateaus_c)) for p in range(len(POSITIONS))]
    names = tuple(POSITIONS)
    found = Counter()
    for _ in range(draws):
        constants = random.normal(0.0, turn_on_dph, (2, 3))
        of_positions = random.normal(0.0, shared_dph, (len(names), 3))
        own_dph = np.sqrt((sigma_dph if scatter_dph is None else scatter_dph) ** 2 - shared_dph**2)
        rows, shared = [], {}
        for number, (cycle, plateau, place) in enumerate(places, 1):
            gyro_c, run = plateaus_c[plateau] + drift(place), power_on(cycle, plateau, place)
            bias = true_dph(cycle, plateau, place, gyro_c) + constants[run] + of_positions[place]
            bias = bias + random.normal(0.0, own_dph[place])
            shared[number] = shared_dph * np.tile(np.eye(len(names))[place], (3, 1))
            rows.append(
                DwellRow(
                    unit="1001", run=str(run), dwell=number, cycle=cycle + 1, position=names[place],
                    start_s=1500.0 * number, end_s=1500.0 * number + 1200.0, since_power_on_s=0.0,
                    gyro_c=(gyro_c,) * 3, gyro_rate_c_per_h=(0.0,) * 3, bias_dph=tuple(bias),
                    sigma_dph=tuple(sigma_dph[place]), chamber_set_c=plateaus_c[plateau],
                )
            )  # fmt: skip
        planned = [
            PlannedDwell(row.dwell, row.cycle, row.position, row.chamber_set_c, row.gyro_c) for row in rows
        ]
        found[judge(rows, limits, planned, shared=shared).verdict] += 1
    return found


def equal(cycle, plateau, place, gyro_c):
    return np.zeros(3)


def one_pair_at_the_limit(cycle, plateau, place, gyro_c):
    return np.array([0.5 * LIMIT_DPH * {0: 1.0, 1: -1.0}.get(place, 0.0) * (plateau == 0), 0.0, 0.0])


def half_at_the_limit(cycle, plateau, place, gyro_c):
    return np.full(3, LIMIT_DPH * (place % 2))


def sloping(true_dph, slope_dph_per_c=0.0025):
    return lambda cycle, plateau, place, gyro_c: (
        true_dph(cycle, plateau, place, gyro_c) + slope_dph_per_c * gyro_c
    )


def flat_and_sloping(unit, *, quick):
    """A unit and one whose biases depend on temperature; ``quick`` names the one among the quick tests."""
    units = {"flat": unit, "sloping": sloping(unit)}
    return [
        pytest.param(each, id=name, marks=[] if name == quick else [pytest.mark.long])
        for name, each in units.items()
    ]


@pytest.mark.parametrize("unit", flat_and_sloping(equal, quick="sloping"))
def test_a_sound_unit_is_accepted_in_most_runs_and_never_rejected_for_its_temperature(unit, draws):
    found = verdicts(unit, draws, drift=drifting)
    assert found["accepted"] > 0.75 * draws
    assert found["rejected"] <= most(draws)


def test_the_largest_of_noisy_differences_does_not_reject_equal_positions(draws):
    found = verdicts(equal, draws, limits=AcceptanceLimits(position_difference_dph=1e-6))
    assert found["rejected"] <= most(draws)
    assert found["accepted"] == 0


def by_attitude(level_dph, vertical_dph):
    """Sizes (6, 3) by position and gyro."""
    up = np.array([each.up_axis for each in POSITIONS.values()])
    return np.where(np.arange(3) == up[:, np.newaxis], vertical_dph, level_dph)


def fig7_limits():
    return load_procedure(find_document("procedures", "six_position_fig7"))[1].acceptance


def one_pair(gyro, positions, difference_dph, plateaus):
    """A unit of which one gyro differs between two positions at some plateaus."""
    halves = dict(zip(positions, (0.5 * difference_dph, -0.5 * difference_dph), strict=True))
    names = tuple(POSITIONS)
    return lambda cycle, plateau, place, gyro_c: (
        np.eye(3)[gyro] * halves.get(names[place], 0.0) * (plateau in plateaus)
    )


#: Share of units of which six_position_fig7 accepts, in its comment: with drift of the accelerometers.
FIG7_SHARES = {
    "sound": (equal, 2, 0.0016, 0.91),
    "sound, no drift": (equal, 2, 0.00105, 0.99),
    "sound, 3 cycles": (equal, 3, 0.0016, 0.99),
    "axis up and down, at the limit": (one_pair(2, ("z_up", "z_down"), 0.006, {0}), 2, 0.0016, 0.05),
    "others, at the limit": (one_pair(0, ("z_up", "y_up"), 0.008, {0}), 2, 0.0016, 0.05),
    "others, 0.006 deg/h": (one_pair(0, ("z_up", "y_up"), 0.006, {0}), 2, 0.0016, 0.37),
    "others, 0.006 deg/h below 50 degC": (one_pair(0, ("z_up", "y_up"), 0.006, {2, 3, 4}), 2, 0.0016, 0.05),
}


@pytest.mark.parametrize(
    ("name", "draws"),
    [("sound", 50), *(pytest.param(name, 200, marks=pytest.mark.long) for name in FIG7_SHARES)],
)
def test_fig7_accepts_as_many_units_as_its_comment_states_and_rejects_none(name, draws):
    unit, cycles, level_dph, share = FIG7_SHARES[name]
    found = verdicts(
        unit,
        draws,
        cycles=cycles,
        plateaus_c=(74.0, 59.0, 33.0, 3.0, -24.0),
        sigma_dph=by_attitude(0.0016, 0.00105),
        scatter_dph=by_attitude(level_dph, 0.00105),
        limits=fig7_limits(),
    )
    assert found["accepted"] == pytest.approx(draws * share, abs=3 * math.sqrt(draws * share * (1 - share)))
    assert found["rejected"] <= most(draws)


@pytest.mark.parametrize("unit", flat_and_sloping(one_pair_at_the_limit, quick="flat"))
def test_a_unit_at_the_limit_is_accepted_in_no_more_than_one_of_twenty_runs(unit, draws):
    assert verdicts(unit, draws, drift=drifting)["accepted"] <= most(draws)


def test_errors_that_all_cycles_share_accept_a_unit_at_the_limit_in_no_more_than_one_of_twenty_runs(draws):
    found = verdicts(one_pair_at_the_limit, draws, cycles=4, plateaus_c=PLATEAUS_C[:1], shared_dph=0.001)
    assert found["accepted"] <= most(draws)


@pytest.mark.parametrize("unit", flat_and_sloping(half_at_the_limit, quick="sloping"))
def test_a_unit_just_within_the_limit_is_rejected_in_no_more_than_one_of_twenty_runs(unit, draws):
    assert verdicts(unit, draws, drift=drifting)["rejected"] <= most(draws)


def test_a_slope_over_temperature_does_not_hide_a_difference(draws):
    found = verdicts(
        lambda cycle, plateau, place, gyro_c: np.full(3, 0.0025 * gyro_c - 0.0024 * place),
        draws,
        drift=drifting,
    )
    assert found == {"rejected": draws}


def test_a_slope_that_the_run_does_not_show_leaves_the_verdict_open(draws):
    found = verdicts(sloping(equal), draws, drift=drifting, plateaus_c=PLATEAUS_C[:1])
    assert found == {"marginal": draws}


def test_opposite_differences_in_two_cycles_do_not_average_out(draws):
    found = verdicts(
        lambda cycle, plateau, place, gyro_c: np.full(3, (0.02, -0.02)[cycle] * (place == 0)), draws
    )
    assert found == {"rejected": draws}


def test_a_difference_at_the_limit_in_one_cycle_of_every_plateau_does_not_pass(draws):
    found = verdicts(
        lambda cycle, plateau, place, gyro_c: np.array([(LIMIT_DPH, 0.0)[cycle] * (place == 0), 0, 0]), draws
    )
    assert found["accepted"] <= most(draws)


def test_positions_on_two_sides_of_a_bin_edge_are_compared(draws):
    found = verdicts(
        lambda cycle, plateau, place, gyro_c: np.full(3, 0.02 * (place % 2)),
        draws,
        drift=lambda place: 0.1 if place % 2 else -0.1,
        plateaus_c=(35.0,),
    )
    assert found == {"rejected": draws}


def test_another_power_on_at_another_plateau_changes_no_verdict(draws):
    found = verdicts(
        equal, draws, power_on=lambda cycle, plateau, place: int(plateau > 1), turn_on_dph=0.01, cycles=1
    )
    assert found["rejected"] <= most(draws)
    found = verdicts(
        one_pair_at_the_limit,
        draws,
        power_on=lambda cycle, plateau, place: int(plateau > 1),
        turn_on_dph=0.01,
    )
    assert found["accepted"] <= most(draws)


def test_another_power_on_within_a_plateau_leaves_its_dwells_not_compared(draws):
    found = verdicts(
        equal,
        draws,
        power_on=lambda cycle, plateau, place: int((plateau, place) > (1, 2)),
        turn_on_dph=0.01,
        cycles=1,
    )
    assert found["rejected"] <= most(draws)
    assert found["accepted"] == 0
