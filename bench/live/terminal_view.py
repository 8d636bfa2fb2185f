"""The live view of a run at the bottom of the terminal."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.engine.observers import RunOutcome
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.live.c_locale import is_c_locale
from gyrobench.bench.live.keyboard import Keyboard
from gyrobench.bench.live.picture import Picture
from gyrobench.bench.live.recorder import PictureRecorder
from gyrobench.bench.live.screen import TALLEST, WIDEST, screen

#: Rows that stay free above the view, for the lines that scroll by.
_ROWS_ABOVE = 4
_SHORTEST = 4
#: How often the picture is taken, and how often keys that were typed are shown.
_PICTURE_EVERY_S, _KEYS_EVERY_S = 1.0, 0.1


class TerminalView(RunObserver):
    """Shows the newest picture, and what is being typed below it.

    The picture is taken where the run tells its progress; it is drawn in a thread of its own.

    Parameters
    ----------
    console : Console
        A terminal; what is printed to it meanwhile scrolls by above the view.
    recorder : PictureRecorder
        Has the picture.
    keyboard : Keyboard
        What is typed.
    takes_orders : bool
        Whether somebody looks at what is typed.
    can_draw : callable
        Whether the terminal has taken all that was drawn before.
    """

    def __init__(
        self,
        console: Console,
        recorder: PictureRecorder,
        keyboard: Keyboard,
        takes_orders: bool,
        can_draw: Callable[[], bool],
    ) -> None:
        self._console = console
        self._recorder = recorder
        self._keyboard = keyboard
        self._takes_orders = takes_orders
        self._can_draw = can_draw
        self._clock = WallClock()
        self._next_picture_s = 0.0
        self._picture: Picture | None = None
        self._over = threading.Event()
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._thread = threading.Thread(target=self._draw_until_over, daemon=True)

    def __enter__(self) -> TerminalView:
        self._keyboard.__enter__()
        self._live.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._live.stop()
        self._keyboard.__exit__()

    def beat(self, bench: LiveBench) -> None:  # noqa: ARG002
        """Take a new picture if it is time."""
        if self._clock.now() >= self._next_picture_s:
            self._take()

    def held(self, why: str, needs_person: bool, ordered: RunCommand | None) -> None:  # noqa: ARG002
        """Show at once that the run holds."""
        self._take()

    def asked(self, question: str, answers: Sequence[str]) -> None:  # noqa: ARG002
        """Show a question at once."""
        self._take()

    def ended(self, outcome: RunOutcome) -> None:  # noqa: ARG002
        """Show the end."""
        self._take()

    def _take(self) -> None:
        self._picture = self._recorder.picture()
        self._next_picture_s = self._clock.now() + _PICTURE_EVERY_S

    def _draw_until_over(self) -> None:
        drawn: tuple[Picture | None, str, tuple[int, int]] | None = None
        while not self._over.wait(_KEYS_EVERY_S):
            size = (self._console.width, self._console.height)
            typed = self._keyboard.begun if self._takes_orders else ""
            seen = (self._picture, typed, size)
            is_same = drawn is not None and seen[0] is drawn[0] and seen[1:] == drawn[1:]
            if not is_same and self._can_draw():
                self._live.update(Group(*self._lines(*seen)), refresh=True)
                drawn = seen

    def _lines(self, picture: Picture | None, typed: str, size: tuple[int, int]) -> list[Text]:
        width = min(WIDEST, size[0])
        height = min(TALLEST, max(_SHORTEST, size[1] - _ROWS_ABOVE))
        is_ascii = self._console.options.ascii_only or is_c_locale(os.environ)
        prompt = [self._prompt(picture, typed)] if self._takes_orders else []
        if picture is None:
            return [Text("starting", "bold cyan"), *prompt]
        return [*screen(picture, width, height - len(prompt), is_ascii), *prompt]

    def _prompt(self, picture: Picture | None, typed: str) -> Text:
        if typed:
            return Text(f"> {typed}_", no_wrap=True)
        question = picture.question if picture else None
        choice = "an answer" if question else ", ".join(RunCommand)
        return Text.assemble("> ", (f"type {choice}", "dim"), no_wrap=True)
