import os
import pty
import termios

import pytest

from gyrobench.bench.live.keyboard import Keyboard


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
        assert keyboard.begun == "pau"
        os.write(terminal, b"se\nhold\n")
        assert [keyboard.line(), keyboard.line(), keyboard.line()] == ["pause", "hold", ""]
        assert keyboard.begun == ""


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
        assert keyboard.begun == expected


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
        assert keyboard.begun == ""
