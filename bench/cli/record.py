"""`gyrobench record`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import FaultsOption, SeedOption, StationArgument, WorldOption
from gyrobench.bench.foundations.errors import DocumentError


class Instrument(StrEnum):
    """What is recorded."""

    table = "table"
    chamber = "chamber"
    ins = "ins"


def record(
    context: typer.Context,
    station: StationArgument,
    out: Annotated[
        Path, typer.Option(help="Recording to write: *.rec, *.log for the INS; a folder with a COMMAND.")
    ],
    command: Annotated[
        list[str] | None, typer.Argument(help="After --, a command of gyrobench, whose lines are recorded.")
    ] = None,
    instrument: Annotated[Instrument | None, typer.Option(help="What is recorded.")] = None,
    proxy: Annotated[
        bool, typer.Option("--proxy", help="Serve the instrument to any program, and record that.")
    ] = False,
    port: Annotated[
        str, typer.Option(help="Of the proxy: a TCP port, or a link to its pseudo-terminal.")
    ] = "",
    for_s: Annotated[
        float | None, typer.Option(min=0.1, help="How long proxy or CAN log last; else Ctrl-C, and 10 s.")
    ] = None,
    note: Annotated[str, typer.Option(help="What is worth knowing, for instance a quirk.")] = "",
    world: WorldOption = "gyro_a",
    seed: SeedOption = 0,
    faults: FaultsOption = None,
) -> None:
    """Keep the bytes exchanged with an instrument, so that its driver can be tested with them.

    Without --proxy or a COMMAND it asks the table or the chamber what can be asked without moving
    anything, or listens to the INS; a unit that is off is on meanwhile.

    Exit codes: 0 recorded, or that of the COMMAND; 3 the instrument can't be reached, or a run holds
    the bench.

    Example: gyrobench record my_bench.yaml --instrument chamber --out chamber.rec
    """
    from gyrobench.bench.recording.recorder import Recorder
    from gyrobench.bench.station.instruments import Emulation

    recorder = Recorder(station, Emulation(world, seed, faults or ""), note, typer.echo)
    if command:
        if instrument or proxy:
            raise DocumentError(
                "record: with a COMMAND its table and chamber are recorded; leave the options out"
            )
        with recorder.lines(out):
            raise typer.Exit(_run(context, command, station))
    if instrument is None:
        raise DocumentError("record: say which instrument (--instrument table, chamber or ins), or a COMMAND")
    if proxy:
        recorder.proxy(instrument.value, out, port, for_s)
    else:
        recorder.record(instrument.value, out, for_s)


def _run(context: typer.Context, words: list[str], station: str) -> int:
    """Run another command in this process, on this station; returns its exit code."""
    words = words[1:] if words[0] == "gyrobench" else words
    root = context.find_root()
    known = root.command.get_command(root, words[0])  # type: ignore[attr-defined]
    takes = {parameter.name: parameter for parameter in known.params} if known else {}
    if "station" in takes and station not in words:
        is_option = takes["station"].param_type_name == "option"
        words = [*words, *(["--station", station] if is_option else [station])]
    code = root.command.main(args=words, prog_name="gyrobench", standalone_mode=False)
    return code if isinstance(code, int) else 0
