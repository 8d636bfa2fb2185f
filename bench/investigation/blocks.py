"""Blocks of measurements that can be proposed, each timed from the present state of the bench."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.investigation.external_bench import (
    AnyStep,
    BlockPlan,
    ChamberStep,
    DwellStep,
    PowerStep,
    SoakStep,
    StartState,
)
from gyrobench.bench.investigation.forecast import chamber_c
from gyrobench.bench.navigation.positions import POSITIONS

_SWITCH_S = 60.0
#: Time off before a power-on that only begins a block.
_RESTART_OFF_H = 5.0 / 3600.0
#: Slow and fast ramps, relative to the usual one.
_SLOW, _FAST = 0.25, 2.0
#: Time constant of the unit and duration of the campaign for which blocks have their usual times.
_USUAL_CONSTANT_S, _USUAL_CAMPAIGN_H = 2400.0, 46.0
_MAX_FASTER = 4.0
_REVERSAL_C = 15.0
_LESS_POWER = 0.7
_SAME_C = 0.5
#: The kind that tests a law composed from the earlier dwells.
NEW_CYCLE = "new cycle"


@dataclass(frozen=True)
class Block:
    """A candidate for the next measurement."""

    kinds: tuple[str, ...]  #: Its kinds in order: "power cycle".
    instruction: str  #: Clause in the imperative: "switch the unit off for an hour, then measure".
    plan: BlockPlan  #: Its timed steps.

    @property
    def name(self) -> str:
        """Its kinds as text: "power cycle, then slow ramp"."""
        return ", then ".join(self.kinds)


@dataclass(frozen=True)
class BlockTimes:
    """Times and ramps of blocks."""

    off_h: float = 1.0  #: Time off in a power cycle.
    soak_h: float = 2.0  #: Soak at a temperature before dwells.
    wait_h: float = 6.0  #: Wait before a repetition.
    long_wait_h: float = 12.0  #: Wait after a power-on.
    ramp_c_per_h: float = 60.0

    @classmethod
    def on_bench(cls, time_constant_s: float, campaign_h: float) -> BlockTimes:
        """Times for a unit with this time constant behind the chamber, and a campaign of this length."""
        usual, lag = cls(), min(time_constant_s / _USUAL_CONSTANT_S, 1.0)
        share = min(campaign_h / _USUAL_CAMPAIGN_H, 1.0)
        return cls(
            lag * usual.off_h,
            lag * usual.soak_h,
            share * usual.wait_h,
            share * usual.long_wait_h,
            min(1.0 / lag, _MAX_FASTER) * usual.ramp_c_per_h,
        )


@dataclass(frozen=True)
class BlockStart:
    """Time and state at which a block begins, on a bench that switches the unit off and on for each block."""

    time_s: float  #: Time on the time axis of the table.
    state: StartState
    power_ons: int  #: Number of power-ons so far.
    times: BlockTimes


class BlockPlanner(Protocol):
    """Constraints of a bench on blocks before they are proposed."""

    def start(self, rows: Sequence[DwellRow]) -> BlockStart | None:
        """Start of a block after these dwells; None if the bench stays in the state after the last one."""

    def timed(self, block: Block) -> Block | None:
        """The block with the bench's times; None if the bench can't do it."""


@dataclass
class Timeline:
    """Sequence of steps under construction, from the state after the last dwell of a table.

    With ``start``, the steps begin there: the chamber returns to the last dwell's temperature, and the unit
    is switched off and on.
    """

    rows: Sequence[DwellRow]  #: The dwells measured, in the order of time.
    steps: list[AnyStep] = field(default_factory=list)
    start: BlockStart | None = None

    def __post_init__(self) -> None:
        last = self.rows[-1]
        self.start_s = self.now_s = last.end_s
        chambers_c = chamber_c(self.rows)
        self.low_c, self.middle_c, self.high_c = np.quantile(chambers_c, [0.0, 0.5, 1.0]).tolist()
        self.chamber_c = float(chambers_c[-1])
        self.measured = [name for name in POSITIONS if any(row.position == name for row in self.rows)]
        vertical = [name for name in ("z_up", "z_down") if name in self.measured]
        self.pair = vertical or self.measured[:2]  #: Positions for comparisons.
        self.run = last.run
        self.dwell_s = float(np.median([row.end_s - row.start_s for row in self.rows]))
        self._next_dwell = self.next_dwell = 1 + max(row.dwell for row in self.rows)
        self.next_cycle = 1 + max(row.cycle for row in self.rows)
        self._power_ons = len({row.run for row in self.rows})
        self.times = self.start.times if self.start else BlockTimes()
        self._is_ready = self.start is None
        if self.start is not None:
            self.start_s = self.now_s = self.start.time_s
            self._power_ons = self.start.power_ons
            at_c = self.start.state.chamber_c
            span_s = 0.0 if at_c is None else abs(self.chamber_c - at_c) / self.times.ramp_c_per_h * S_PER_H
            self._ramp_to(self.chamber_c, self.times.ramp_c_per_h, span_s)

    def power_cycle(self, hours: float | None = None) -> None:
        """Switch the unit off, let it cool, and switch it on again: begins a new run."""
        self._is_ready = True
        self._add(PowerStep(on=False, **self._times((hours or self.times.off_h) * S_PER_H)))
        self._power_ons += 1
        self.run = f"{self.rows[-1].run.rsplit('-', 1)[0]}-{self._power_ons}"
        self.set_dissipation(1.0)

    def set_dissipation(self, factor: float) -> None:
        """Set the unit's dissipation relative to the usual dissipation."""
        self._switch_on()
        self._add(PowerStep(on=True, factor=factor, **self._times(_SWITCH_S)))

    def ramp(self, to_c: float, relative: float = 1.0) -> None:
        """Ramp the chamber at ``relative`` times the usual rate, unless it has this temperature."""
        rate_c_per_h = relative * self.times.ramp_c_per_h
        self._switch_on()
        if abs(to_c - self.chamber_c) > _SAME_C:
            span_s = abs(to_c - self.chamber_c) / rate_c_per_h * S_PER_H
            self._ramp_to(to_c, rate_c_per_h, span_s)

    def soak(self, hours: float | None = None) -> None:
        """Wait at the present temperature, by default for the usual soak."""
        self._switch_on()
        self._add(SoakStep(**self._times((hours or self.times.soak_h) * S_PER_H)))

    def measure_dwells(
        self, positions: Iterable[str] = tuple(POSITIONS), azimuth_deg: float = 0.0, length: float = 1.0
    ) -> None:
        """Measure dwells, each ``length`` times as long as those of the table."""
        self._switch_on()
        for position in positions:
            self._add(
                DwellStep(
                    dwell=self._next_dwell,
                    cycle=self.next_cycle,
                    run=self.run,
                    position=position,
                    azimuth_deg=azimuth_deg,
                    **self._times(length * self.dwell_s),
                )
            )
            self._next_dwell += 1

    def _ramp_to(self, to_c: float, rate_c_per_h: float, span_s: float) -> None:
        self._add(ChamberStep(to_c=float(to_c), ramp_c_per_h=rate_c_per_h, **self._times(span_s)))
        self.chamber_c = to_c

    def _switch_on(self) -> None:
        if not self._is_ready:
            self.power_cycle(_RESTART_OFF_H)

    def plan(self) -> BlockPlan:
        """The steps as a plan."""
        return BlockPlan(
            unit=self.rows[-1].unit,
            start_s=self.start_s,
            state=self.start.state if self.start else self._state_after_last_dwell(),
            next_dwell=self.next_dwell,
            next_cycle=self.next_cycle,
            steps=self.steps,
        )

    def _state_after_last_dwell(self) -> StartState:
        last = self.rows[-1]
        warm = [row for row in self.rows if np.isfinite([*row.gyro_c, *row.gyro_rate_c_per_h]).all()][-1]
        rise_c = np.array(warm.gyro_rate_c_per_h) * 0.5 * (warm.end_s - warm.start_s) / S_PER_H
        x_c, y_c, z_c = (np.array(warm.gyro_c) + rise_c).tolist()
        return StartState(
            chamber_c=last.chamber_c if np.isfinite(last.chamber_c) else None,
            gyro_x_c=x_c,
            gyro_y_c=y_c,
            gyro_z_c=z_c,
            powered=True,
            since_power_on_s=last.since_power_on_s + last.end_s - last.start_s,
            position=last.position,
        )

    def _add(self, step: AnyStep) -> None:
        self.steps.append(step)
        self.now_s = step.end_s

    def _times(self, duration_s: float) -> dict[str, Any]:
        return {"start_s": self.now_s, "end_s": self.now_s + duration_s}


@dataclass(frozen=True)
class BlockKind:
    """One kind of block, and the steps that it adds to a timeline."""

    name: str
    instruction: str
    add: Callable[[Timeline], None]


def _soak_and_measure(timeline: Timeline, at_c: float) -> None:
    timeline.ramp(at_c)
    timeline.soak()
    timeline.measure_dwells()


def _soak_from(timeline: Timeline, from_c: float) -> None:
    timeline.ramp(from_c)
    timeline.soak(0.5 * timeline.times.soak_h)
    timeline.measure_dwells(
        timeline.pair[:1]
    )  # so that the table shows the temperature from which the soak was approached
    _soak_and_measure(timeline, timeline.middle_c)


def _on_ramp(timeline: Timeline, relative: float) -> None:
    """Measure dwells without a pause while the chamber ramps in steps of one dwell."""
    to_c = max(timeline.high_c, timeline.low_c, key=lambda end_c: abs(timeline.chamber_c - end_c))
    rate_c_per_h = relative * timeline.times.ramp_c_per_h
    step_c = np.sign(to_c - timeline.chamber_c) * rate_c_per_h * timeline.dwell_s / S_PER_H
    for position in POSITIONS:
        if abs(to_c - timeline.chamber_c) > abs(step_c):
            timeline.ramp(timeline.chamber_c + float(step_c), relative)
        timeline.measure_dwells([position])


def _reversal(timeline: Timeline) -> None:
    timeline.ramp(timeline.middle_c)
    timeline.soak()
    timeline.measure_dwells(timeline.pair)
    timeline.ramp(min(timeline.middle_c + _REVERSAL_C, timeline.high_c))
    timeline.measure_dwells(timeline.pair[:1])
    timeline.ramp(timeline.middle_c)
    timeline.soak(0.5 * timeline.times.soak_h)
    timeline.measure_dwells(timeline.pair)


def _power_cycle(timeline: Timeline) -> None:
    timeline.power_cycle()
    timeline.measure_dwells()


def _power_cycle_and_wait(timeline: Timeline) -> None:
    timeline.power_cycle()
    timeline.measure_dwells(timeline.pair)
    timeline.soak(timeline.times.long_wait_h)
    timeline.measure_dwells(timeline.pair)


def _power_step(timeline: Timeline) -> None:
    timeline.set_dissipation(_LESS_POWER)
    timeline.soak()
    timeline.measure_dwells()
    timeline.set_dissipation(1.0)


def _headings(timeline: Timeline, position: str) -> None:
    for azimuth_deg in (0.0, 90.0, 180.0, 270.0):
        timeline.measure_dwells([position], azimuth_deg)


def _repeat_after_hours(timeline: Timeline) -> None:
    timeline.soak(timeline.times.wait_h)
    timeline.measure_dwells()


def _longer_dwells(timeline: Timeline) -> None:
    timeline.measure_dwells(timeline.pair, length=3.0)


def _new_cycle(timeline: Timeline) -> None:
    timeline.power_cycle()
    for at_c in (timeline.middle_c, timeline.high_c, timeline.low_c):
        _soak_and_measure(timeline, at_c)


def _usual_kinds(start: Timeline) -> list[BlockKind]:
    """The usual kinds, with instructions for blocks that begin like the timeline ``start``."""
    off, wait, long_wait = map(
        _duration_text, (start.times.off_h, start.times.wait_h, start.times.long_wait_h)
    )
    off, return_and_measure = (
        f"switch the unit off for {off}",
        "return to the middle temperature and measure after a soak",
    )
    other_positions = [name for name in start.measured if name[0] != start.pair[0][0]]
    kinds: list[tuple[str, str, Callable[[Timeline], None]]] = [
        ("soak from above", f"heat, {return_and_measure}", partial(_soak_from, from_c=start.high_c)),
        ("soak from below", f"cool, {return_and_measure}", partial(_soak_from, from_c=start.low_c)),
        ("slow ramp", "measure while the temperature changes slowly", partial(_on_ramp, relative=_SLOW)),
        ("fast ramp", "measure while the temperature changes fast", partial(_on_ramp, relative=_FAST)),
        ("reversal", "leave the middle temperature, return to it, and measure before and after", _reversal),
        ("power cycle", f"{off}, then measure from power-on", _power_cycle),
        (
            "power cycle and long wait",
            f"{off}, measure from power-on and again {long_wait} later",
            _power_cycle_and_wait,
        ),
        ("power step", "reduce the unit's dissipation and measure after a soak", _power_step),
        (
            "four headings",
            "measure one position at four headings",
            partial(_headings, position=start.pair[0]),
        ),
        *(
            (
                "four headings on the side",
                "measure another position at four headings",
                partial(_headings, position=each),
            )
            for each in other_positions[:1]
        ),
        (
            "cold, six positions",
            "measure all positions at the lowest temperature",
            partial(_soak_and_measure, at_c=start.low_c),
        ),
        (
            "hot, six positions",
            "measure all positions at the highest temperature",
            partial(_soak_and_measure, at_c=start.high_c),
        ),
        ("repeat after hours", f"wait for {wait}, then measure all positions again", _repeat_after_hours),
        ("longer dwells", "measure two positions in long dwells", _longer_dwells),
        (NEW_CYCLE, f"{off}, then measure all positions at three temperatures", _new_cycle),
    ]
    return [BlockKind(*each) for each in kinds]


def _duration_text(hours: float) -> str:
    return f"{60.0 * hours:.0f} min" if hours < 1.0 else f"{hours:.2g} h"


def catalogue(
    rows: Sequence[DwellRow],
    sequences: Iterable[Sequence[str]] | None = None,
    start: BlockStart | None = None,
    more: Iterable[BlockKind] = (),
) -> list[Block]:
    """Blocks that can follow the dwells ``rows``, which are in the order of time, from ``start``.

    ``sequences``: sequences of names of kinds; by default one for each kind. ``more``: additional kinds.
    """
    kinds = {each.name: each for each in (*_usual_kinds(Timeline(rows, start=start)), *more)}
    blocks = []
    for names in ((name,) for name in kinds) if sequences is None else sequences:
        timeline, sequence = Timeline(rows, start=start), [kinds[name] for name in names]
        for kind in sequence:
            kind.add(timeline)
        blocks.append(
            Block(
                tuple(kind.name for kind in sequence),
                "; then ".join(kind.instruction for kind in sequence),
                timeline.plan(),
            )
        )
    return blocks
