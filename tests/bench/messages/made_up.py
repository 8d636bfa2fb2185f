"""A message with everything in it."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from gyrobench.bench.messages.delivery import Message, Remaining

NEEDS_PERSON = Message(
    event="needs_person",
    why="the chamber is 3.1 K off its set point",
    station="bench_2",
    time=datetime(2026, 3, 1, 2, 30, tzinfo=UTC),
    folder=Path("/data/runs/fig7-001"),
    procedure="six_position_fig7",
    unit="1001",
    question="The run holds: the chamber is 3.1 K off its set point",
    answers=("continue", "abort"),
    remaining=Remaining(31.7, 45),
)
ENDS = replace(
    NEEDS_PERSON, event="ends", ended="finished", question="", answers=(), remaining=Remaining(0.0, 0)
)
