"""`gyrobench seal`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrobench.bench.cli.options import OperatorOption, OptionalRunArgument
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json
from gyrobench.bench.foundations.errors import DocumentError

if TYPE_CHECKING:
    from gyrobench.bench.runs.seal import Seal


def seal(
    run_folder: OptionalRunArgument = None,
    verify: Annotated[bool, typer.Option(help="Compare the folder with its seals; writes nothing.")] = False,
    key: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Key that signs, or with --verify the public key that must have signed (PEM); default: "
            "GYROBENCH_SEAL_KEY, for --verify any.",
        ),
    ] = None,
    accept_changes: Annotated[
        bool, typer.Option(help="Seal although measured data, inputs or tables were changed.")
    ] = False,
    new_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Make a key FILE, and FILE.pub beside it.")
    ] = None,
    operator: OperatorOption = "",  # noqa: ARG001 - read from the environment
    as_json: JsonOption = False,
) -> None:
    """Seal a run folder, or verify its seals.

    A run is sealed at its end, and again by each command that adds to its folder. A seal has the hashes of
    all files, the operator, the time and the command. --verify reports the first changed byte of each file:
    exactly if one byte of a block of 4 KiB changed, otherwise the block or line. The units of a run with
    several units are sealed and verified with it.

    With --json: {"folder", "seal"}, where seal is null if nothing has changed; with --verify {"folder",
    "intact", "seals", "changes": [{"path", "text", "start", "end"}], "not_sealed"}; with --new-key
    {"secret_key", "public_key"}.

    Exit codes: 0 sealed or unchanged; 1 changed.

    Example: gyrobench seal --verify runs/six_position_fig7-001
    """
    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.runs import seal as seals
    from gyrobench.bench.runs.folder import open_run_folder
    from gyrobench.bench.runs.locks import RunLock
    from gyrobench.bench.runs.seal_keys import new_key as make_key

    terminal = console(as_json)
    if new_key is not None:
        public_key = make_key(new_key)
        if as_json:
            print_json({"secret_key": new_key, "public_key": public_key})
        terminal.print(f"Secret key  {new_key}\nPublic key  {public_key}", soft_wrap=True)
        return
    if run_folder is None:
        raise DocumentError("no run folder is given. Name one, or make a key with --new-key FILE")
    if not verify:
        folder = open_run_folder(run_folder, may_have_units=True)
        with RunLock(folder.path, WallClock()):
            new_seal = seals.seal_run(folder, key, accept_changes=accept_changes)
        if as_json:
            print_json({"folder": run_folder, "seal": new_seal and _record(new_seal)})
        text = "Nothing has changed since the last seal." if new_seal is None else new_seal.describe()
        terminal.print(text, soft_wrap=True)
        return
    check = seals.verify_seals(run_folder, key)
    if as_json:
        print_json(
            {
                "folder": run_folder,
                "intact": check.is_intact,
                "seals": [_record(each) for each in check.seals],
                "changes": check.findings,
                "not_sealed": check.not_sealed,
            }
        )
    for each in check.seals:
        terminal.print(each.describe(), soft_wrap=True)
        if each.journal_broken_links:
            lines = ", ".join(map(str, each.journal_broken_links))
            terminal.print(f"   The journal was sealed with lines that do not fit: {lines}", soft_wrap=True)
    for path in check.not_sealed:
        terminal.print(f"Not sealed: {path}", soft_wrap=True)
    for finding in check.findings:
        kind = "Invalid" if Path(finding.path).parent.name == "seals" else "Changed"
        terminal.print(f"{kind}: {finding.path}: {finding.text}", soft_wrap=True, style="bold red")
    if not check.is_intact:
        raise typer.Exit(EXIT_NOT_FINISHED)
    size_mb = sum(each.size_bytes for each in check.files.values()) / 1e6
    terminal.print(f"Unchanged: {len(check.files)} files, {size_mb:.1f} MB.")


def _record(seal: Seal) -> dict[str, Any]:
    return {name: getattr(seal, name) for name in _SEAL_FIELDS}


#: Attributes of a seal in the JSON output.
_SEAL_FIELDS = (
    "number",
    "operator",
    "login",
    "host",
    "utc",
    "command",
    "program",
    "changes",
    "key",
    "unsigned",
)
