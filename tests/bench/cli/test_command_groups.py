"""The list of commands in the help."""

import re
from types import SimpleNamespace

import pytest
import typer
from typer.testing import CliRunner

from gyrobench.bench.cli import GROUPS, _name_value, app
from gyrobench.bench.cli.output import EXIT_WRONG_INPUT
from tests.bench.command_line import gyrobench


def test_every_command_is_in_a_group_in_its_order(tmp_path):
    command = typer.main.get_command(app)
    grouped = [name for names in GROUPS.values() for name in names]
    visible = [name for name in command.list_commands(None) if not command.commands[name].hidden]
    assert visible == grouped
    assert sorted(command.commands) == sorted([*grouped, "tell"])
    shown = gyrobench("--help", cwd=tmp_path).stdout
    assert all(f"\n  {name} " in shown for name in grouped)


@pytest.mark.parametrize(
    ("word", "instead"), [("status", "monitor RUN"), ("pause", "control RUN pause"), ("help", "--help")]
)
def test_a_command_that_does_not_exist_names_the_one_that_does_its_task(word, instead):
    result = CliRunner().invoke(app, [word])
    assert result.exit_code == EXIT_WRONG_INPUT
    assert f"No such command '{word}'. Use gyrobench {instead}" in result.output


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("run", ["PROCEDURE  Procedure file", "--seed INTEGER", "--station FILE|NAME", "--view live|lines"]),
        ("control", ["COMMAND <pause|continue|hold|skip|finish|abort>"]),
        ("fleet bins", ["--workers INTEGER"]),
    ],
)
def test_help_names_values_in_words_instead_of_types_of_python(command, shown):
    text = CliRunner().invoke(app, [*command.split(), "--help"], env={"COLUMNS": "100"}).output
    assert all(each in text for each in shown), text
    assert "list[" not in text
    assert not re.search(r"<[a-z ]+>", text)


def test_parameters_of_an_older_typer_keep_the_names_that_it_gives():
    parameter = SimpleNamespace(param_type_name="option", metavar=None, is_flag=False)
    _name_value(parameter)
    assert parameter.metavar is None
