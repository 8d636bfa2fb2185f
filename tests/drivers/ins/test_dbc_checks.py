import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.ins.dbc_codec import load_dbc


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("TIME_S : 0|32", "TIME_S : 99999999|32", r"line 16: a signal of 32 bits at bit 99999999"),
        ("SYSTEM_TIME: 8", "SYSTEM_TIME: 99999999", r"line 15: a message of 99999999 bytes"),
        (
            "SIG_VALTYPE_",
            "SG_MUL_VAL_ 1 TIME_S TIME_NS 0-4294967295 ;\nSIG_VALTYPE_",
            "line 150: 4294967296 multiplexer values",
        ),
        (
            "SIG_VALTYPE_ 513 VALUE",
            "SIG_VALTYPE_ 512 COMMAND",
            r"INS_COMMAND\.COMMAND: a floating-point number of 8 bits",
        ),
        ("(0.0001,0)", "(0,0)", r"VELOCITY_NE\.VELOCITY_NORTH: scale 0 "),
        ("(0.0001,0)", "(1,1e999)", r"VELOCITY_NE\.VELOCITY_NORTH: scale 1 and offset inf"),
    ],
)
def test_numbers_that_no_can_message_has_are_refused(tmp_path, dbc_path, old, new, message):
    # The key word also stands in the file's list of symbols, so the last place is meant there.
    head, found, tail = (
        dbc_path.read_text().rpartition(old) if old.startswith("SIG") else dbc_path.read_text().partition(old)
    )
    assert found
    path = tmp_path / "changed.dbc"
    path.write_text(head + new + tail)
    with pytest.raises(DocumentError, match=message) as error:
        load_dbc(path)
    assert str(error.value).startswith(str(path))
