from collections.abc import Callable

import pytest

from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure import procedure_file
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.steps import GoTo, Wait

PlanOf = Callable[[str], tuple[Document, Plan]]


def test_the_first_variable_of_a_loop_is_the_outermost(planned: PlanOf) -> None:
    _, plan = planned(
        "- repeat: {over: {a: [1, 2], b: [10, 20]}, "
        "steps: [{wait: {duration_s: $a}}, {wait: {duration_s: $b}}]}"
    )
    waits = [one.step.duration_s for one in plan.steps if isinstance(one.step, Wait)]
    assert waits == [1, 10, 1, 20, 2, 10, 2, 20]


def test_an_inner_loop_sees_the_variables_of_the_outer_one(planned: PlanOf) -> None:
    _, plan = planned(
        "- repeat:\n    over: {azimuth: [0, 90]}\n    steps:\n"
        "      - repeat:\n          over: {position: [z_up, x_up]}\n          steps:\n"
        "            - go_to: {position: $position, azimuth_deg: $azimuth}\n"
    )
    moves = [(one.step.position, one.step.azimuth_deg) for one in plan.steps if isinstance(one.step, GoTo)]
    assert moves == [("z_up", 0), ("x_up", 0), ("z_up", 90), ("x_up", 90)]


def test_a_loop_variable_that_no_step_uses_counts_repetitions(planned: PlanOf) -> None:
    _, plan = planned("- repeat: {over: {again: [1, 2, 3]}, steps: [power_off]}")
    assert len(plan.steps) == 3


def test_a_step_knows_where_it_and_the_values_of_its_loop_stand(planned: PlanOf) -> None:
    document, plan = planned(
        "- wait: {duration_s: 5}\n"
        "- repeat:\n    over: {t: [7, 8]}\n    steps:\n      - wait: {duration_s: $t, timeout_s: 90}\n"
    )
    first, _, last = plan.steps
    assert document.place(first.location) == "test.yaml:3:3"
    assert document.place(first.place_of("duration_s")) == "test.yaml:3:10"
    assert document.place(last.location) == "test.yaml:7:9"
    assert document.place(last.place_of("duration_s")) == "test.yaml:5:19"
    assert document.place(last.place_of("timeout_s")) == "test.yaml:7:32"


def test_steps_of_an_anchor_stand_where_the_anchor_is(planned: PlanOf) -> None:
    document, plan = planned(
        "- repeat: {over: {n: [1]}, steps: &two [power_off, {wait: {duration_s: 5}}]}\n"
        "- repeat: {over: {n: [1]}, steps: *two}\n"
    )
    assert (
        document.place(plan.steps[1].location) == document.place(plan.steps[3].location) == "test.yaml:3:53"
    )


def test_as_many_steps_as_allowed_are_planned_and_one_more_is_refused(
    planned: PlanOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    def loop(steps: int) -> str:
        return f"- repeat: {{over: {{a: {[1] * 100}, b: {[1] * (steps // 100)}}}, steps: [power_off]}}"

    with pytest.raises(DocumentError, match="100001 steps"):
        planned(loop(procedure_file.MAX_STEPS) + "\n- power_off")
    monkeypatch.setattr(procedure_file, "MAX_STEPS", 2000)
    _, plan = planned(loop(2000))
    assert len(plan.steps) == 2000
    with pytest.raises(DocumentError, match="2001 steps"):
        planned(loop(2000) + "\n- power_off")
