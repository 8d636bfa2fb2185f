"""A console for runs of days: whatever becomes of the terminal, the run goes on."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import Any

from rich.console import Console


class PatientConsole(Console):
    """A console that falls silent when nobody reads it any more: that must not end a run.

    What its terminal can't show, as ± in ASCII, is a question mark there. Parameters are those of
    :class:`rich.console.Console`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        if isinstance(self.file, io.TextIOWrapper):
            self.file.reconfigure(errors="replace")

    def on_broken_pipe(self) -> None:
        """Print nothing from here on; standard output goes nowhere, so that closing it succeeds."""
        self.quiet = True
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())

    def _write_buffer(self) -> None:
        """Fall silent as well where the terminal has gone."""
        try:
            super()._write_buffer()
        except BrokenPipeError:
            raise
        except OSError:
            self.on_broken_pipe()
