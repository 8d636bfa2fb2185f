"""What a compensation changed in the biases, against what was loaded."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.verification.measured_change import measured_change, subtracted_dph
from gyrobench.drivers.emulators.world.ins_compensation import (
    SLOT,
    InsCompensation,
    TemperatureHistory,
    empty_table,
)
from gyrobench.drivers.ins.compensation import Compensation
from tests.bench.report.made_up_verification import rows_of

#: What the biases of :func:`rows_of` follow: 0.02 deg/h along Up.
ALONG_UP = Compensation(
    np.zeros((3, 1)), np.full(3, -40.0), np.full(3, 80.0), gravity_dph_per_g=0.02 * np.eye(3)
)


def rows_with(subtracted, seed):
    """Rows of a unit with 0.02 deg/h along Up that subtracts something (3, 3) along it."""
    along_up = 0.02 * np.eye(3) - subtracted
    up = [POSITIONS[row.position].C_nb()[2] for row in rows_of(0.0)]
    return [
        replace(row, bias_dph=tuple(row.bias_dph + along_up @ each))
        for row, each in zip(rows_of(0.0, seed=seed), up, strict=True)
    ]


def change(subtracted):
    rows = rows_with(np.zeros((3, 3)), 1), rows_with(subtracted, 2)
    found = measured_change(*rows, (None, ALONG_UP))
    assert found is not None
    return found


def test_a_compensation_that_is_applied_changes_the_biases_as_loaded():
    found = change(0.02 * np.eye(3))
    assert found.factors == pytest.approx(np.ones(3), abs=4.0 * found.sigmas.max())
    assert found.is_applied
    assert found.is_smaller
    assert not found.contradicts.any()


@pytest.mark.parametrize(("times", "is_applied"), [(0.0, False), (-1.0, False), (2.0, True)])
def test_a_compensation_that_is_not_applied_or_with_the_wrong_sign_or_twice_contradicts_it(times, is_applied):
    found = change(times * 0.02 * np.eye(3))
    assert found.factors == pytest.approx(np.full(3, times), abs=4.0 * found.sigmas.max())
    assert found.contradicts.all()
    assert found.is_applied == is_applied
    assert not (found.is_applied and found.is_smaller)


def test_a_compensation_of_the_error_that_dwells_have_in_common_makes_no_bias_smaller():
    """What the campaign took for a bias, both runs measure again."""

    def found_beside(common_dph):
        runs = [
            [
                replace(row, sigma_dph=tuple(np.hypot(0.003, common)), common_sigma_dph=tuple(common))
                for row in rows_with(subtracted, seed)
                for common in [common_dph * np.abs(POSITIONS[row.position].C_nb()[2])]
            ]
            for seed, subtracted in ((1, np.zeros((3, 3))), (2, 0.02 * np.eye(3)))
        ]
        return measured_change(*runs, (None, ALONG_UP))

    alone, beside = map(found_beside, (0.0, 0.02))
    assert (alone.is_applied, alone.is_smaller) == (True, True)
    assert (beside.is_applied, beside.is_smaller) == (True, False)
    # In the change, the error cancels.
    assert beside.sigmas == pytest.approx(alone.sigmas)


def test_a_compensation_of_other_gyros_contradicts_it_for_these():
    exchanged = 0.02 * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert change(exchanged).contradicts.tolist() == [True, True, False]


def test_without_a_temperature_that_the_compensation_needs_nothing_is_compared():
    gradient = replace(
        ALONG_UP,
        gradient_dph_per_k=np.full(3, 0.001),
        difference_low_k=np.zeros(3),
        difference_high_k=np.full(3, 20.0),
    )
    rows = rows_of(0.0)
    assert measured_change(rows, rows, (None, gradient)) is None
    assert measured_change(rows, rows, (None, None)) is None


def test_where_the_ins_gets_no_limits_dwells_beyond_them_are_not_compared():
    narrow = replace(ALONG_UP, low_c=np.full(3, 30.0))
    rows = rows_with(np.zeros((3, 3)), 1), rows_with(0.02 * np.eye(3), 2)
    beyond = [replace(row, bias_dph=(9.0, 9.0, 9.0)) if row.gyro_c[0] < 30.0 else row for row in rows[1]]
    found = measured_change(rows[0], beyond, (None, narrow), is_limited=False)
    assert found.factors == pytest.approx(np.ones(3), abs=4.0 * found.sigmas.max())
    assert not found.contradicts.any()


def rows_of_hysteresis(times, seed):
    """Rows, up and down again, of a unit with play, of which a number of times is subtracted."""
    random, played, rows = np.random.default_rng(seed), -30.0, []
    for at_c in [-20.0, 5.0, 30.0, 55.0, 30.0, 5.0, -20.0]:
        played = float(np.clip(played, at_c - 4.0, at_c + 4.0))
        for row in rows_of(0.0)[:2]:
            left_dph = (1.0 - times) * 0.005 * (played - at_c) + 0.002 * random.standard_normal(3)
            number = len(rows) + 1
            rows.append(replace(row, dwell=number, gyro_c=(at_c,) * 3, bias_dph=tuple(left_dph)))
    return rows


@pytest.mark.parametrize(("times", "is_right"), [(1.0, True), (0.0, False), (-1.0, False), (2.0, False)])
def test_hysteresis_that_is_subtracted_otherwise_than_loaded_contradicts_it(times, is_right):
    loaded = Compensation(
        np.zeros((3, 1)),
        np.full(3, -40.0),
        np.full(3, 80.0),
        hysteresis_dph_per_k=np.full(3, 0.005),
        half_width_k=np.full(3, 4.0),
    )
    before = rows_of_hysteresis(0.0, 1)
    subtracted = subtracted_dph(loaded, before)
    # What the play was before the first dwell is not known.
    assert np.isnan(subtracted[:2]).all()
    assert subtracted[2:8] == pytest.approx(np.full((6, 3), -0.02))
    assert subtracted[8:] == pytest.approx(np.full((6, 3), 0.02))
    found = measured_change(before, rows_of_hysteresis(times, 2), (None, loaded))
    assert found.factors == pytest.approx(np.full(3, times), abs=4.0 * found.sigmas.max())
    assert found.contradicts.any() == (not is_right)


def test_what_is_subtracted_is_what_the_emulated_ins_subtracts():
    """In the middle of dwells at constant temperatures, inside and outside the limits."""
    random = np.random.default_rng(3)
    compensation = Compensation(
        random.normal(0.0, [0.01, 1e-4, 1e-6, 1e-8], (3, 4)),
        np.full(3, -10.0),
        np.full(3, 55.0),
        gradient_dph_per_k=random.normal(0.0, 1e-3, 3),
        difference_low_k=np.full(3, 2.0),
        difference_high_k=np.full(3, 12.0),
        saturating_dph_per_k=random.normal(0.0, 1e-3, (3, 3)),
        growing_dph_per_k=random.normal(0.0, 1e-4, (3, 3)),
        onset_c=np.array([20.0, 30.0, 40.0]),
        onset_width_c=np.array([3.0, 5.0, 0.5]),
        gravity_dph_per_g=random.normal(0.0, 0.01, (3, 3)),
        warm_up_dph=random.normal(0.0, 0.01, 3),
        warm_up_s=np.full(3, 1800.0),
    )
    slots = {
        SLOT.LOW_C: compensation.low_c,
        SLOT.HIGH_C: compensation.high_c,
        SLOT.GRADIENT: compensation.gradient_dph_per_k,
        SLOT.DIFFERENCE_LOW: compensation.difference_low_k,
        SLOT.DIFFERENCE_HIGH: compensation.difference_high_k,
        SLOT.ONSET_C: compensation.onset_c,
        SLOT.ONSET_WIDTH: compensation.onset_width_c,
        SLOT.WARM_UP: compensation.warm_up_dph,
        SLOT.WARM_UP_TIME: compensation.warm_up_s,
    }
    table = empty_table()
    table[:, SLOT.POLYNOMIAL : SLOT.POLYNOMIAL + 4] = compensation.polynomial_dph
    table[:, SLOT.SATURATING : SLOT.SATURATING + 3] = compensation.saturating_dph_per_k
    table[:, SLOT.GROWING : SLOT.GROWING + 3] = compensation.growing_dph_per_k
    table[:, SLOT.GRAVITY : SLOT.GRAVITY + 3] = compensation.gravity_dph_per_g
    for slot, values in slots.items():
        table[:, slot] = values
    boards_c = random.uniform(0.0, 15.0, (14, 3))
    rows = [
        replace(row, board_c=tuple(row.gyro_c + hotter))
        for row, hotter in zip(rows_of(0.0), boards_c, strict=True)
    ]
    for row, found in zip(rows, subtracted_dph(compensation, rows), strict=True):
        middle_s = round(row.since_power_on_s + 0.5 * (row.end_s - row.start_s))
        history = TemperatureHistory()
        history.read(*(np.tile(each, (middle_s, 1)) for each in (row.gyro_c, row.board_c)))
        up = POSITIONS[row.position].C_nb()[2]
        assert found == pytest.approx(InsCompensation(table, history, up).bias_dph, abs=1e-9)
