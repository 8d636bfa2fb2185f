"""`gyrobench certificate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.options import OperatorOption, OptionalRunArgument, complete_list
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json, print_unfinished
from gyrobench.bench.foundations.errors import DocumentError

if TYPE_CHECKING:
    from gyrobench.bench.runs.folder import RunFolder


def certificate(
    run_folder: OptionalRunArgument = None,
    formats: Annotated[
        str,
        typer.Option(
            "--format", help="dcc, pdf, or both with a comma.", autocompletion=complete_list(("dcc", "pdf"))
        ),
    ] = "dcc,pdf",
    out: Annotated[Path | None, typer.Option(help="Output folder; default: certificate in the run.")] = None,
    number: Annotated[str, typer.Option(help="Number; default: from unit, run and seal.")] = "",
    replaces: Annotated[
        str, typer.Option(metavar="NUMBER", help="Number of the certificate that it replaces.")
    ] = "",
    authorised_by: Annotated[
        str, typer.Option("--authorised-by", metavar="NAME", help="Who authorises it; required.")
    ] = "",
    customer: Annotated[str, typer.Option(help="Customer and address; default: as in the run.")] = "",
    order: Annotated[str, typer.Option(help="Number of the order; default: as in the run.")] = "",
    item: Annotated[str, typer.Option(help="Item of the order; default: as in the run.")] = "",
    ambient: Annotated[str, typer.Option(help="Conditions of the room, as '23 °C, 45 % RH'.")] = "",
    limit_dph: Annotated[
        float | None,
        typer.Option(
            min=1e-9,
            help="Limit of the biases, agreed with the customer: the certificate states the date until which "
            "they stay within it, by the runs of the unit and of others beside this run (see runs --trend).",
        ),
    ] = None,
    simulated: Annotated[
        bool, typer.Option(help="Allow a run with emulated instruments; every page is marked SIMULATED.")
    ] = False,
    key: Annotated[
        str,
        typer.Option(
            metavar="FILE|URI",
            help="Sign with this key: PKCS#12, PEM with key and certificate, or on a token, as "
            "'pkcs11:token=NAME;object=KEY?module-path=FILE'.",
        ),
    ] = "",
    schema: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            envvar="GYROBENCH_DCC_SCHEMA",
            help="Folder with dcc.xsd and SI_Format.xsd, to validate the DCC.",
        ),
    ] = None,
    verify: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Verify the signature of a certificate.")
    ] = None,
    trusted: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="With --verify: certificates (PEM), of the signer or of its issuer."
        ),
    ] = None,
    operator: OperatorOption = "",  # noqa: ARG001 - read from the environment
    as_json: JsonOption = False,
) -> None:
    """Issue the calibration certificate of a sealed run as PDF/A-3 and as DCC, or verify one.

    The DCC is attached to the PDF. The key's password, or the token's PIN, is taken from
    GYROBENCH_KEY_PASSWORD.

    With --json: {"number", "files", "validated", "signed"}, or with --verify {"file", "valid", "signer",
    "fingerprint", "problem"}.

    Exit codes: 0 written, or unchanged since it was signed; 1 changed, or not signed by a trusted
    certificate.

    Example: gyrobench certificate runs/six_position_fig7-001 --authorised-by "A. Smith" --key lab.p12
    """
    if verify is not None:
        _verify(verify, trusted, as_json)
        return
    if run_folder is None:
        raise DocumentError("no run folder is given. Name one, or a file with --verify")
    from gyrobench.bench.certificate.content import Order, certificate_of
    from gyrobench.bench.certificate.issue import FORMATS, issue_certificate
    from gyrobench.bench.certificate.signatures import load_signing_key
    from gyrobench.bench.runs.folder import open_run_folder
    from gyrobench.bench.runs.seal import update_seal

    selected = {each.strip() for each in formats.split(",")}
    if not selected <= set(FORMATS):
        raise DocumentError(f"--format {formats}: is not dcc, pdf or dcc,pdf")
    folder = open_run_folder(run_folder)
    recalibration = _recalibration(folder, limit_dph) if limit_dph else ""
    order_data = Order(customer, order, item, number, replaces, authorised_by, ambient, recalibration)
    content = certificate_of(folder, order_data, simulated=simulated)
    signing_key = load_signing_key(key) if key else None
    paths = issue_certificate(content, selected, out or folder.path / "certificate", signing_key, schema)
    update_seal(folder)
    print_unfinished([folder.path], on_stderr=as_json)
    if as_json:
        print_json(
            {
                "number": content.number,
                "files": paths,
                "validated": "dcc" in selected and schema is not None,
                "signed": signing_key is not None,
            }
        )
        return
    terminal = console()
    for path in paths:
        terminal.print(f"Written  {path}", soft_wrap=True)
    if signing_key is None:
        terminal.print("Not signed: --key FILE names the laboratory's key.", soft_wrap=True)
    if "dcc" in selected and schema is None:
        terminal.print(
            "The DCC is not validated: --schema FOLDER names PTB's dcc.xsd and SI_Format.xsd.", soft_wrap=True
        )


def _recalibration(folder: RunFolder, limit_dph: float) -> str:
    """Sentence on how long the unit's biases stay within a limit; raises DocumentError if unknown."""
    from gyrobench.bench.cli.run_selection import open_index
    from gyrobench.bench.report.run_content import read_run
    from gyrobench.bench.report.run_report import serial_number_of
    from gyrobench.bench.report.terminal.runs import recalibration_sentence
    from gyrobench.bench.runs.index.recalibration import recalibrations
    from gyrobench.bench.runs.index.run_biases import read_run_biases, trends
    from gyrobench.bench.runs.index.run_index import find_runs
    from gyrobench.bench.runs.index.selection import Selection

    index = open_index(str(folder.path.resolve().parent))
    selection = Selection(unit=serial_number_of(read_run(folder)))
    fitted = trends(read_run_biases(index, [run["path"] for run in find_runs(index, selection)]))
    due = recalibrations(index, selection, fitted, limit_dph)
    if not any(due):
        raise DocumentError(
            f"{folder.path.parent}: holds too few runs of unit {selection.unit} to state until when its "
            "biases stay within a limit. Leave --limit-dph out"
        )
    return recalibration_sentence(str(selection.unit), due)


def _verify(path: Path, trusted: Path | None, as_json: bool) -> None:
    from gyrobench.bench.certificate.signatures import verify_file

    check = verify_file(path, trusted)
    is_valid = not check.problem
    if as_json:
        print_json({"file": path, "valid": is_valid, **vars(check)})
    elif is_valid:
        trust_note = "" if trusted else ", which was not compared with a trusted one"
        console().print(
            f"Unchanged since it was signed by {check.signer}, certificate SHA-256 "
            f"{check.fingerprint[:16]}…{trust_note}.",
            soft_wrap=True,
        )
    else:
        console().print(f"{path}: {check.problem}", soft_wrap=True, style="bold red")
    if not is_valid:
        raise typer.Exit(EXIT_NOT_FINISHED)
