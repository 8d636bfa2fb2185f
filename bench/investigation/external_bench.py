"""A bench behind a command, which gets a block of measurements as ``PLAN.json`` and writes the new dwells."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shlex
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.closure.campaign import Campaign, campaign_of
from gyrobench.bench.closure.plausibility import implausible
from gyrobench.bench.foundations.arrays import S_PER_H, FloatArray
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.navigation.positions import AXES

#: Exit code of a bench that can't do the block.
_REFUSED = 3
_MAX_MESSAGE_CHARACTERS = 500
_TIMEOUT_FACTOR, _TIMEOUT_MARGIN_S = 1.5, 600.0
#: Time that a terminated command has to switch its bench off.
_TERMINATION_S = 10.0
_Block = TypeVar("_Block")
#: Largest ratio of sigmas to those of the first table, in either direction.
_MAX_SIGMA_RATIO = 5.0


class TimedStep(StrictModel):
    """Base class of the steps, with their planned times on the time axis of the table."""

    start_s: float = Field(description="planned start, s")
    end_s: float = Field(description="planned end, s")


class PowerStep(TimedStep):
    """Switch the unit off or on."""

    kind: Literal["power"] = "power"
    on: bool = Field(description="whether the unit is on afterwards")
    factor: float | None = Field(
        default=None, gt=0.0, description="dissipation relative to the usual one, where the bench can vary it"
    )


class ChamberStep(TimedStep):
    """Ramp the chamber."""

    kind: Literal["chamber"] = "chamber"
    to_c: float = Field(description="set point, degC")
    ramp_c_per_h: float = Field(gt=0.0, description="rate of the set point, degC/h")


class SoakStep(TimedStep):
    """Wait at the present temperature, with the present power."""

    kind: Literal["soak"] = "soak"


class DwellStep(TimedStep):
    """Measure one dwell."""

    kind: Literal["dwell"] = "dwell"
    dwell: int = Field(description="number in the table")
    cycle: int = Field(description="pass of the temperature profile")
    run: str = Field(description="name of the power-on")
    position: str = Field(description="position: z_up, z_down, y_up, y_down, x_up, x_down")
    azimuth_deg: float = Field(description="azimuth at the start, deg")


class StartState(StrictModel):
    """State of bench and unit before the first step."""

    chamber_c: float | None = Field(description="temperature of the chamber, degC; null if not measured")
    gyro_x_c: float = Field(description="temperature of the x gyro, degC")
    gyro_y_c: float = Field(description="temperature of the y gyro, degC")
    gyro_z_c: float = Field(description="temperature of the z gyro, degC")
    powered: bool = Field(description="whether the unit is on")
    since_power_on_s: float = Field(description="time since the last power-on, s")
    position: str = Field(description="position of the last dwell")


AnyStep = Annotated[PowerStep | ChamberStep | SoakStep | DwellStep, Field(discriminator="kind")]


class BlockPlan(StrictModel):
    """A block of measurements: the content of ``PLAN.json``."""

    schema_version: Literal[1] = 1
    unit: str = Field(description="serial number of the INS")
    start_s: float = Field(description="time of the first step, s, on the time axis of the table")
    state: StartState = Field(description="state before the first step")
    next_dwell: int = Field(description="number of the first new dwell")
    next_cycle: int = Field(description="number of the new pass of the profile")
    steps: list[AnyStep] = Field(min_length=1, description="steps in order")

    @property
    def dwells(self) -> list[DwellStep]:
        """The dwells to measure."""
        return [step for step in self.steps if isinstance(step, DwellStep)]

    @property
    def duration_h(self) -> float:
        """Duration of the block."""
        return (self.steps[-1].end_s - self.start_s) / S_PER_H

    def text(self) -> str:
        """JSON text."""
        plan = self.model_dump(mode="json")
        plan["steps"] = [
            {key: value for key, value in step.items() if value is not None} for step in plan["steps"]
        ]
        return json.dumps(plan, indent=1) + "\n"


class BlockRefusedError(GyrobenchError):
    """The bench can't do the block; the message is the bench's reason."""


class AfterLastDwell:
    """A bench that stays in the state after the last dwell, and keeps the planned times."""

    rows: Sequence[DwellRow]  #: Dwells before the first block.

    @property
    def campaign_h(self) -> float:
        """Hours from the start of the first of these dwells to the end of the last."""
        return (max(row.end_s for row in self.rows) - min(row.start_s for row in self.rows)) / S_PER_H

    def campaign(self, rows: Sequence[DwellRow]) -> Campaign:
        """Campaign of the dwells for a search."""
        return campaign_of(rows)

    def start(self, rows: Sequence[DwellRow]) -> None:
        """None, since a block begins after the last of these dwells."""

    def timed(self, block: _Block) -> _Block:
        """The block unchanged."""
        return block


@dataclass(frozen=True)
class ExternalBench(AfterLastDwell):
    """A bench behind a command.

    ``command``: split as by a shell; gets the paths of plan and table as its last two arguments.
    ``rows``: the dwells of the first table.
    ``time_limit_s``: limit for a block; by default derived from the plan, as for a real bench.
    ``notice``: called with messages for the operator.

    Raises DocumentError if the command can't be split.
    """

    command: str
    rows: Sequence[DwellRow]
    time_limit_s: float | None = None
    notice: Callable[[str], None] = lambda text: None  # noqa: ARG005

    def __post_init__(self) -> None:
        try:
            is_empty = not shlex.split(self.command)
        except ValueError as error:
            raise DocumentError(f"--bench {self.command}: {error}. Close each quotation mark") from error
        if is_empty:
            raise DocumentError("--bench is empty. Name the command that measures a block")

    def measure(self, plan: BlockPlan, folder: Path) -> list[DwellRow]:
        """Measure a block; ``folder`` gets the plan, the new table, and the output of the command.

        A complete table in ``folder`` is used without a measurement: the command finished after gyrobench was
        interrupted. Raises BlockRefusedError if the bench can't do the block, and GyrobenchError if the
        command fails, is too slow, or does not write the dwells of the plan.
        """
        plan_file, table, log = (folder / name for name in ("plan.json", "new.csv", "bench.log"))
        if table.exists() and (rows := self._complete_rows(plan, table)):
            return rows
        if log.exists():
            self.notice(
                f"{folder}: this block was interrupted, or its table was refused. It is measured again."
            )
        table.unlink(missing_ok=True)
        write_whole(plan_file, plan.text().encode())
        limit_s = self.time_limit_s or _TIMEOUT_FACTOR * plan.duration_h * S_PER_H + _TIMEOUT_MARGIN_S
        code = self._run([str(plan_file), str(table)], limit_s, log)
        message = log.read_text(encoding="utf-8", errors="replace").strip()[-_MAX_MESSAGE_CHARACTERS:]
        if code:
            # The table of a failed command is not used.
            table.unlink(missing_ok=True)
            log.unlink()
        if code == _REFUSED:
            raise BlockRefusedError(message or "no reason was given")
        if code:
            raise GyrobenchError(
                f"{self.command}: ended with exit code {code}: {message or 'no message'}. "
                "What was measured before is kept"
            )
        return _check_rows(read_dwells(table), plan, table, self.rows)

    def _complete_rows(self, plan: BlockPlan, table: Path) -> list[DwellRow]:
        """Dwells of a table if it has all those of the plan; otherwise empty."""
        try:
            rows = _check_rows(read_dwells(table), plan, table, self.rows)
        except GyrobenchError:
            return []
        return rows if len(rows) == len(plan.dwells) else []

    def _run(self, arguments: Sequence[str], limit_s: float, log: Path) -> int:
        """Run the command and return its exit code; ends it if it is too slow or interrupted."""
        with log.open("wb") as log_file:
            try:
                process = subprocess.Popen(  # noqa: S603 - the user's own command
                    [*shlex.split(self.command), *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=log_file,
                    start_new_session=True,
                )
            except OSError as error:
                raise GyrobenchError(
                    f"{self.command}: can't be started: {error.strerror}. Check --bench"
                ) from error
        try:
            return process.wait(limit_s)
        except subprocess.TimeoutExpired as error:
            raise GyrobenchError(
                f"{self.command}: did not end within {limit_s:.0f} s. Check the bench, or allow more "
                "with --bench-time-limit-s"
            ) from error
        finally:
            if process.returncode is None:
                _terminate(process)


def _terminate(process: subprocess.Popen[bytes]) -> None:
    """Terminate a command and all processes that it started; gives it time to switch the bench off."""
    for name in ("SIGTERM", "SIGKILL"):
        with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
            if os.name == "posix":
                os.killpg(process.pid, getattr(signal, name))
            elif process.poll() is None:
                process.kill()
            process.wait(_TERMINATION_S)


def _check_rows(
    rows: Sequence[DwellRow], plan: BlockPlan, table: Path, first: Sequence[DwellRow]
) -> list[DwellRow]:
    """New rows of a block in the order of time; some dwells of the plan may be missing.

    ``first``: the dwells before the first block. Raises DocumentError if the rows are not dwells of the plan,
    or implausible.
    """
    planned = {step.dwell: step for step in plan.dwells}
    problems = [problem for row in rows for problem in _row_problems(row, planned.get(row.dwell), plan)]
    problems = problems or implausible([*first, *rows]) or [*_wrong_sigmas(rows, first)][:1]
    if not rows:
        problems.append("has no dwells")
    if problems:
        raise DocumentError("\n".join(f"{table}: {each}" for each in problems))
    return sorted(rows, key=lambda row: row.start_s)


def _row_problems(row: DwellRow, step: DwellStep | None, plan: BlockPlan) -> list[str]:
    if step is None:
        return [f"dwell {row.dwell} is not in the plan. Write the dwells of the plan alone"]
    expected = {"unit": plan.unit, "run": step.run, "cycle": step.cycle, "position": step.position}
    problems = [
        f"dwell {row.dwell} has the {name} {getattr(row, name)}, not {value}"
        for name, value in expected.items()
        if getattr(row, name) != value
    ]
    if row.start_s < plan.start_s:
        problems.append(
            f"dwell {row.dwell} starts at {row.start_s:g} s, before its block at {plan.start_s:g} s. Use the "
            "time axis of the table"
        )
    azimuth_error_deg = (row.azimuth_deg - step.azimuth_deg + 180.0) % 360.0 - 180.0
    if math.isfinite(azimuth_error_deg) and abs(azimuth_error_deg) > 1.0:
        problems.append(
            f"dwell {row.dwell} has the azimuth {row.azimuth_deg:g} deg, not {step.azimuth_deg:g}"
        )
    return problems


def _wrong_sigmas(rows: Sequence[DwellRow], first: Sequence[DwellRow]) -> Iterator[str]:
    """Problems of dwells without flags whose sigmas do not match those of the first table."""
    first_sigmas = np.nanmedian([_sigma_for_one_second(row) for row in first if not row.flags], axis=0)
    for row in rows:
        ratios = _sigma_for_one_second(row) / first_sigmas
        for axis, sigma_dph, ratio in zip(AXES, row.sigma_dph, ratios, strict=True):
            if not row.flags and (ratio > _MAX_SIGMA_RATIO or ratio < 1.0 / _MAX_SIGMA_RATIO):
                yield (
                    f"dwell {row.dwell} has sigma_{axis}_dph {sigma_dph:.3g}, {ratio:.2g} times that of the "
                    f"first table for its duration, outside 1/{_MAX_SIGMA_RATIO:g} to {_MAX_SIGMA_RATIO:g}. "
                    "Correct the value or its unit"
                )


def _sigma_for_one_second(row: DwellRow) -> FloatArray:
    return np.array(row.sigma_dph) * math.sqrt(max(row.end_s - row.start_s, 0.0))
