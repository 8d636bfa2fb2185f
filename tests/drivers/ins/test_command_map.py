"""Commands of the INS."""

from pathlib import Path

import pytest

from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.ins.command_map import CommandMap, check_commands


def command_map_of(text):
    return validate(parse_document(text, Path("station.yaml")), CommandMap)


def test_a_command_becomes_the_frame_of_its_message(command_map, codec):
    frame = command_map.set_euler_sequence.frame(codec, {"$sequence": 1.0})
    assert (frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) == (0x200, False, bytes([4, 1]))
    frame = command_map.load_compensation.frame(codec, {"$axis": 2.0, "$index": 3.0, "$value": 1.5})
    assert (frame.arbitration_id, bytes(frame.data)) == (0x201, bytes.fromhex("02 03 00 00 00 00 c0 3f"))


def test_the_projects_commands_fit_its_dbc(command_map, codec):
    assert check_commands(command_map, codec) == []


def test_what_does_not_fit_the_dbc_is_reported_at_its_place(codec):
    commands = command_map_of(
        """
        align: {message: INS_COMAND, values: {COMMAND: 2}}
        navigate: {message: INS_COMMAND, values: {COMAND: 3, ARGUMENT: $sequence}}
        set_euler_sequence: {message: INS_COMMAND, values: {COMMAND: 4, ARGUMENT: $axis}}
        """
    )
    problems = {problem.location: problem.message for problem in check_commands(commands, codec, ("ins",))}
    assert "did you mean INS_COMMAND" in problems["ins", "align", "values", "COMMAND"]
    assert "did you mean COMMAND" in problems["ins", "navigate", "values", "COMAND"]
    assert problems["ins", "navigate", "values", "ARGUMENT"] == "expected a number; found '$sequence'"
    assert "a number or $sequence" in problems["ins", "set_euler_sequence", "values", "ARGUMENT"]


def test_unknown_commands_are_mistakes():
    with pytest.raises(DocumentError, match="unknown key 'alignn' \\(did you mean 'align'"):
        command_map_of("alignn: {message: A, values: {}}")


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ("{saturating_dph_per_k: [8, 9, 10], onset_c: 11}", "saturating_dph_per_k needs onset_width_c too"),
        ("{warm_up_dph: 8}", "warm_up_dph needs warm_up_s too"),
        ("{gravity_dph_per_g: [8, 9]}", "at least 3"),
        ("{gravity: [8, 9, 10]}", "unknown key 'gravity'"),
    ],
)
def test_terms_that_are_not_whole_are_mistakes(terms, message):
    with pytest.raises(DocumentError, match=message):
        command_map_of(f"load_compensation: {{message: A, values: {{}}, coefficients: 2, terms: {terms}}}")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("coefficients: 4, lowest_index: 3", r"lowest_index and T\^3 both have the index 3"),
        ("coefficients: 2, terms: {gravity_dph_per_g: [8, 9, 8]}", None),
        ("coefficients: 2, terms: {gradient_dph_per_k: 1}", r"gradient_dph_per_k and T\^1"),
        (
            "coefficients: 2, terms: {gradient_dph_per_k: 12}, "
            "others: {gyro: [10, 20, 30], accelerometer_bias: 40, accelerometer: [50, 60, 70]}",
            "others and gradient_dph_per_k both have the index 12",
        ),
    ],
)
def test_two_numbers_at_one_index_are_a_mistake(keys, message):
    text = f"load_compensation: {{message: A, values: {{}}, {keys}}}"
    with pytest.raises(DocumentError, match=message or "both have the index 8"):
        command_map_of(text)


def test_a_load_command_without_axis_index_or_value_is_a_mistake(codec):
    text = "load_compensation: {message: COMPENSATION_COEFFICIENT, values: {INDEX: $index, VALUE: $value}"
    [problem] = check_commands(command_map_of(f"{text}, coefficients: 2}}"), codec)
    assert problem.location == ("load_compensation", "values")
    assert "no signal has $axis" in problem.message
