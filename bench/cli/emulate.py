"""`gyrobench emulate`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from gyrobench.bench.cli.options import EMULATED, FaultsOption, SeedOption, StationOption, WorldOption
from gyrobench.bench.foundations.shipped import world_for

_PORT_HELP = "TCP port of the {}, or the path of a link to its pseudo-terminal."


def emulate(
    station: StationOption = EMULATED,
    world: WorldOption = None,
    seed: SeedOption = 0,
    faults: FaultsOption = None,
    faults_log: Annotated[
        Path | None, typer.Option(help="File for a JSON line for each injected fault.")
    ] = None,
    tcp: Annotated[
        bool, typer.Option(help="Use TCP ports of the loopback instead of pseudo-terminals.")
    ] = False,
    table_port: Annotated[str, typer.Option(help=_PORT_HELP.format("rate table"))] = "",
    chamber_port: Annotated[str, typer.Option(help=_PORT_HELP.format("chamber"))] = "",
    ins_port: Annotated[str, typer.Option(help=_PORT_HELP.format("INS"))] = "",
    chamber_option: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE",
            help="Option of the emulated chamber: model=F4S, decimals=2, address=2 (F4), echo=before, "
            "line_ending=crlf (Thermotron). Repeatable.",
        ),
    ] = None,
    can: Annotated[
        Literal["slcan", "socketcand"] | None,
        typer.Option(help="CAN interface of the INS; default: that of the station."),
    ] = None,
    speed: Annotated[float, typer.Option(min=1.0, max=100.0, help="Speed relative to real time.")] = 1.0,
    for_s: Annotated[
        float | None, typer.Option(min=0.0, help="End after this many seconds of real time.")
    ] = None,
    write_station: Annotated[
        Path | None, typer.Option(help="Station file to write, for use of the emulated bench.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One line of JSON for programs.")] = False,
) -> None:
    """Serve the emulated table, chamber and INS to any program on this computer, until Ctrl-C.

    Exit codes: 0 ended by Ctrl-C or --for-s, 2 an option or file is wrong, or a port is in use.

    Example: gyrobench emulate --speed 10 --write-station mine.yaml
    """
    from gyrobench.bench.foundations.shipped import find_document
    from gyrobench.bench.recording.emulated_station import (
        EmulationSettings,
        EmulatorProcess,
        end_at_sigterm,
        guide,
        serve_options,
        write_station_file,
    )
    from gyrobench.bench.station.station import Station

    bench = Station(find_document("stations", station))
    ports = {"table": table_port, "chamber": chamber_port, "ins": ins_port}
    settings = EmulationSettings(world_for(station, world), seed, speed, faults or None, faults_log, for_s)
    options = serve_options(bench, ports, tcp=tcp, can=can, settings=settings)
    options += [f"--chamber-option={each}" for each in chamber_option or []]
    end_at_sigterm()
    with EmulatorProcess(options) as emulators:
        if emulators.urls:
            if write_station:
                write_station_file(write_station, bench, emulators.urls, speed)
            summary = (
                json.dumps(emulators.urls) if as_json else guide(emulators.urls, bench, speed, write_station)
            )
            typer.echo(summary)
        code = emulators.wait()
    sys.exit(code)
