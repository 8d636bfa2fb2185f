"""`gyrobench monitor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import complete_run

_HELP = "Run folder, or folder of runs."


def monitor(
    run: Annotated[Path, typer.Argument(metavar="RUN", help=_HELP, autocompletion=complete_run)],
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on the loopback; 0 for any free port.")
    ] = 8765,
    for_s: Annotated[float | None, typer.Option(min=0.0, help="End after this many seconds.")] = None,
    open_browser: Annotated[
        bool, typer.Option("--open", help="Open the page in a browser on this machine.")
    ] = False,
) -> None:
    """Show a run, or a folder of runs, in a browser: live during a run, as a record after it.

    The page is read only, self-contained, and served on this machine only (127.0.0.1). For access from
    another machine through ssh, the command prints how. Ctrl-C ends the monitor, not the run.

    Example: gyrobench monitor runs/six_position_fig7-001 --open
    """
    import contextlib
    import getpass
    import socket
    import threading
    import webbrowser

    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.foundations.errors import MissingRunError
    from gyrobench.bench.monitor.server import MonitorServer
    from gyrobench.bench.monitor.website import Website

    if not run.is_dir():
        raise MissingRunError(f"{run}: no such folder. Give a run folder, or a folder of runs")
    with MonitorServer(Website(run, WallClock().utc).answer, port) as server:
        local = server.server_port
        typer.echo(f"{run.absolute()} is shown at {server.url} until Ctrl-C.")
        typer.echo("From another machine, run this there and open the same address:")
        typer.echo(f"  ssh -N -L {local}:127.0.0.1:{local} {getpass.getuser()}@{socket.gethostname()}")
        if open_browser:
            webbrowser.open(server.url)
        if for_s is not None:
            ending = threading.Timer(for_s, server.shutdown)
            ending.daemon = True
            ending.start()
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
