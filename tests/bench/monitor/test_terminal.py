import io
import os
import pty
import subprocess
import sys
import termios
import threading

import pytest

from gyrobench.bench.monitor.terminal import BackgroundStream, Keyboard, RunConsole, is_c_locale

ASK = "import os; from gyrobench.bench.monitor.terminal import is_c_locale; print(is_c_locale(os.environ))"


@pytest.mark.parametrize(
    ("environment", "is_c"),
    [
        ({"LC_ALL": "C"}, True),
        ({"LC_ALL": "POSIX", "LANG": "de_DE.UTF-8"}, True),
        ({"LANG": "C"}, True),
        ({"LANG": "C", "LC_ALL": "C.UTF-8"}, False),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, False),
        ({}, False),
    ],
)
def test_a_c_locale_gets_ascii_although_python_would_write_utf_8(environment, is_c):
    run = subprocess.run(
        [sys.executable, "-c", ASK], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == str(is_c)


def test_the_character_locale_counts_before_the_language():
    assert is_c_locale({"LC_ALL": "", "LC_CTYPE": "C", "LANG": "de_DE.UTF-8"}) != bool(sys.flags.utf8_mode)


TEXT = "+2.61 ±1.10"


@pytest.fixture
def ascii_terminal():
    """A terminal whose encoding has no sign for plus or minus."""
    return io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)


def test_what_the_terminal_can_not_show_is_a_question_mark(ascii_terminal):
    RunConsole(file=ascii_terminal).print(TEXT)
    assert ascii_terminal.buffer.getvalue() == b"+2.61 ?1.10\n"


def test_a_stream_that_writes_in_the_background_continues_after_such_a_sign(ascii_terminal):
    console = RunConsole(file=ascii_terminal)
    stream = BackgroundStream(console.file, console.on_broken_pipe)
    stream.write(f"{TEXT}\n")
    stream.write("next\n")
    stream.drain(5.0)
    assert ascii_terminal.buffer.getvalue() == b"+2.61 ?1.10\nnext\n"


class Halted(io.StringIO):
    """A terminal that takes nothing until it is resumed."""

    def __init__(self):
        super().__init__()
        self.resumed = threading.Event()

    def write(self, text):
        self.resumed.wait(120.0)
        return super().write(text)


def test_a_halted_terminal_does_not_block_and_gets_all_in_order_later():
    halted = Halted()
    stream = BackgroundStream(halted, lambda: None)
    for number in range(100):
        stream.write(f"{number}\n")
    assert stream.is_behind
    stream.drain(0.1)
    assert stream.is_behind
    halted.resumed.set()
    stream.drain(120.0)
    assert not stream.is_behind
    assert halted.getvalue().split() == [str(number) for number in range(100)]


def test_a_stream_without_a_reader_is_reported():
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    closed = threading.Event()
    stream = BackgroundStream(Closed(), closed.set)
    stream.write("anybody?\n")
    assert closed.wait(120.0)
    stream.write("still no reader\n")
    stream.drain(120.0)
    assert not stream.is_behind


@pytest.fixture
def terminal(monkeypatch):
    """The far end of a terminal that standard input is, with this process in its foreground."""
    far, near = pty.openpty()
    with os.fdopen(near, "r") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        monkeypatch.setattr("os.tcgetpgrp", lambda _: os.getpgrp())
        yield far
    os.close(far)


def echoes(far):
    return bool(termios.tcgetattr(far)[3] & termios.ECHO)


def test_keys_are_unseen_while_it_listens_and_the_terminal_is_as_before_afterwards(terminal):
    before = termios.tcgetattr(terminal)
    with Keyboard():
        assert not echoes(terminal)
        assert termios.tcgetattr(terminal)[3] & termios.ISIG
    assert termios.tcgetattr(terminal) == before
    assert echoes(terminal)


def test_a_line_is_there_once_it_is_finished(terminal):
    with Keyboard() as keyboard:
        os.write(terminal, b"pau")
        assert keyboard.line() == ""
        assert keyboard.unfinished == "pau"
        os.write(terminal, b"se\nhold\n")
        assert [keyboard.line(), keyboard.line(), keyboard.line()] == ["pause", "hold", ""]
        assert keyboard.unfinished == ""


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        (b"abortt\x7f", "abort"),
        (b"abx\x08ort", "abort"),
        (b"skip\x15hold", "hold"),
        (b"\x1b[Aho\x1b[3~ld\x1bOP", "hold"),
        (b"\x00\x01hold", "hold"),
        (b"\xff\xfehold", "hold"),
        (b"x" * 500, "x" * 100),
    ],
)
def test_keys_edit_the_line(terminal, typed, expected):
    with Keyboard() as keyboard:
        os.write(terminal, typed)
        assert keyboard.unfinished == expected


def test_without_listening_whole_lines_are_read(terminal):
    keyboard = Keyboard()
    assert keyboard.line() == ""
    os.write(terminal, b"continue\n")
    assert keyboard.line() == "continue"
    assert echoes(terminal)


def test_a_terminal_in_whose_background_it_runs_is_left_alone(terminal, monkeypatch):
    monkeypatch.setattr("os.tcgetpgrp", lambda _: os.getpgrp() + 1)
    with Keyboard():
        assert echoes(terminal)


def test_where_there_is_no_input_nothing_is_typed(monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    with Keyboard() as keyboard:
        assert keyboard.line() == ""
        assert keyboard.unfinished == ""
