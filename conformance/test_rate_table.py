"""Requirements for every dialect of a rate table, tested with its emulator."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from contextlib import suppress

import pytest

from gyrobench.bench.foundations.errors import InstrumentError, NoReplyError, RefusedError
from gyrobench.conformance.instruments import Noise, TableUnderTest
from gyrobench.drivers.emulators.dialect import Restartable, Servoed
from gyrobench.drivers.rate_table import RateTable

_RATE_DPS = 10.0
#: Tolerance of reported and reached angles.
_ANGLE_DEG = 0.01
_AT_REST_DPS = 0.01
#: Longest duration of a call, with all repetitions, and of a stop.
_MAX_TIME_S = 30.0


def test_it_opens_and_names_its_controller_in_one_line(table: TableUnderTest) -> None:
    name = table.open().identify()
    assert name.strip(), "identify() must identify the controller, for the run's provenance"
    assert "\n" not in name, "identify() must return a single line"


def test_opening_and_closing_move_nothing(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.move_to(_angles(table, 90.0), _RATE_DPS)
    table.wait(2.0)
    driver.close()
    table.open()
    table.wait(60.0)
    assert table.true_deg() == pytest.approx(_all(table, 90.0), abs=_ANGLE_DEG), (
        "closing the line must not stop a motion"
    )


def test_a_reading_has_every_axis_in_the_order_of_their_numbers(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.move_to({number: 10.0 * number for number in table.axes}, _RATE_DPS)
    assert table.wait_until_in_position(driver)
    table.wait(10.0)
    reading = driver.read()
    assert reading.position_deg == pytest.approx([10.0 * number for number in table.axes], abs=_ANGLE_DEG)
    assert reading.position_deg == pytest.approx(table.true_deg(), abs=_ANGLE_DEG)
    assert reading.rate_dps == pytest.approx(_all(table, 0.0), abs=_AT_REST_DPS)


@pytest.mark.parametrize("angle_deg", [30.0, -120.5, 360.0, -360.0])
def test_it_moves_to_absolute_angles_of_either_sign_and_through_full_turns(
    table: TableUnderTest, angle_deg: float
) -> None:
    driver = table.open_prepared()
    driver.move_to(_angles(table, angle_deg), 20.0)
    assert table.wait_until_in_position(driver)
    table.wait(10.0)
    assert table.true_deg() == pytest.approx(_all(table, angle_deg), abs=_ANGLE_DEG)


def test_axes_move_at_the_same_time(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.move_to(_angles(table, 90.0), _RATE_DPS)
    table.wait(4.0)
    assert all(abs(position_deg) > 5.0 for position_deg in table.true_deg())


def test_it_is_in_position_only_at_the_end_of_a_move(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.move_to(_angles(table, 90.0), _RATE_DPS)
    assert not driver.in_position()
    table.wait(3.0)
    assert not driver.in_position()
    assert table.wait_until_in_position(driver)
    assert table.true_deg() == pytest.approx(_all(table, 90.0), abs=0.1)


def test_a_move_keeps_its_rate(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.move_to(_angles(table, 90.0), _RATE_DPS)
    table.wait(5.0)
    assert driver.read().rate_dps == pytest.approx(_all(table, _RATE_DPS), abs=0.05)


@pytest.mark.parametrize("rate_dps", [10.5, -10.5])
def test_an_axis_turns_at_a_rate_of_either_sign_until_it_is_stopped(
    table: TableUnderTest, rate_dps: float
) -> None:
    driver = table.open_prepared()
    driver.turn_at(table.axes[-1], rate_dps)
    table.wait(8.0)
    assert driver.read().rate_dps[-1] == pytest.approx(rate_dps, abs=0.05)
    driver.stop()
    table.wait(_MAX_TIME_S)
    assert driver.read().rate_dps == pytest.approx(_all(table, 0.0), abs=_AT_REST_DPS)


def test_a_stop_ends_a_move_before_its_angle(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.move_to(_angles(table, 170.0), _RATE_DPS)
    table.wait(3.0)
    driver.stop()
    table.wait(_MAX_TIME_S)
    first = table.true_deg()
    assert all(position_deg < 100.0 for position_deg in first)
    table.wait(20.0)
    assert table.true_deg() == pytest.approx(first, abs=_ANGLE_DEG), "it must stay where it has stopped"


def test_it_can_be_moved_again_after_a_stop(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.turn_at(table.axes[-1], 20.0)
    table.wait(5.0)
    driver.stop()
    table.wait(_MAX_TIME_S)
    driver.move_to(_angles(table, 0.0), 20.0)
    assert table.wait_until_in_position(driver)


def test_a_table_that_another_program_left_turning_can_be_stopped(table: TableUnderTest) -> None:
    before = table.open_prepared()
    before.turn_at(table.axes[-1], 5.0)
    table.wait(5.0)
    before.close()
    driver = table.open()
    driver.stop()
    table.wait(_MAX_TIME_S)
    assert driver.read().rate_dps == pytest.approx(_all(table, 0.0), abs=_AT_REST_DPS)


def test_release_waits_for_rest_and_opens_the_servos(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.turn_at(table.axes[-1], 20.0)
    table.wait(5.0)
    driver.release()
    now_s = table.clock.now()
    assert all(abs(table.axis(number).encoder(now_s).rate_dps) < 0.1 for number in table.axes)
    if isinstance(table.emulator, Servoed):
        assert not any(table.emulator.is_servoed(number) for number in table.axes)


def test_a_table_with_open_servos_does_not_move(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    driver.release()
    before = table.true_deg()
    with suppress(InstrumentError):
        driver.move_to(_angles(table, 90.0), _RATE_DPS)
    table.wait(20.0)
    assert table.true_deg() == pytest.approx(before, abs=_ANGLE_DEG)


def test_commands_can_be_repeated(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    for _ in range(3):
        driver.prepare()
        driver.move_to(_angles(table, 20.0), _RATE_DPS)
    assert table.wait_until_in_position(driver)
    table.wait(10.0)
    assert table.true_deg() == pytest.approx(_all(table, 20.0), abs=_ANGLE_DEG)


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_an_angle_or_a_rate_that_is_no_number_moves_nothing(table: TableUnderTest, number: float) -> None:
    driver = table.open_prepared()
    with pytest.raises((RefusedError, ValueError)):
        driver.move_to(_angles(table, number), _RATE_DPS)
    with pytest.raises((RefusedError, ValueError)):
        driver.move_to(_angles(table, 90.0), number)
    with pytest.raises((RefusedError, ValueError)):
        driver.turn_at(table.axes[-1], number)
    table.wait(20.0)
    assert table.true_deg() == pytest.approx(_all(table, 0.0), abs=_ANGLE_DEG)


def test_limits_are_those_of_the_controller_or_refused(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    with suppress(RefusedError):
        limits = driver.limits()
        assert len(limits) == len(table.axes)
        assert all(each.rate_dps > 0.0 and each.low_deg < each.high_deg for each in limits)


def test_it_has_no_fault_to_begin_with(table: TableUnderTest) -> None:
    assert table.open_prepared().read().faults == ()


def test_after_a_loss_of_power_it_can_be_prepared_again(table: TableUnderTest) -> None:
    supply = table.require_capability(Restartable)
    driver = table.open_prepared()
    driver.turn_at(table.axes[-1], 20.0)
    table.wait(5.0)
    supply.power_off(table.clock.now())
    table.wait(10.0)
    supply.power_on(table.clock.now())
    table.wait(60.0)
    if isinstance(table.emulator, Servoed):
        assert not all(table.emulator.is_servoed(number) for number in table.axes)
    driver = table.open_prepared()
    driver.move_to(_angles(table, 10.0), _RATE_DPS)
    assert table.wait_until_in_position(driver), (
        "prepare() must clear the faults of the power loss, and close the servos"
    )


def test_silence_ends_in_no_reply_within_a_bounded_time(table: TableUnderTest) -> None:
    driver = table.open_prepared()
    table.wire.is_connected = False
    for action in (driver.read, driver.in_position, driver.stop):
        started_s = table.clock.now()
        with pytest.raises(NoReplyError):
            action()
        assert table.clock.now() - started_s < _MAX_TIME_S, "each request must have a time limit"


@pytest.mark.parametrize("delay_s", [0.4, 1.0, 2.0, 4.0])
def test_a_late_reply_is_not_taken_for_that_of_another_request(table: TableUnderTest, delay_s: float) -> None:
    driver = table.open_prepared()
    driver.turn_at(table.axes[-1], 4.0)
    for pause_s in (0.0, 0.5, 2.0):
        table.wait(5.0)
        table.wire.latency_s = delay_s
        with suppress(InstrumentError):
            driver.read()
        table.wire.latency_s = table.emulator.latency_s
        table.wait(pause_s)
        position_deg = table.retry(driver.read).position_deg[-1]
        assert position_deg == pytest.approx(table.true_deg()[-1], abs=4.0), (
            "within what it turns in a second"
        )


def test_disturbed_replies_give_values_or_errors_of_the_bench(
    table: TableUnderTest, noise: Callable[[], Noise]
) -> None:
    driver = table.open_prepared()
    table.wire.disturb = noise()
    for _ in range(20):
        for action in _requests(table, driver):
            with suppress(InstrumentError):
                action()
        with suppress(InstrumentError):
            reading = driver.read()
            assert all(map(math.isfinite, (*reading.position_deg, *reading.rate_dps)))


def test_another_device_on_the_line_is_an_error(table: TableUnderTest) -> None:
    table.wire.disturb = lambda _: b"\xff\x00hello\r\n"
    with pytest.raises(InstrumentError):
        table.open().read()


def test_the_emulator_accepts_any_bytes(table: TableUnderTest) -> None:
    draw = random.Random(1)  # noqa: S311 - not for secrets
    driver = table.open_prepared()
    requests = list(table.wire.requests)
    for _ in range(300):
        data = draw.choice(requests)[: draw.randrange(16)] + draw.randbytes(draw.randrange(12))
        reply = table.emulator.feed(data, table.clock.now())
        assert isinstance(reply, bytes), "feed() must accept any bytes and return bytes"
    table.wait(30.0)
    reading = table.retry(driver.read)
    assert len(reading.position_deg) == len(table.axes), "it must answer a valid request afterwards"


def _angles(table: TableUnderTest, angle_deg: float) -> dict[int, float]:
    return dict.fromkeys(table.axes, angle_deg)


def _all(table: TableUnderTest, value: float) -> list[float]:
    return [value] * len(table.axes)


def _requests(table: TableUnderTest, driver: RateTable) -> list[Callable[[], object]]:
    return [
        driver.read,
        driver.in_position,
        driver.stop,
        lambda: driver.move_to(_angles(table, 10.0), _RATE_DPS),
        lambda: driver.turn_at(table.axes[-1], 5.0),
    ]
