"""Files of a search: ``closure.json``, ``predictions.csv`` and ``model.yaml``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from gyrobench.bench.closure.compose import Composed, law_text
from gyrobench.bench.closure.outcome import Closure, FoundEffect, OtherForm
from gyrobench.bench.closure.problem import DEGREE, SCALE_C, predict
from gyrobench.bench.closure.quantity import Quantity, quantity
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import format_csv, write_text
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, parse_json, read_limited
from gyrobench.bench.runs.provenance import watermark_of

_T = TypeVar("_T")
#: Name of the file with the outcome of a search.
_CLOSURE_FILE = "closure.json"
#: Effect file of the most probable composed law.
_COMPOSED_LAW = "composed_law.yaml"
#: Number of the most probable hypotheses in the document.
_HYPOTHESES = 10
_MAX_BYTES = 100_000_000


def prediction_columns(quantity: Quantity) -> list[str]:
    """Columns of ``predictions.csv``: ``bias_x_before_dph``, ``gyro_scale_factor_x_before_ppm``, ..."""
    values = [f"bias_{axis}" for axis in quantity.axes] if quantity.is_gyro_bias else [*quantity.coefficients]
    sigmas = [f"sigma_{axis}" for axis in quantity.axes]
    names = (f"{name}_{when}" for each in (values, sigmas) for when in ("before", "after") for name in each)
    return ["dwell", *(f"{name}_{quantity.suffix}" for name in names)]


def write_closure(folder: Path, closure: Closure) -> None:
    """Write all files into a folder, which is created if missing.

    Raises RunFolderError if a file can't be written.
    """
    make_folder(folder)
    write_text(folder / _CLOSURE_FILE, json.dumps(closure_document(closure), indent=2) + "\n")
    write_text(folder / "predictions.csv", format_predictions(closure))
    write_text(folder / "model.yaml", yaml.safe_dump(model_document(closure), sort_keys=False))
    for law in closure.composed.laws[:1] if closure.composed else ():
        write_text(folder / _COMPOSED_LAW, law_text(law))


def holds_search(folder: Path) -> bool:
    """Whether a folder holds the files of a search."""
    return (folder / _CLOSURE_FILE).exists()


def is_written(folder: Path, closure: Closure) -> bool:
    """Whether a folder holds this search already.

    The paths of the tables may differ, and whether cycles were held out in turn and laws composed.
    """
    try:
        written = _read(folder)
    except RunFolderError:
        return False
    document = closure_document(closure)
    return (
        written | {key: document[key] for key in ("tables", "simulated", "rotation", "composed")} == document
    )


def has_composed_laws(folder: Path) -> bool:
    """Whether an earlier search composed laws.

    Raises RunFolderError if the file is damaged.
    """
    return holds_search(folder) and _read(folder).get("composed") is not None


def read_held_out_cycles(folder: Path) -> list[int]:
    """Held-out cycles of an earlier search; none without one.

    Raises RunFolderError if the file is damaged.
    """
    if not holds_search(folder):
        return []
    cycles = _read(folder).get("held_out_cycles")
    if not isinstance(cycles, list) or not all(type(cycle) is int for cycle in cycles):
        raise _damaged(folder, "it has no list held_out_cycles")
    return cycles


def read_quantity(folder: Path) -> Quantity:
    """Coefficients that an earlier search explained.

    Raises RunFolderError if there is none, or its file is damaged.
    """
    return quantity(str(_read(folder).get("quantity", "gyro_bias")))


def read_tables(folder: Path) -> list[str]:
    """Paths of the tables of an earlier search; empty for one that does not name them.

    Raises RunFolderError if there is none, or its file is damaged.
    """
    tables = _read(folder).get("tables", [])
    try:
        return [str(table["path"]) for table in tables]
    except (TypeError, KeyError) as error:
        raise _damaged(folder, "its list tables has no paths") from error


def _read(folder: Path) -> dict[str, Any]:
    path = folder / _CLOSURE_FILE
    if not path.exists():
        raise RunFolderError(
            f"{folder}: there is no {_CLOSURE_FILE}. Give a folder that gyrobench close wrote"
        )
    try:
        content = parse_json(read_limited(path, _MAX_BYTES, RunFolderError))
    except ValueError as error:
        raise _damaged(folder, str(error)) from error
    if not isinstance(content, dict):
        raise _damaged(folder, "it is not a JSON object")
    return content


def _damaged(folder: Path, reason: str) -> RunFolderError:
    return RunFolderError(
        f"{folder / _CLOSURE_FILE}: the file is damaged: {reason}. Remove it and run gyrobench close again"
    )


def closure_document(closure: Closure) -> dict[str, Any]:
    """Content of ``closure.json``; name and unit of the quantity come first if it is not the gyro biases."""
    quantity = closure.quantity
    header = {} if quantity.is_gyro_bias else {"quantity": quantity.name, "unit": quantity.unit}
    return {**header, **quantity.in_unit(_gyro_bias_document(closure))}


def _gyro_bias_document(closure: Closure) -> dict[str, Any]:
    return {
        "verdict": closure.verdict,
        "effects": [_effect_document(each) for each in closure.effects],
        "probabilities": {
            "found": closure.probability,
            "nothing": closure.posterior.no_effect_probability,
            "not_on_the_list": closure.posterior.unlisted_probability,
            "effects": closure.posterior.effect_probabilities,
        },
        "hypotheses": [
            {
                "effects": sorted(each.names),
                "not_on_the_list": each.has_remainder,
                "probability": each.probability,
            }
            for each in closure.posterior.hypotheses[:_HYPOTHESES]
        ],
        "composed": None if closure.composed is None else _composed_document(closure.composed),
        "remainder_shown_from_dph": {
            name: size if math.isfinite(size) else None for name, size in closure.detectable_dph.items()
        },
        "separating_measurement": closure.separating_measurement,
        "left_over": closure.unexplained_part,
        "noise_dph": closure.noise_dph,
        "noise_over_stated": closure.noise_scale,
        "noise": {
            "scale": closure.noise_scale,
            "scales": dict(zip(closure.quantity.axes, closure.noise.scales.tolist(), strict=True)),
            "outliers": [
                {"dwell": each.dwell, "gyro": each.gyro, "residual_sigma": each.residual_sigma}
                for each in closure.noise.outliers
            ],
        },
        "confounding": list(closure.confounding),
        "lack_of_fit_p_before": closure.before.p_value,
        "lack_of_fit_p_after": closure.after.p_value,
        "held_out_p": dict(zip(closure.quantity.axes, closure.held_out.p_values, strict=True)),
        "error_before_dph": _none_if_nan(closure.error_before_dph),
        "error_after_dph": _none_if_nan(closure.error_after_dph),
        "error_before_sigma_dph": _none_if_nan(closure.error_before_sigma_dph),
        "error_after_sigma_dph": _none_if_nan(closure.error_after_sigma_dph),
        "tables": [
            {
                "path": table.name,
                "cycles": list(table.cycles),
                "added_to_dwells": table.added,
                "placed": table.placed,
                "doubt": table.doubt,
            }
            for table in closure.campaign.tables
        ],
        "simulated": _is_simulated(closure),
        "held_out_cycles": sorted(set(closure.campaign.cycle[~closure.searched].tolist())),
        "dwells_searched": int(closure.searched.sum()),
        "rotation": [
            {
                "held_out_cycle": turn.cycle,
                "verdict": turn.verdict or None,
                "effects": list(turn.effects),
                **{
                    name: _none_if_nan(getattr(turn, name))
                    for name in ("error_before_dph", "error_after_dph")
                },
            }
            for turn in closure.held_out_in_turn
        ],
        "tried": [
            {
                "effect": each.effect.name,
                "lacks": each.missing_input,
                "share_explained_alone": _none_if_nan(each.share),
                "p_value_alone": None if each.candidate is None else each.p_value,
                "rejected": each.rejected or None,
            }
            for each in closure.evidence
        ],
    }


def _none_if_nan(value: float) -> float | None:
    return None if math.isnan(value) else value


def _composed_document(composed: Composed) -> dict[str, Any]:
    return {
        "status": "empirical: hypotheses until cycles of other runs confirm them",
        "laws_tried": composed.tried,
        "drivers": composed.driver_probabilities,
        "other": composed.other,
        "law_and_something_else": composed.law_and_remainder,
        "laws": [
            {
                "driver": law.file.driver,
                "shape": law.file.shape,
                "memory": law.file.memory,
                "factor": law.file.factor,
                "parameters": {
                    parameter.name: value
                    for parameter, value in zip(
                        law.candidate.form.parameters, law.candidate.values, strict=True
                    )
                },
                "probability": law.probability,
                "error_after_dph": law.error_after_dph,
                "statement": law.file.statement,
            }
            for law in composed.laws
        ],
    }


def format_predictions(closure: Closure) -> str:
    """CSV text with the bias of every dwell by both models and its uncertainty; empty without temperature."""
    whole = closure.campaign.whole
    columns = [each.candidate.columns(whole) for each in closure.effects]
    before = predict(whole, closure.declared.declared, [], [])
    after = predict(whole, closure.model.declared, [each.sizes_dph for each in closure.effects], columns)
    sigmas = [
        draws.sigma(draws.bias_dph(whole), stated)
        for draws, stated in ((closure.declared_draws, before), (closure.model_draws, after))
    ]
    by_dwell = dict(zip(whole.dwell.tolist(), np.hstack([before, after, *sigmas]).tolist(), strict=True))
    columns_written = prediction_columns(closure.quantity)
    missing: list[float] = [math.nan] * (len(columns_written) - 1)
    rows = [
        [str(dwell), *("" if math.isnan(value) else f"{value:.9g}" for value in by_dwell.get(dwell, missing))]
        for dwell in sorted([*by_dwell, *whole.without_temperatures])
    ]
    return format_csv(columns_written, rows)


def _is_simulated(closure: Closure) -> bool:
    """Whether a table is of a run with emulated instruments."""
    return bool(watermark_of(*closure.campaign.sources))


def model_document(closure: Closure) -> dict[str, Any]:
    """Content of ``model.yaml``: the declared model and the effects, complete for predictions."""
    draws, axes = closure.model_draws, closure.quantity.axes
    document = {
        "simulated": _is_simulated(closure),
        "degree": DEGREE,
        "scale_c": SCALE_C,
        "fitted_c": {
            axis: [float(column.min()), float(column.max())]
            for axis, column in zip(axes, closure.campaign.gyro_c[closure.searched].T, strict=True)
        },
        "declared_dph": _declared(closure, closure.model.declared),
        "declared_sigma_dph": _declared(closure, draws.sigma(draws.declared, closure.model.declared)),
        "effects": [
            {
                "effect": each.effect.name,
                "form": each.candidate.form.name,
                "parameters": _by_parameter(each, each.candidate.values),
                "parameters_sigma": _by_parameter(each, each.values_sigma.tolist()),
                "at_bound": list(each.at_bound),
                "terms_dph": _by_term(each, each.sizes_dph),
                "terms_sigma_dph": _by_term(each, each.sizes_sigma_dph),
            }
            for each in closure.effects
        ],
    }
    return dict(closure.quantity.in_unit(document))


def _declared(closure: Closure, coefficients: FloatArray) -> dict[str, Any]:
    """Coefficients (3, DEGREE + runs) of the declared model by gyro."""
    runs = closure.campaign.run_names
    return {
        axis: {
            "powers": row[:DEGREE].tolist(),
            "constant_of_run": dict(zip(runs, row[DEGREE:].tolist(), strict=True)),
        }
        for axis, row in zip(closure.quantity.axes, coefficients, strict=True)
    }


def _by_parameter(effect: FoundEffect | OtherForm, values: Iterable[_T]) -> dict[str, _T]:
    names = (each.name for each in effect.candidate.form.parameters)
    return dict(zip(names, values, strict=True))


def _by_term(effect: FoundEffect, sizes: FloatArray) -> dict[str, dict[str, float]]:
    terms = effect.candidate.form.terms
    axes = effect.quantity.axes
    return {axis: dict(zip(terms, row.tolist(), strict=True)) for axis, row in zip(axes, sizes, strict=True)}


def _effect_document(effect: FoundEffect) -> dict[str, Any]:
    return {
        "effect": effect.effect.name,
        "axes": list(effect.axes),
        "probability": effect.probability,
        "p_value": effect.p_value,
        "rms_dph": effect.rms_dph,
        "rms_sigma_dph": effect.rms_sigma_dph,
        "tied_with": list(effect.tied_with),
        "statement": effect.statement,
        "form": effect.candidate.form.name,
        "parameters": _by_parameter(effect, effect.candidate.values),
        "parameters_sigma": _by_parameter(effect, effect.values_sigma.tolist()),
        "parameters_95": _by_parameter(effect, map(list, effect.values_range)),
        "at_bound": list(effect.at_bound),
        "other_forms": [
            {
                "form": each.candidate.form.name,
                "probability": each.probability,
                "parameters": _by_parameter(each, each.candidate.values),
                "parameters_95": _by_parameter(each, map(list, each.values_range)),
                "difference_dph": each.difference_dph,
                "dwell": each.dwell,
            }
            for each in effect.other_forms
        ],
        "gain_in_cycles_left_out": {str(cycle): gain for cycle, gain in effect.gains.items()},
    }
