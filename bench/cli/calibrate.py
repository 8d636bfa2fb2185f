"""`gyrobench calibrate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from gyrobench.bench.cli.options import complete_import_map
from gyrobench.bench.cli.output import JsonOption, plain, print_result
from gyrobench.bench.foundations.errors import DocumentError


def calibrate(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG", help="Log of rates or increments; several in order of time."),
    ],
    mapping: Annotated[
        str,
        typer.Option(
            "--map",
            help="Import map with a section 'calibration': file or shipped name.",
            autocompletion=complete_import_map,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; default: none are written.")
    ] = None,
    lever_arms: Annotated[
        bool, typer.Option(help="Also estimate the positions of the accelerometers in the unit.")
    ] = False,
    delay: Annotated[bool, typer.Option(help="Also estimate the delay of the accelerometers.")] = False,
    quadratic: Annotated[
        bool,
        typer.Option(
            help="List the quadratic terms of the accelerometers too, of any size; default: terms of 20 "
            "ug/g2 are allowed for."
        ),
    ] = False,
    g_sensitivity: Annotated[
        bool, typer.Option(help="Also estimate the g-sensitivity of the gyro biases.")
    ] = False,
    asymmetry: Annotated[
        bool,
        typer.Option(
            help="Also estimate the asymmetry of each gyro's scale factor; default: if the log has whole "
            "turns in both directions."
        ),
    ] = False,
    drift: Annotated[
        bool, typer.Option(help="Also estimate a steady drift of each gyro's bias in each log.")
    ] = False,
    body_frame: Annotated[
        Literal["accelerometers", "gyros"], typer.Option(help="Sensors to which the body frame is fixed.")
    ] = "accelerometers",
    as_json: JsonOption = False,
) -> None:
    """Estimate all sensor coefficients from rates or increments of a unit that is rotated between rests.

    Biases, scale factors and misalignments of gyros and accelerometers, with uncertainties. Rests and
    rotations are detected in the logs; undetermined coefficients are reported. A gap in the samples splits a
    log.

    With --out: coefficients.csv, correlations.csv, calibration.json, which is also what --json prints:
    {"logs", "map", "body_frame", "coefficients", "noise", "gravity_mps2", "gravity_sigma_mps2",
    "earth_rate_up_dph", "rests", "rotations", "spins", "fit", "warnings"}; spins need 'whole_turns_arcsec' in
    the map.

    Example: gyrobench calibrate rotations.csv --map my_imu.yaml --out calibration
    """
    from gyrobench.bench.calibration.estimator import calibrate as estimate
    from gyrobench.bench.calibration.information import BIAS_DRIFT
    from gyrobench.bench.calibration.results import calibration_record, write_calibration
    from gyrobench.bench.calibration.spins import spin_scale_factors
    from gyrobench.bench.exchange.import_map import load_log_map
    from gyrobench.bench.exchange.increments import calibration_settings, read_logs
    from gyrobench.bench.foundations.files import file_sha256
    from gyrobench.bench.foundations.shipped import find_document
    from gyrobench.bench.report.terminal.calibration import calibration_summary

    map_path = find_document("imports", mapping)
    log_map = load_log_map(map_path, for_calibration=True)
    for path in logs:
        if path.is_dir():
            log_folder = path / "can" if (path / "can").is_dir() else path
            raise DocumentError(f"{path}: is a folder. Give its log files, as {log_folder}/*.blf")
        if not path.exists():
            raise DocumentError(f"{path}: there is no such file")
    digests = {path: file_sha256(path) for path in logs}
    if len(set(digests.values())) < len(logs):
        raise DocumentError("two logs have the same content, which would count twice. Name each log once")
    read_results = read_logs(logs, log_map)
    interval_error = max(each.interval_error for each in read_results)
    site, options = calibration_settings(log_map, interval_error)
    options = replace(
        options,
        lever_arms=lever_arms,
        delay=delay,
        quadratic=quadratic or None,
        g_sensitivity=g_sensitivity,
        asymmetries=(0, 1, 2) if asymmetry else None,
        bias_drift=BIAS_DRIFT if drift else 0.0,
    )
    calibration = estimate(
        [recording for each in read_results for recording in each.recordings], site, options
    )
    counts = sum(each.left_out for each in read_results), sum(each.samples for each in read_results)
    origin = {
        "logs": [
            {"file": str(path), "sha256": digests[path], "samples": log.samples, "left_out": log.left_out}
            for path, log in zip(logs, read_results, strict=True)
        ],
        "map": {"file": str(map_path), "sha256": file_sha256(map_path)},
    }
    turns = options.whole_turns
    spins = [] if turns is None else spin_scale_factors(calibration, turns)
    if body_frame == "gyros":
        calibration = calibration.in_gyro_frame()
    warnings = [caution] if (caution := log_map.calibrated.gravity_caution) else []
    record = plain(calibration_record(calibration, spins, origin) | {"warnings": warnings})
    paths = write_calibration(out, calibration, record) if out else []
    summary = calibration_summary(calibration, spins, turns is not None, counts)
    empty_logs = [
        f"Left out {path}: no sample" for path, log in zip(logs, read_results, strict=True) if not log.samples
    ]
    notes = [*(f"Warning: {text}" for text in warnings), *empty_logs, *(f"Written  {path}" for path in paths)]
    print_result(record, as_json, summary, *notes)
