"""Actions of the kinds of step."""

import pytest

from gyrobench.bench.engine.actions import perform
from gyrobench.bench.procedure.procedure_file import STEP_KINDS
from gyrobench.bench.procedure.steps import Step


@pytest.mark.parametrize("kind", STEP_KINDS.values(), ids=STEP_KINDS)
def test_each_kind_of_step_has_an_action(kind):
    assert perform.dispatch(kind) is not perform.dispatch(Step)
