"""Dialects with one mistake each, named after the test of the conformance suite that has to find it."""

import math
from dataclasses import replace

from gyrobench.bench.foundations.errors import InstrumentError, RefusedError
from gyrobench.drivers.chamber import ChamberDialect, ChamberReading
from gyrobench.drivers.chamber.thermotron_8800 import DIALECT as THERMOTRON
from gyrobench.drivers.chamber.thermotron_8800 import Thermotron8800
from gyrobench.drivers.emulators.acutrol3000 import Acutrol3000Emulator
from gyrobench.drivers.emulators.dialect import ChamberEmulation, TableEmulation
from gyrobench.drivers.emulators.thermotron_8800 import Thermotron8800Emulator
from gyrobench.drivers.rate_table import NoOptions, TableDialect, TableReading
from gyrobench.drivers.rate_table.acutrol3000 import Acutrol3000

#: Of attempts, more than a time limit allows.
_MANY = 200

MISTAKES = {}


def mistake(kind, test):
    """Register a class with a mistake that the test has to find."""

    def register(cls):
        MISTAKES[f"{kind}_{test}"] = cls
        return cls

    return register


class Chamber(Thermotron8800):
    Emulator = Thermotron8800Emulator


class Table(Acutrol3000):
    Emulator = Acutrol3000Emulator


@mistake("chamber", "it_opens_and_names_its_controller_in_one_line")
class NamelessChamber(Chamber):
    def identify(self):
        return "Thermotron\n8800"


@mistake("chamber", "opening_and_closing_change_nothing")
class ChamberSwitchedOffByClosing(Chamber):
    def close(self):
        self.switch(False)
        super().close()


@mistake("chamber", "a_set_point_arrives_at_the_controller_and_is_read_back")
class ChamberWithRememberedSetPoint(Chamber):
    def set_temperature(self, temperature_c, rate_c_per_min):
        self._remembered_c = temperature_c

    def set_point_c(self):
        return self._remembered_c


@mistake("chamber", "a_reading_is_that_of_the_air")
class ChamberThatReadsItsSetPoint(Chamber):
    def read(self):
        return ChamberReading(self.set_point_c(), alarms=())


@mistake("chamber", "a_reading_that_includes_set_point_and_state_reads_them_from_the_controller")
class ChamberAlwaysOn(Chamber):
    def read(self):
        return ChamberReading(super().read().temperature_c, None, True, alarms=())


@mistake("chamber", "switched_on_the_air_reaches_the_set_point")
class ChamberNeverOn(Chamber):
    def switch(self, on):
        pass


@mistake("chamber", "switched_off_the_air_is_not_controlled")
class ChamberNeverOff(Chamber):
    def switch(self, on):
        super().switch(True)


@mistake("chamber", "a_ramp_takes_its_time_or_is_not_offered")
class ChamberWithoutRamp(Chamber):
    def set_temperature(self, temperature_c, rate_c_per_min):
        super().set_temperature(temperature_c, None)


@mistake("chamber", "without_a_rate_an_earlier_ramp_has_no_effect")
class ChamberThatKeepsItsRamp(Chamber):
    def _set_ramp(self, rate_c_per_min):
        if rate_c_per_min is not None:
            super()._set_ramp(rate_c_per_min)


@mistake("chamber", "commands_can_be_repeated")
class ChamberThatToggles(Chamber):
    def switch_event(self, number, on):
        super().switch_event(number, not self.is_event_on(number))


@mistake("chamber", "a_temperature_that_is_no_number_is_refused_before_anything_is_sent")
class ChamberThatSendsAnything(Chamber):
    def set_temperature(self, temperature_c, rate_c_per_min):
        self._text.ask(f"SETP1,{temperature_c}")


@mistake("chamber", "a_rate_that_is_no_rate_is_refused")
class ChamberWithAnyRate(Chamber):
    def set_temperature(self, temperature_c, rate_c_per_min):
        good = rate_c_per_min is None or 0.0 < rate_c_per_min < math.inf
        super().set_temperature(temperature_c, rate_c_per_min if good else None)


@mistake("chamber", "a_set_point_outside_the_controllers_range_is_refused")
class ChamberThatClips(Chamber):
    def set_temperature(self, temperature_c, rate_c_per_min):
        super().set_temperature(min(max(temperature_c, -60.0), 100.0), rate_c_per_min)


@mistake("chamber", "limits_are_an_interval_or_refused")
class ChamberWithSwappedLimits(Chamber):
    def limits_c(self):
        return 100.0, -60.0


@mistake("chamber", "event_outputs_are_switched_one_by_one_and_read_back")
class ChamberThatSwitchesAllOutputs(Chamber):
    def switch_event(self, number, on):
        for each in (1, 2):
            super().switch_event(each, on)


@mistake("chamber", "an_event_output_that_does_not_exist_is_refused")
class ChamberWithAnyOutput(Chamber):
    def switch_event(self, number, on):
        super().switch_event(min(max(number, 1), 16), on)


@mistake("chamber", "it_has_no_alarm_to_begin_with_and_clearing_does_not_stop_it")
class ChamberStoppedByClearing(Chamber):
    def clear_alarms(self):
        self._command("STOP")


@mistake("chamber", "an_alarm_is_named_while_its_cause_is_present")
class ChamberWithoutAlarms(Chamber):
    def read(self):
        return replace(super().read(), alarms=())


@mistake("chamber", "a_broken_sensor_is_a_fault_until_it_is_repaired")
class ChamberWithLastGoodReading(Chamber):
    def read(self):
        try:
            return super().read()
        except InstrumentError:
            return ChamberReading(23.0, alarms=())


@mistake("chamber", "a_profile_of_its_own_is_reported_and_set_points_are_refused_meanwhile")
class ChamberThatIgnoresProfiles(Chamber):
    def running_profile(self):
        return ""


@mistake("chamber", "after_a_loss_of_power_it_reads_the_state_that_the_controller_has")
class ChamberWithRememberedState(Chamber):
    _is_on = False

    def switch(self, on):
        super().switch(on)
        self._is_on = on

    def read(self):
        return ChamberReading(super().read().temperature_c, None, self._is_on, alarms=())


@mistake("chamber", "silence_ends_in_no_reply_within_a_bounded_time")
class ChamberThatTriesForever(Chamber):
    def read(self):
        for _ in range(_MANY):
            try:
                return super().read()
            except InstrumentError:
                continue
        return super().read()


@mistake("chamber", "it_answers_again_after_a_silence")
class ChamberThatGivesUp(Chamber):
    def __init__(self, *args):
        super().__init__(*args)
        self._has_failed, self._ask, self._text.ask = False, self._text.ask, self._ask_once

    def _ask_once(self, query):
        if self._has_failed:
            raise RefusedError("chamber", "has failed before")
        self._has_failed = True
        reply = self._ask(query)
        self._has_failed = False
        return reply


@mistake("chamber", "a_late_reply_is_not_taken_for_that_of_another_request")
class ChamberThatTakesAnyReply(Chamber):
    def __init__(self, *args):
        super().__init__(*args)
        self._text.ask = self._take_any

    def _take_any(self, query):
        self._line.write(query.encode() + b"\r")
        return self._text.receive(query)


@mistake("chamber", "disturbed_replies_give_values_or_errors_of_the_bench")
class ChamberThatTrustsReplies(Chamber):
    def read(self):
        return ChamberReading(float(self._text.ask("PVAR1?").decode()), alarms=())


@mistake("chamber", "another_device_on_the_line_is_an_error")
class ChamberWithDefaultReading(Chamber):
    def __init__(self, line):
        try:
            super().__init__(line)
        except InstrumentError:
            self._line = line

    def read(self):
        return ChamberReading(23.0, alarms=())


@mistake("chamber", "the_emulator_accepts_any_bytes")
class ChamberOfAFragileEmulator(Chamber):
    class Emulator(Thermotron8800Emulator):
        def feed(self, data, now_s):
            data.decode("ascii")
            return super().feed(data, now_s)


@mistake("table", "it_opens_and_names_its_controller_in_one_line")
class NamelessTable(Table):
    def identify(self):
        return " "


@mistake("table", "opening_and_closing_move_nothing")
class TableStoppedByOpening(Table):
    def __init__(self, line, axes):
        super().__init__(line, axes)
        self.stop()


@mistake("table", "a_reading_has_every_axis_in_the_order_of_their_numbers")
class TableWithSwappedAxes(Table):
    def read(self):
        reading = super().read()
        return TableReading(reading.position_deg[::-1], reading.rate_dps[::-1], faults=())


@mistake("table", "it_moves_to_absolute_angles_of_either_sign_and_through_full_turns")
class TableThatTakesTheShortWay(Table):
    def move_to(self, angles_deg, rate_dps):
        super().move_to({axis: math.remainder(each, 360.0) for axis, each in angles_deg.items()}, rate_dps)


@mistake("table", "axes_move_at_the_same_time")
class TableThatMovesOneAxis(Table):
    def move_to(self, angles_deg, rate_dps):
        super().move_to({2: angles_deg[2]}, rate_dps)


@mistake("table", "it_is_in_position_only_at_the_end_of_a_move")
class TableAlwaysInPosition(Table):
    def in_position(self):
        return True


@mistake("table", "a_move_keeps_its_rate")
class TableOfItsOwnRate(Table):
    def move_to(self, angles_deg, rate_dps):
        super().move_to(angles_deg, 25.0)


@mistake("table", "an_axis_turns_at_a_rate_of_either_sign_until_it_is_stopped")
class TableThatTurnsOneWay(Table):
    def turn_at(self, axis, rate_dps):
        super().turn_at(axis, abs(rate_dps))


@mistake("table", "a_stop_ends_a_move_before_its_angle")
class TableThatFinishesItsMove(Table):
    def stop(self):
        pass


@mistake("table", "it_can_be_moved_again_after_a_stop")
class TableThatStopsForGood(Table):
    _is_stopped = False

    def stop(self):
        super().stop()
        self._is_stopped = True

    def move_to(self, angles_deg, rate_dps):
        if not self._is_stopped:
            super().move_to(angles_deg, rate_dps)


@mistake("table", "a_table_that_another_program_left_turning_can_be_stopped")
class TableThatStopsItsOwnMotions(Table):
    _turns = False

    def turn_at(self, axis, rate_dps):
        super().turn_at(axis, rate_dps)
        self._turns = True

    def stop(self):
        if self._turns:
            super().stop()


@mistake("table", "release_waits_for_rest_and_opens_the_servos")
class TableThatOnlyStops(Table):
    def release(self):
        self.stop()


@mistake("table", "a_table_with_open_servos_does_not_move")
class TableThatClosesServosByItself(Table):
    def move_to(self, angles_deg, rate_dps):
        self.prepare()
        super().move_to(angles_deg, rate_dps)


@mistake("table", "commands_can_be_repeated")
class TableWithRelativeMoves(Table):
    _target_deg = 0.0

    def move_to(self, angles_deg, rate_dps):
        self._target_deg += angles_deg[2]
        super().move_to(dict.fromkeys(angles_deg, self._target_deg), rate_dps)


@mistake("table", "an_angle_or_a_rate_that_is_no_number_moves_nothing")
class TableWithDefaults(Table):
    def move_to(self, angles_deg, rate_dps):
        angles = {axis: each if math.isfinite(each) else 0.0 for axis, each in angles_deg.items()}
        super().move_to(angles, rate_dps if math.isfinite(rate_dps) else 10.0)


@mistake("table", "limits_are_those_of_the_controller_or_refused")
class TableWithTheLimitsOfOneAxis(Table):
    def limits(self):
        return super().limits()[:1]


@mistake("table", "it_has_no_fault_to_begin_with")
class TableWithAFault(Table):
    def read(self):
        return replace(super().read(), faults=("none",))


@mistake("table", "after_a_loss_of_power_it_can_be_prepared_again")
class TablePreparedOnce(Table):
    _prepared = False

    def prepare(self):
        if not TablePreparedOnce._prepared:
            super().prepare()
        TablePreparedOnce._prepared = True


@mistake("table", "silence_ends_in_no_reply_within_a_bounded_time")
class TableThatHidesSilence(Table):
    def read(self):
        try:
            return super().read()
        except InstrumentError:
            return TableReading((0.0, 0.0), (0.0, 0.0), faults=())


@mistake("table", "a_late_reply_is_not_taken_for_that_of_another_request")
class TableThatTakesAnyReply(Table):
    def _skip_late_replies(self):
        return ""


@mistake("table", "disturbed_replies_give_values_or_errors_of_the_bench")
class TableThatTrustsReplies(Table):
    def _exchange_once(self, message, parse):
        try:
            return super()._exchange_once(message, parse)
        except InstrumentError as error:
            raise ValueError(message) from error


@mistake("table", "another_device_on_the_line_is_an_error")
class TableWithDefaultReading(Table):
    def __init__(self, line, axes):
        self._line = line

    def read(self):
        return TableReading((0.0, 0.0), (0.0, 0.0), faults=())


@mistake("table", "the_emulator_accepts_any_bytes")
class TableOfAFragileEmulator(Table):
    class Emulator(Acutrol3000Emulator):
        def feed(self, data, now_s):
            return super().feed(data, now_s) if data.isascii() else None


def __getattr__(name):
    """Entry points: the dialect of a mistake, and ``..._emulator`` for its emulator."""
    mistaken = MISTAKES.get(name.removesuffix("_emulator"))
    if mistaken is None:
        raise AttributeError(name)
    is_table = issubclass(mistaken, Table)
    if name.endswith("_emulator"):
        return (TableEmulation if is_table else ChamberEmulation)(mistaken.Emulator)
    if is_table:
        return TableDialect(lambda line, axes, _: mistaken(line, axes), NoOptions)
    return ChamberDialect(lambda line, _: mistaken(line), THERMOTRON.options)


def pytest_collection_modifyitems(config, items):
    """Run each dialect through the test that has to find its mistake, and no other."""

    def is_meant(item):
        parameters = item.callspec.params
        kind = "chamber" if "chamber" in parameters else "table"
        return parameters[kind] == f"{kind}_{item.originalname.removeprefix('test_')}"

    config.hook.pytest_deselected(items=[item for item in items if not is_meant(item)])
    items[:] = [item for item in items if is_meant(item)]
