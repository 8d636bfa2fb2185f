"""`gyrobench jog` on emulated benches."""

import subprocess
import tempfile
import time

import pytest

from gyrobench.bench.cli.output import EXIT_INSTRUMENT, EXIT_NOT_FINISHED
from gyrobench.bench.foundations.shipped import find_document
from tests.bench.command_line import PROCESS, gyrobench


def jog(*arguments, cwd, station="quick", **options):
    return gyrobench("jog", station, *arguments, "--world", "quick", cwd=cwd, **options)


def answers(run):
    """Lines printed after each command."""
    found, command = {}, ""
    for line in run.stdout.splitlines():
        if line.startswith("jog> "):
            command = line.removeprefix("jog> ")
            found[command] = []
        else:
            found.setdefault(command, []).append(line)
    return found


def test_the_table_moves_to_the_commanded_angles(tmp_path):
    run = jog("table outer 30", "table inner -100 at 25", "show", cwd=tmp_path)
    assert run.returncode == 0, run.stdout
    printed = answers(run)
    assert printed["table outer 30"][0] == "servos on"
    outer, inner = printed["show"][:2]
    assert float(outer.split()[2]) == pytest.approx(30.0, abs=0.003)
    assert float(inner.split()[2]) == pytest.approx(-100.0, abs=0.003)
    assert "servos on; the unit is in none of the six positions" in printed["show"][2]


@pytest.mark.parametrize(("position", "azimuth"), [("z_down", 0), ("y_up", 180), ("x_down", 180)])
def test_the_unit_is_brought_to_a_position(position, azimuth, tmp_path):
    run = jog(f"table to {position} {azimuth} at 20", "show", cwd=tmp_path)
    shown = answers(run)["show"][2]
    assert f"the unit is in {position}, azimuth " in shown
    assert float(shown.split()[-2]) % 360.0 == pytest.approx(azimuth, abs=0.02)


def test_home_brings_all_axes_to_zero(tmp_path):
    run = jog("table outer 30", "home", "show", cwd=tmp_path)
    assert "in z_up, azimuth" in answers(run)["show"][2]


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ("table outer 201", "outside its limits of -200 to 200 deg"),
        ("table outer 10 at 31", "exceeds the limit of 30 deg/s"),
        ("table outer 10 at 0", "must be above 0 deg/s"),
        ("table rate inner 31", "exceeds the limit of 30 deg/s"),
        ("table to z_upp", "did you mean 'z_up'"),
        ("table to x_up 45", "can't reach"),
        ("table sideways 3", "'sideways' is not an axis"),
        ("table outer much", "'much' is not an angle in deg"),
        ("table outer nan", "'nan' is not an angle in deg"),
        ("table outer 3 4", "expected 'at RATE'"),
        ("table", "is not an axis"),
        ("chamber 80", "outside the chamber's limits of -50 to 75 degC"),
        ("chamber 40 at 11", "at most 10 degC/min"),
        ("chamber", "an argument is missing"),
        ("servo maybe", "neither on nor off"),
        ("ins land", "no command 'land'"),
        ("watch -3", "above 0 s"),
        ("stop now", "unexpected argument 'now'"),
        ("tabel outer 3", "did you mean 'table'"),
    ],
)
def test_an_impossible_command_is_refused_before_anything_moves(command, why, tmp_path):
    run = jog(command, "show", cwd=tmp_path)
    assert run.returncode == 1
    assert why in run.stdout
    assert "servos on" not in run.stdout
    assert "jog> show" not in run.stdout  # later commands may depend on it


def test_an_endless_turn_is_stopped_before_the_limit(tmp_path):
    run = jog("table rate outer 20", "watch 30", "show", cwd=tmp_path)
    assert "outer axis is close to its limit" in run.stdout
    outer = answers(run)["show"][0].split()
    assert 100.0 < float(outer[2]) < 200.0
    assert float(outer[4]) == pytest.approx(0.0, abs=0.01)


def test_a_turn_too_close_to_the_limit_is_refused(tmp_path):
    run = jog("table outer 195 at 30", "table rate outer 20", cwd=tmp_path)
    assert run.returncode == 1
    assert "too close to its limit" in run.stdout


def test_stop_ends_a_turn(tmp_path):
    run = jog("table rate inner 5", "watch 4", "stop", "show", cwd=tmp_path)
    assert run.returncode == 0
    inner = answers(run)["show"][1].split()
    assert 10.0 < float(inner[2]) < 40.0
    assert abs(float(inner[4])) < 0.01


def test_the_chamber_goes_to_its_set_point(tmp_path):
    run = jog("chamber 33 at 5", "watch 300", "show", cwd=tmp_path)
    shown = answers(run)["show"][3]
    assert "set point 33.0 degC, on" in shown
    assert float(shown.split()[2]) == pytest.approx(33.0, abs=1.0)


def test_the_ins_is_switched_on_and_commanded(tmp_path):
    run = jog("unit on", "ins align", "watch 60", "ins navigate", "show", "events", "unit off", cwd=tmp_path)
    assert run.returncode == 0, run.stdout
    printed = answers(run)
    names, units, *lines = printed["watch 60"]
    assert names.split() == ["time", "outer", "inner", "air", "gyros", "v", "East", "v", "North", "INS"]
    assert units.split() == ["s", "deg", "deg", "degC", "degC", "m/s", "m/s"]
    assert all(len(line) >= len(units) and len(line.split()) == len(units.split()) + 1 for line in lines)
    assert printed["unit on"][-1].startswith("INS on: standby")
    assert printed["ins align"] == ["INS: align, not aligned"]
    assert printed["ins navigate"][0].startswith("INS: navigate")
    assert any(line.startswith("INS        navigate, finely aligned") for line in printed["show"])
    assert "event 2  on  (the INS)" in printed["events"]
    assert printed["unit off"][0] == "INS off"


def test_no_line_is_wider_than_80_columns(tmp_path):
    run = jog(
        "show", "limits", "unit on", "ins align", "watch 5", "show", "events", "faults", "help", cwd=tmp_path
    )
    assert max(map(len, run.stdout.splitlines())) <= 80


def test_the_bench_is_left_in_its_safe_state(tmp_path):
    run = jog("table outer 30", "chamber 40", cwd=tmp_path)
    assert run.stdout.splitlines()[-4:] == [
        "rate table stopped",
        "chamber's set point at 23 degC",
        "INS left as it is",
        "rate table's servos off",
    ]


@pytest.mark.parametrize("arguments", [("--leave",), ("leave", "show")])
def test_leave_keeps_the_state_of_chamber_and_servos(arguments, tmp_path):
    run = jog("chamber 40", *arguments, cwd=tmp_path)
    assert run.returncode == 0
    assert run.stdout.splitlines()[-1] == "Chamber, INS power and servos are left as they are."
    assert "chamber's set point at 23 degC" not in run.stdout


def test_a_tripped_interlock_brings_the_safe_state_and_names_its_reason(tmp_path):
    (tmp_path / "panel.yaml").write_text(
        "faults:\n  - {fault: set_point_changed_at_panel, at_s: 40, to_c: 60}\n"
    )
    run = jog("table outer 20", "chamber 30", "watch 300", "show", "--faults", "panel.yaml", cwd=tmp_path)
    assert run.returncode == 1
    printed = answers(run)["watch 300"]
    assert "chamber's set point at 23 degC" in printed
    assert any(
        line.startswith("Interlock chamber_command: the chamber's set point is 60") for line in printed
    )
    assert "jog> show" not in run.stdout


def test_a_stalled_axis_is_stopped_and_reported(tmp_path):
    (tmp_path / "stall.yaml").write_text("faults:\n  - {fault: table_stalls, during: turn, axis: outer}\n")
    run = jog("table outer 90", "--faults", "stall.yaml", cwd=tmp_path)
    assert run.returncode == 1
    assert "rate table" in run.stdout


def piped(text, cwd, *arguments):
    return subprocess.run(
        [*PROCESS, "jog", "quick", "--world", "quick", *arguments],
        input=text, capture_output=True, text=True, cwd=cwd, timeout=200,
    )  # fmt: skip


def test_commands_come_from_a_pipe_with_comments(tmp_path):
    run = piped("# to the side\ntable outer 30  # deg\n\nshow\nquit\nnever reached\n", tmp_path)
    assert run.returncode == 0, run.stdout
    assert "jog> table outer 30" in run.stdout
    assert "never" not in run.stdout
    assert run.stdout.rstrip().endswith("rate table's servos off")


@pytest.mark.parametrize("way", ["standard input", "arguments"])
def test_a_command_that_fails_ends_the_session_and_states_how_many_were_not_executed(way, tmp_path):
    lines = ["show", "table outer 999", "", "# to the side", "table outer 20", "show  # it", "quit", "show"]
    typed = tmp_path / "typed"
    typed.write_text("\n".join(lines))
    run = jog(cwd=tmp_path, typed=typed) if way == "standard input" else jog(*lines, cwd=tmp_path)
    assert run.returncode == EXIT_NOT_FINISHED
    printed = answers(run)["table outer 999"]
    assert printed[1] == "Not executed: 2 commands after this one."
    assert printed[-1] == "rate table's servos off"


def test_after_the_last_command_none_is_stated_as_not_executed(tmp_path):
    assert "Not executed" not in jog("table outer 999", cwd=tmp_path).stdout


@pytest.mark.wall_time
def test_a_fast_emulated_bench_is_watched_at_its_speed(tmp_path):
    text = find_document("stations", "quick").read_text()
    (tmp_path / "fast.yaml").write_text(text.replace("clock: virtual", "clock: wall\nspeed: 10"))
    began_s = time.monotonic()
    run = jog("watch 60", cwd=tmp_path, station="fast.yaml")
    assert run.returncode == 0, run.stdout
    assert time.monotonic() - began_s < 60.0


@pytest.mark.wall_time
def test_a_chamber_that_does_not_answer_is_left_out_and_shows_no_temperature(tmp_path):
    text = find_document("stations", "quick").read_text()
    text = text.replace("emulator://chamber", "/dev/no_chamber")
    (tmp_path / "bare.yaml").write_text(text.replace("clock: virtual", "clock: wall"))
    run = jog("show", "watch 2", cwd=tmp_path, station="bare.yaml")
    assert run.returncode == 0, run.stdout
    assert "Left out: chamber: can't open /dev/no_chamber" in run.stdout
    assert "Chamber    left out" in run.stdout
    assert "nan" not in run.stdout


@pytest.mark.parametrize(
    ("instrument", "shown", "refused"),
    [("table", "Table      left out", "table outer 3"), ("chamber", "Chamber    left out", "chamber 30")],
)
def test_a_silent_instrument_whose_port_opens_is_left_out_and_the_others_are_controlled(
    instrument, shown, refused, tmp_path
):
    (tmp_path / "silent.yaml").write_text(
        f"faults:\n  - {{fault: lost_request, target: {instrument}, at_s: 0, for_s: 9000}}\n"
    )
    run = jog(
        "unit on" if instrument == "table" else "table outer 3",
        "show",
        refused,
        "--faults",
        "silent.yaml",
        cwd=tmp_path,
    )
    printed = answers(run)
    assert "Is it switched on" in printed[""][0]
    assert max(map(len, run.stdout.splitlines())) < 400
    assert shown in printed["show"]
    assert "did not answer when the bench was opened. Start jog again" in printed[refused][0]
    assert run.returncode == EXIT_NOT_FINISHED


def test_an_instrument_whose_first_reply_is_lost_is_not_left_out(tmp_path):
    (tmp_path / "lost.yaml").write_text(
        "faults:\n  - {fault: lost_reply, target: table, at_s: 0, replies: 2}\n"
        "  - {fault: lost_reply, target: chamber, at_s: 0}\n"
    )
    run = jog("table outer 3", "chamber 30", "--faults", "lost.yaml", cwd=tmp_path)
    assert run.returncode == 0, run.stdout
    assert "Left out" not in run.stdout


def test_a_bench_on_which_no_instrument_answers_names_all_of_them(tmp_path, monkeypatch):
    text = find_document("stations", "quick").read_text().replace("clock: virtual", "clock: wall")
    for emulated, absent in (
        ("emulator://table", "/dev/no_table"),
        ("emulator://chamber", "/dev/no_chamber"),
        ("interface: emulator", "interface: no_adapter"),
    ):
        assert emulated in text
        text = text.replace(emulated, absent)
    (tmp_path / "bare.yaml").write_text(text)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    run = gyrobench("jog", "bare.yaml", "show", cwd=tmp_path)
    assert run.returncode == EXIT_INSTRUMENT
    for cause in ("rate table: can't open /dev/no_table", "chamber: can't open /dev/no_chamber", "INS: "):
        assert f"\n  {cause}" in run.stderr
    assert not list((tmp_path / "temporary").iterdir())
