"""Options of commands that are numbers."""

from typing import get_args

import pytest
import typer

from gyrobench.bench.authoring.file_kinds import KINDS
from gyrobench.bench.bias.verdicts import RunVerdict
from gyrobench.bench.cli import app
from gyrobench.bench.cli.options import FailOnOption, TracedInstrument
from gyrobench.bench.cli.run_selection import AcceptanceVerdict
from gyrobench.bench.cli.validate import FileKindName
from gyrobench.bench.closure import inputs, loop
from gyrobench.bench.engine.run_outcome import FailOn
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.report import closure_page
from gyrobench.bench.station.instrument_sections import Traceability
from tests.bench.command_line import refusal_of

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


def test_no_flag_has_a_form_that_switches_it_off():
    commands = typer.main.get_command(app).commands
    flags = [
        option
        for name in commands
        for command in getattr(commands[name], "commands", {name: commands[name]}).values()
        for option in command.params
        if getattr(option, "is_flag", False)
    ]
    assert {"--delay", "--look", "--threads"} <= {name for flag in flags for name in flag.opts}
    assert not [name for flag in flags for name in flag.secondary_opts]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (("schema", "proc"), "'KIND': 'proc' is not one of 'procedure', 'station', "),
        (("schema", "proc"), "'rotation_list' (did you mean 'procedure'?).\n"),
        (("monitor", "runs", "--port", "x"), "'--port': the value must be a whole number.\n"),
        (("fleet", "close", "runs", "--workers", "0"), "'--workers': the value must be at least 1.\n"),
        (("plan", "rotations", "--target-dph", "inf"), "'--target-dph': inf is not a finite number.\n"),
        (("runs", "--verdict", "acepted"), "'not judged' (did you mean 'accepted'?).\n"),
        (("runs", "--since", "31.3.2026"), "'--since': '31.3.2026' is no date such as 2026-03-31.\n"),
        (("runs", "--ended", "finshed"), "'not ended' (did you mean 'finished'?).\n"),
        (("run", "rotations", "--acknowledge", "table"), "'table' is not one of 'rate_table', 'chamber_"),
        (("calibrate", "log.csv"), "Missing option '--map'.\n"),
    ],
)
def test_a_wrong_value_is_reported_in_plain_words_with_the_nearest_one(command, message, tmp_path):
    problem = refusal_of(*command, cwd=tmp_path)
    assert message in problem
    assert "Value error" not in problem


def test_every_traced_instrument_can_be_acknowledged():
    assert set(TracedInstrument) == set(Traceability.model_fields)


def test_an_infinite_budget_is_refused_before_anything_is_measured(tmp_path):
    problem = refusal_of("investigate", "quick_campaign", "--budget-h", "inf", cwd=tmp_path)
    assert "inf is not a finite number" in problem
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("options", "expected"), [((), False), (("--hold-out-each",), True)])
def test_each_cycle_is_held_out_by_the_option(options, expected, monkeypatch):
    held_out = []

    def write(*_):
        raise DocumentError("not written")

    monkeypatch.setattr(inputs, "read_campaign", lambda *_, **__: None)
    monkeypatch.setattr(loop, "close_loop", lambda *_: None)
    monkeypatch.setattr(loop, "hold_out_each", held_out.append)
    monkeypatch.setattr(closure_page, "write_search", write)
    command = typer.main.get_command(app).commands["close"]
    with pytest.raises(DocumentError, match="not written"):
        command(["dwells.csv", *options], standalone_mode=False)
    assert bool(held_out) is expected


def test_choices_that_the_command_line_repeats_are_those_of_their_modules():
    assert get_args(FileKindName) == tuple(KINDS)
    offered, _ = get_args(get_args(FailOnOption)[0])
    assert get_args(offered) == get_args(FailOn)
    assert get_args(AcceptanceVerdict) == get_args(RunVerdict)
