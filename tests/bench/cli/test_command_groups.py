"""The list of commands in the help."""

import typer

from gyrobench.bench.cli import GROUPS, app
from tests.bench.command_line import gyrobench


def test_every_command_is_in_a_group_in_its_order(tmp_path):
    command = typer.main.get_command(app)
    grouped = [name for names in GROUPS.values() for name in names]
    visible = [name for name in command.list_commands(None) if not command.commands[name].hidden]
    assert visible == grouped
    assert sorted(command.commands) == sorted([*grouped, "tell"])
    shown = gyrobench("--help", cwd=tmp_path).stdout
    assert all(f"\n  {name} " in shown for name in grouped)
