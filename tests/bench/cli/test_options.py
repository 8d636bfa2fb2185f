"""Options of commands that are numbers."""

import pytest
import typer

from gyrobench.bench.cli import app
from tests.bench.command_line import gyrobench

OPTIONS = [
    (name, command, option.opts[0])
    for name, command in typer.main.get_command(app).commands.items()
    for option in command.params
    if "float" in str(option.type_descriptor.annotation)
]
#: Options that a command can't do without.
REQUIRED = {"record": ["--instrument", "table", "--out", "table.rec"]}


@pytest.mark.parametrize("text", ["inf", "-inf", "nan"])
@pytest.mark.parametrize(("name", "command", "option"), OPTIONS)
def test_no_option_that_is_a_number_takes_one_without_an_end(name, command, option, text):
    others = [each.name for each in command.params if each.param_type_name == "argument" and each.required]
    others += REQUIRED.get(name, [])
    with pytest.raises(typer.BadParameter) as refused:
        command.make_context(name, [f"{option}={text}", *others])
    assert f"'{option}'" in refused.value.format_message()


def test_an_infinite_budget_is_refused_before_anything_is_measured(tmp_path):
    answer = gyrobench("investigate", "quick_campaign", "--budget-h", "inf", cwd=tmp_path)
    assert answer.returncode == 2
    assert "inf is no finite number" in answer.stderr
    assert not list(tmp_path.iterdir())
