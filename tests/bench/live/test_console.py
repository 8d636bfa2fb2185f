import io

import pytest

from gyrobench.bench.live.console import PatientConsole
from gyrobench.bench.live.patient_stream import PatientStream

TEXT = "+2.61 ±1.10"


@pytest.fixture
def ascii_terminal():
    """A terminal whose encoding has no sign for plus or minus."""
    return io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)


def test_what_the_terminal_can_not_show_is_a_question_mark(ascii_terminal):
    PatientConsole(file=ascii_terminal).print(TEXT)
    assert ascii_terminal.buffer.getvalue() == b"+2.61 ?1.10\n"


def test_a_stream_that_writes_in_the_background_goes_on_after_such_a_sign(ascii_terminal):
    console = PatientConsole(file=ascii_terminal)
    stream = PatientStream(console.file, console.on_broken_pipe)
    stream.write(f"{TEXT}\n")
    stream.write("next\n")
    stream.drain(5.0)
    assert ascii_terminal.buffer.getvalue() == b"+2.61 ?1.10\nnext\n"
