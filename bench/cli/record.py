"""`gyrobench record`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from gyrobench.bench.cli.options import FaultsOption, SeedOption, StationArgument, WorldOption
from gyrobench.bench.foundations.errors import DocumentError


def record(
    context: typer.Context,
    station: StationArgument,
    out: Annotated[
        Path, typer.Option(help="Recording to write: *.rec, *.log for the INS; with a COMMAND a folder.")
    ],
    command: Annotated[
        list[str] | None, typer.Argument(help="After --, a gyrobench command to be recorded.")
    ] = None,
    instrument: Annotated[
        Literal["table", "chamber", "ins"] | None, typer.Option(help="Instrument to record.")
    ] = None,
    proxy: Annotated[
        bool, typer.Option(help="Serve the instrument to any program, and record the traffic.")
    ] = False,
    port: Annotated[
        str, typer.Option(help="Port of the proxy: a TCP port, or a link to its pseudo-terminal.")
    ] = "",
    for_s: Annotated[
        float | None,
        typer.Option(min=0.1, help="Duration of proxy or CAN log; default: until Ctrl-C, and 10 s."),
    ] = None,
    note: Annotated[str, typer.Option(help="Comment kept in the recording.")] = "",
    world: WorldOption = None,
    seed: SeedOption = 0,
    faults: FaultsOption = None,
) -> None:
    """Record the bytes exchanged with an instrument, for tests of its driver.

    Without --proxy or a COMMAND it sends the table or the chamber all queries that move nothing, or
    listens to the INS; a unit that is off is switched on for the recording.

    Exit codes: 0 recorded, or that of the COMMAND; 3 the instrument can't be reached, or a run uses
    the bench.

    Example: gyrobench record my_bench.yaml --instrument chamber --out chamber.rec
    """
    from gyrobench.bench.recording.recorder import Recorder
    from gyrobench.bench.station.instruments import Emulation

    recorder = Recorder(station, Emulation.of(station, world, seed, faults), note, typer.echo)
    if command:
        if instrument or proxy:
            raise DocumentError("record: a COMMAND records table and chamber; omit --instrument and --proxy")
        with recorder.lines(out):
            raise typer.Exit(_run(context, command, station))
    if instrument is None:
        raise DocumentError("record: give --instrument table, chamber or ins, or a COMMAND")
    if proxy:
        recorder.proxy(instrument, out, port, for_s)
    else:
        recorder.record(instrument, out, for_s)


def _run(context: typer.Context, words: list[str], station: str) -> int:
    """Run another command in this process, on this station; returns its exit code."""
    words = words[1:] if words[0] == "gyrobench" else words
    root = context.find_root()
    command = root.command.get_command(root, words[0])  # type: ignore[attr-defined]
    parameters = {parameter.name: parameter for parameter in command.params} if command else {}
    if "station" in parameters and station not in words:
        is_option = parameters["station"].param_type_name == "option"
        words = [*words, *(["--station", station] if is_option else [station])]
    code = root.command.main(args=words, prog_name="gyrobench", standalone_mode=False)
    return code if isinstance(code, int) else 0
