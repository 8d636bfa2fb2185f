"""The terminal of manual control: typed lines and signals."""

import contextlib
import os
import signal

import pytest

from gyrobench.bench.jog.terminal import (
    CommandError,
    EndSessionError,
    Interruptions,
    StoppedByOperatorError,
    TypedLines,
)


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    yield reading, writing
    for descriptor in (reading, writing):
        with contextlib.suppress(OSError):
            os.close(descriptor)


def test_lines_come_one_by_one_and_the_last_needs_no_newline(pipe):
    reading, writing = pipe
    os.write(writing, b"show\n  table outer 3 \n\nstop")
    os.close(writing)
    lines = TypedLines(reading, lambda: None)
    assert [lines.next() for _ in range(6)] == ["show", "table outer 3", "", "stop", None, None]


def test_the_bench_is_polled_until_a_whole_line_is_there(pipe):
    reading, writing = pipe
    pieces = [b"sh", b"ow", b"\n"]
    lines = TypedLines(reading, lambda: os.write(writing, pieces.pop(0)))
    assert lines.next() == "show"
    assert pieces == []


def test_lines_that_have_arrived_are_there_without_waiting_for_more(pipe):
    reading, writing = pipe
    os.write(writing, b"show\n stop \nta")
    lines = TypedLines(reading, lambda: None)
    assert lines.next() == "show"
    assert lines.read_arrived() == ["stop", "ta"]


def test_undecodable_bytes_are_a_line_too(pipe):
    reading, writing = pipe
    os.write(writing, b"\xff\xfe\n")
    assert TypedLines(reading, lambda: None).next() == "��"


def test_errors_of_the_bench_propagate(pipe):
    def trip():
        raise RuntimeError("tripped")

    with pytest.raises(RuntimeError, match="tripped"):
        TypedLines(pipe[0], trip).next()


def test_the_bench_is_polled_before_every_read_of_much_input(pipe):
    reading, writing = pipe
    looks = []
    os.write(writing, b"show\n" * 2000)
    os.close(writing)
    lines = TypedLines(reading, lambda: looks.append(1))
    assert len(list(iter(lines.next, None))) == 2000
    assert len(looks) >= 3


def test_a_line_that_is_too_long_is_refused_and_its_rest_skipped(pipe):
    reading, writing = pipe
    os.write(writing, b"x" * 9000 + b"\nshow\n")
    os.close(writing)
    lines = TypedLines(reading, lambda: None)
    with pytest.raises(CommandError, match="at most 1000 bytes"):
        lines.next()
    assert [lines.next(), lines.next()] == ["show", None]


def test_a_line_continues_after_an_error_of_the_bench(pipe):
    reading, writing = pipe
    os.write(writing, b"sh")
    raised = [RuntimeError("tripped")]

    def meanwhile():
        if raised:
            raise raised.pop()

    lines = TypedLines(reading, meanwhile)
    with pytest.raises(RuntimeError):
        lines.next()
    os.write(writing, b"ow\n")
    assert lines.next() == "show"


def test_ctrl_c_is_raised_once():
    with Interruptions() as interruptions:
        interruptions.check()
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(StoppedByOperatorError):
            interruptions.check()
        interruptions.check()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_end_is_raised_at_every_check(number):
    with Interruptions() as interruptions:
        os.kill(os.getpid(), number)
        for _ in range(2):
            with pytest.raises(EndSessionError):
                interruptions.check()


def test_former_signal_handlers_are_restored():
    before = signal.getsignal(signal.SIGINT)
    with Interruptions():
        assert signal.getsignal(signal.SIGINT) != before
    assert signal.getsignal(signal.SIGINT) == before
