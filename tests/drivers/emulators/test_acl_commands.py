from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.acl_axis import AclError, ErrorCode
from gyrobench.drivers.emulators.acl_commands import Unit, format_nr2, parse_message


@pytest.mark.parametrize(
    "text",
    [
        ":Demand:Position 3,10.5",
        ":Dem:Pos 3,10.50000",
        ":D:P 3,10.5",
        "d:p 3,1.05e1",
        ":DEMAND:position   3 , +10.5",
    ],
)
def test_one_command_has_many_spellings(text):
    assert parse_message(text) == (Unit(("DEMAND", "POSITION"), False, (3.0, 10.5)),)


def test_a_unit_without_a_colon_continues_in_the_node_before_it():
    first, second = parse_message(":Demand:Pos 2,0.01;Rate 3,100")
    assert first.header == ("DEMAND", "POSITION")
    assert second == Unit(("DEMAND", "RATE"), False, (3.0, 100.0))


def test_a_colon_after_a_semicolon_goes_back_to_the_root():
    headers = [unit.header for unit in parse_message(":D:P 2,0.0;:I:R;:M:P 2;:I:C 2")]
    assert headers == [
        ("DEMAND", "POSITION"),
        ("INTERLOCK", "RESET"),
        ("MODE", "POSITION"),
        ("INTERLOCK", "CLOSE"),
    ]


def test_a_common_command_leaves_the_node_as_it_is():
    units = parse_message(":read:pos? 1;*stb?;rate? 1")
    assert units[1] == Unit(("*STB",), True, ())
    assert units[2].header == ("READ", "RATE")


def test_after_a_command_without_a_sub_keyword_the_node_is_the_root():
    assert parse_message(":Mode 1,Rate;Interlock? 1")[1] == Unit(("INTERLOCK",), True, (1.0,))


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (":Demand:Posn 3,10.5", ErrorCode.UNKNOWN_COMMAND),
        (":Demand:Position:Rate 3,10.5", ErrorCode.UNKNOWN_COMMAND),
        (":D:P,3,10.5", ErrorCode.SYNTAX),
        ("", ErrorCode.SYNTAX),
        (":D:P 1,2;", ErrorCode.SYNTAX),
        ("::D:P 1,2", ErrorCode.SYNTAX),
        (":D:P 1,,2", ErrorCode.SYNTAX),
        (":D:P 1," + "1" * 28, ErrorCode.WRONG_PARAMETER_TYPE),
        (":D:P 1,1e999", ErrorCode.PARAMETER_OUT_OF_RANGE),
    ],
)
def test_what_is_no_acl_is_refused(text, code):
    with pytest.raises(AclError) as caught:
        parse_message(text)
    assert caught.value.code is code


def test_words_that_are_no_finite_numbers_stay_words():
    assert parse_message(":D:P 1,nan")[0].arguments == (1.0, "NAN")
    assert parse_message(":D:P 1,1_0")[0].arguments == (1.0, "1_0")


@given(st.text())
def test_any_text_is_parsed_or_refused(text):
    with suppress(AclError):
        assert len(parse_message(text)) == text.count(";") + 1


@given(st.floats(-1e6, 1e6))
def test_numbers_go_out_without_exponent_plus_sign_or_negative_zero(value):
    text = format_nr2(value, 6)
    assert float(text) == pytest.approx(value, abs=5.1e-7)
    assert not set(text) & set("eE+")
    assert text != "-0.000000"
