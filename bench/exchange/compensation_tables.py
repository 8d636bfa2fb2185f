"""The bias model of a closed run for the maker of the INS: a table over temperature, and all terms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa

from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.exchange.export_folder import ExportFolder, field_of, unit_of
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.compensation_file import write_compensation
from gyrobench.drivers.ins.command_map import NUMBERS, TERMS, Compensation

_TABLE, _TERMS, _FILE = "compensation_table", "compensation_terms", "compensation.yaml"
#: Spacing of the table, and decimals of its biases: far below what any gyro keeps.
_STEP_C, _DECIMALS = 1.0, 8
_MEANING = MappingProxyType(
    {
        "polynomial_dph": "times T^degree, T in degC held between low_c and high_c",
        "rate_dph_per_c_per_h": "times dT/dt, held within rate_limit_c_per_h",
        "gradient_dph_per_k": "times B - T, held between difference_low_k and difference_high_k",
        "saturating_dph_per_k": "times Up along this axis, (B - T) and 1 / (1 + exp(-c))",
        "growing_dph_per_k": "times Up along this axis, (B - T) and ln(1 + exp(c))",
        "onset_c": "c = (onset_c - T) / onset_width_c",
        "gravity_dph_per_g": "times Up along this axis",
        "warm_up_dph": "times exp(-t / warm_up_s), t since power-on",
        "hysteresis_dph_per_k": "times the play of T of half_width_k, less T",
    }
)


def compensation_files(suffixes: Sequence[str]) -> list[str]:
    """Names of all files, with these endings of tables."""
    return [*(name + suffix for name in (_TABLE, _TERMS) for suffix in suffixes), _FILE]


def export_compensation(closure: Closure, suffixes: Sequence[str], destination: ExportFolder) -> None:
    """Write table, terms and the file that `gyrobench run --compensation` takes.

    ``suffixes``: endings of the tables, ".csv" or ".parquet" or both. Raises RunFolderError if a file can't
    be written.
    """
    declared, model = declared_model(closure), model_with_effects(closure)
    about: dict[str, Any] = {
        "verdict": closure.verdict,
        "effects": list(model.effects),
        "notes": list(model.notes),
        "noise_dph": closure.noise_dph,
        "error_held_out_dph": closure.error_after_dph,
        "meaning": "to be subtracted from each gyro; T temperature of its optics, B of its electronics",
    }
    numbers = model.compensation
    table = _table(declared.compensation, numbers)
    terms = pa.Table.from_pylist(list(_terms(numbers)), _TERMS_SCHEMA)
    for suffix in suffixes:
        destination.table(_TABLE + suffix, table.schema, iter([table]), **about)
        destination.table(_TERMS + suffix, _TERMS_SCHEMA, iter([terms]), **about)
    with destination.file(_FILE, **about) as path:
        write_compensation(path, numbers)


def _table(declared: Compensation, model: Compensation) -> pa.Table:
    """Part of the bias that goes by temperature alone, of both models; null where it was not fitted."""
    low_c = math.ceil(float(declared.low_c.min()) / _STEP_C) * _STEP_C
    high_c = float(declared.high_c.max())
    temperature_c = np.arange(low_c, high_c + 1e-9, _STEP_C)
    columns = {"temperature_c": temperature_c}
    for name, compensation in (("bias_{}_dph", model), ("declared_bias_{}_dph", declared)):
        for index, axis in enumerate(AXES):
            columns[name.format(axis)] = _polynomial(compensation, index, temperature_c)
    return pa.table(
        {name: pa.array(values, pa.float64(), from_pandas=True) for name, values in columns.items()},
        pa.schema([field_of(name) for name in columns]),
    )


def _polynomial(compensation: Compensation, gyro: int, temperature_c: FloatArray) -> FloatArray:
    bias_dph = np.polynomial.polynomial.polyval(temperature_c, compensation.polynomial_dph[gyro])
    inside = (temperature_c >= compensation.low_c[gyro]) & (temperature_c <= compensation.high_c[gyro])
    return np.where(inside, np.round(bias_dph, _DECIMALS), np.nan)


_TERMS_SCHEMA = pa.schema(
    [
        pa.field("gyro", pa.string()),
        pa.field("number", pa.string()),
        pa.field("index", pa.string()),
        pa.field("value", pa.float64()),
        pa.field("sigma", pa.float64()),
        pa.field("unit", pa.string()),
        pa.field("term", pa.string()),
        pa.field("meaning", pa.string()),
    ]
)


def _terms(compensation: Compensation) -> Iterator[dict[str, Any]]:
    """One row a number; those that are zero for all gyros are left out."""
    effect = {name: term for term, name in TERMS.items()}
    for name in NUMBERS:
        values = getattr(compensation, name)
        if not values.any() and name not in ("low_c", "high_c"):
            continue
        sigmas = compensation.sigma.get(name, np.full_like(values, np.nan))
        for axis, row, of_row in zip(AXES, values, sigmas, strict=True):
            for index, (value, sigma) in enumerate(
                zip(np.atleast_1d(row), np.atleast_1d(of_row), strict=True)
            ):
                is_polynomial = name == "polynomial_dph"
                along = f"degree {index}" if is_polynomial else AXES[index] if row.ndim else ""
                per = f" per degC^{index}" if is_polynomial and index else ""
                yield {
                    "gyro": axis,
                    "number": name,
                    "index": along,
                    "value": float(f"{value:.9g}"),
                    "sigma": None if math.isnan(sigma) else float(f"{sigma:.3g}"),
                    "unit": unit_of(name) + per,
                    "term": "declared" if is_polynomial else effect.get(name, ""),
                    "meaning": _MEANING.get(name, ""),
                }
