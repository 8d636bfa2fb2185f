"""Converts a block of measurements to a procedure file, and gets its times from the planner."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.documents import Document, parse_document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.investigation.blocks import Block
from gyrobench.bench.investigation.external_bench import AnyStep, BlockPlan, ChamberStep, DwellStep, PowerStep
from gyrobench.bench.investigation.profile import Profile
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import GoTo, Navigate, PowerOn

#: For shorter times off, the power-on step itself switches the unit off and on.
SHORTLY_S = 30.0
_SETTLE_S = 60.0

#: Plans a document from the start state of a block; raises DocumentError if the bench can't run it.
Planner = Callable[[Document, BlockPlan], Plan]


@dataclass(frozen=True)
class DwellPattern:
    """Steps with which a campaign measures a dwell; blocks measure their dwells in the same way."""

    go_to: dict[str, Any]  #: Keys of the ``go_to`` step, without position and azimuth.
    steps: tuple[PlannedStep, ...]  #: The steps of one dwell.
    length_s: float  #: From the start of its first navigation to the end of its last one.
    settle_s: float  #: Wait after a power-on.

    @classmethod
    def of(cls, plan: Plan) -> DwellPattern:
        """Pattern of the most frequent dwell of a plan. Raises DocumentError if no dwell measures a bias."""
        measuring = [each for each in plan.steps if each.dwell and each.purpose is DwellPurpose.CALIBRATION]
        if not measuring:
            raise DocumentError(f"{plan.procedure.procedure}: has no dwells that blocks could repeat")
        dwells = [tuple(steps) for _, steps in groupby(measuring, key=lambda each: each.dwell)]
        dwell_texts = [json.dumps([_entry(each) for each in steps]) for steps in dwells]
        most_frequent = dwells[dwell_texts.index(Counter(dwell_texts).most_common(1)[0][0])]
        navigations = _navigations(most_frequent)
        go_tos = [each.step for each in plan.steps[: most_frequent[0].number] if isinstance(each.step, GoTo)]
        settle_times_s = [each.step.settle_s for each in plan.steps if isinstance(each.step, PowerOn)]
        return cls(
            go_tos[-1].model_dump(exclude={"position", "azimuth_deg"}, exclude_unset=True) if go_tos else {},
            most_frequent,
            navigations[-1].end_s - navigations[0].start_s,
            settle_times_s[0] if settle_times_s else _SETTLE_S,
        )

    def entries(
        self, position: str, azimuth_deg: float = 0.0, length_s: float = 0.0
    ) -> Iterator[dict[str, Any]]:
        """Entries of a procedure file for one dwell; navigations are longer if ``length_s`` is."""
        yield {"go_to": {"position": position, "azimuth_deg": azimuth_deg, **self.go_to}}
        length_ratio = max(length_s / self.length_s, 1.0)
        for planned in self.steps:
            entry = _entry(planned)
            if isinstance(planned.step, Navigate) and length_ratio > 1.2:
                keys = entry["navigate"]
                for key in {"duration_s", "at_most_s"} & keys.keys():
                    keys[key] = round(length_ratio * keys[key])
            yield entry


@dataclass(frozen=True)
class BlockProcedure:
    """A block as a procedure file."""

    text: str  #: YAML.
    counts: tuple[int, ...]  #: Number of procedure steps for each step of the block.

    def timed(self, block: Block, plan: Planner) -> Block:
        """The block with the times of the planner. Raises DocumentError if the bench can't run it."""
        planned = plan(parse_document(self.text, Path(f"{block.name}.yaml")), block.plan)
        steps, first, now_s = list[AnyStep](), 0, 0.0
        for step, count in zip(block.plan.steps, self.counts, strict=True):
            step_plan = planned.steps[first : first + count]
            first += count
            begin_s, now_s = now_s, step_plan[-1].end_s if step_plan else now_s
            times_s = begin_s, now_s
            if isinstance(step, DwellStep):
                navigations = _navigations(step_plan)
                times_s = navigations[0].start_s, navigations[-1].end_s
            start_s, end_s = (block.plan.start_s + each for each in times_s)
            steps.append(step.model_copy(update={"start_s": start_s, "end_s": end_s}))
        return replace(block, plan=block.plan.model_copy(update={"steps": steps}))


def block_procedure(plan: BlockPlan, pattern: DwellPattern) -> BlockProcedure:
    """Convert a block to a procedure. Raises DocumentError if no procedure can do it."""
    entries, counts, is_on = list[Any](), list[int](), False
    for step in plan.steps:
        step_entries = list(_entries(step, pattern, is_on))
        is_on = step.on if isinstance(step, PowerStep) else is_on
        entries += step_entries
        counts.append(len(step_entries))
    content = {
        "procedure": f"cycle_{plan.next_cycle}",
        "description": "Block of an investigation, as its plan.json says.",
        "steps": [{"repeat": {"over": {"cycle": [plan.next_cycle]}, "steps": entries}}],
    }
    return BlockProcedure(yaml.safe_dump(content, sort_keys=False, default_flow_style=None), tuple(counts))


def opening_procedure(profile: Profile, pattern: DwellPattern) -> str:
    """YAML text of a procedure with the first dwells of an adaptive campaign."""
    steps: list[Any] = [{"power_on": {"settle_s": pattern.settle_s}}]
    for cycle, set_points_c in enumerate(profile.opening, start=1):
        entries = list[Any]()
        for to_c in set_points_c:
            rate_c_per_min = round(profile.ramp_c_per_h / 60.0, 4)
            entries.append({"chamber": {"temperature_c": to_c, "ramp_c_per_min": rate_c_per_min}})
            for position in profile.positions[:: -1 if cycle % 2 == 0 else 1]:
                entries += pattern.entries(position)
        steps.append({"repeat": {"over": {"cycle": [cycle]}, "steps": entries}})
    content = {
        "procedure": "opening",
        "description": "First dwells of an adaptive campaign, at the extremes and in the middle.",
        "steps": [*steps, "power_off", "chamber_off"],
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


def _entries(step: AnyStep, pattern: DwellPattern, is_on: bool) -> Iterator[Any]:
    duration_s = round(step.end_s - step.start_s)
    if isinstance(step, DwellStep):
        yield from pattern.entries(step.position, step.azimuth_deg, step.end_s - step.start_s)
    elif isinstance(step, ChamberStep):
        rate_c_per_min = round(step.ramp_c_per_h / 60.0, 4)
        yield {"chamber": {"temperature_c": round(step.to_c, 3), "ramp_c_per_min": rate_c_per_min}}
    elif not isinstance(step, PowerStep):
        yield {"soak": {"for_s": duration_s}}
    elif (step.factor or 1.0) != 1.0:
        raise DocumentError("no step of a procedure changes the dissipation of the unit")
    elif step.on and not is_on:
        yield {"power_on": {"settle_s": pattern.settle_s}}
    elif not step.on and duration_s > SHORTLY_S:
        yield "power_off"
        yield {"wait": {"duration_s": duration_s}}


def _entry(planned: PlannedStep) -> dict[str, Any]:
    return {planned.step.name: planned.step.model_dump(mode="json", exclude_unset=True)}


def _navigations(steps: Sequence[PlannedStep]) -> list[PlannedStep]:
    return [each for each in steps if isinstance(each.step, Navigate)]
