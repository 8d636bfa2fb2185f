"""Lines that are typed or piped."""

import contextlib
import os

import pytest

from gyrobench.bench.jog.terminal import CommandError, TypedLines


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


def test_the_bench_goes_on_until_a_whole_line_is_there(pipe):
    reading, writing = pipe
    pieces = [b"sh", b"ow", b"\n"]
    lines = TypedLines(reading, lambda: os.write(writing, pieces.pop(0)))
    assert lines.next() == "show"
    assert pieces == []


def test_bytes_that_are_no_text_are_a_line_all_the_same(pipe):
    reading, writing = pipe
    os.write(writing, b"\xff\xfe\n")
    assert TypedLines(reading, lambda: None).next() == "��"


def test_what_the_bench_raises_meanwhile_comes_through(pipe):
    def trip():
        raise RuntimeError("tripped")

    with pytest.raises(RuntimeError, match="tripped"):
        TypedLines(pipe[0], trip).next()


def test_the_bench_goes_on_before_every_look_however_much_is_typed(pipe):
    reading, writing = pipe
    looks = []
    os.write(writing, b"show\n" * 2000)
    os.close(writing)
    lines = TypedLines(reading, lambda: looks.append(1))
    assert len(list(iter(lines.next, None))) == 2000
    assert len(looks) >= 3


def test_a_line_that_is_too_long_is_refused_and_the_rest_of_it_passed_over(pipe):
    reading, writing = pipe
    os.write(writing, b"x" * 9000 + b"\nshow\n")
    os.close(writing)
    lines = TypedLines(reading, lambda: None)
    with pytest.raises(CommandError, match="at most 1000 bytes"):
        lines.next()
    assert [lines.next(), lines.next()] == ["show", None]


def test_a_line_goes_on_after_what_the_bench_raised_meanwhile(pipe):
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
