"""Content of a certificate, read from a run folder; PDF and DCC show exactly this content.

References
----------
ISO/IEC 17025:2017, 7.8.2 and 7.8.4 (contents of a calibration certificate), 7.8.6 (statement of conformity).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from functools import cached_property
from typing import Any

import numpy as np

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.bias.budget import NORMAL_K, coverage_factor
from gyrobench.bench.bias.statistics import weighted_fit
from gyrobench.bench.closure.files import holds_search
from gyrobench.bench.closure.loadable_model import model_with_effects
from gyrobench.bench.closure.loop import repeat_search
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import (
    capitalised,
    counted,
    hours_minutes,
    listed,
    plain_name,
    with_expanded,
)
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.run_content import RunContent, read_run
from gyrobench.bench.report.run_report import instruments_of, serial_number_of
from gyrobench.bench.report.run_text import acceptance_sentence
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import SIMULATED
from gyrobench.bench.runs.seal import verify_seals
from gyrobench.bench.runs.tables.budget_table import Coverage, coverage
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.bench.station.station_file import StationFile, load_station_file

#: Polynomial that is fitted without a search: degree, and smallest range of temperatures.
_DEGREE, _MIN_SPAN_C = 3, 10.0
_POLYNOMIAL = (
    "Polynomial of the bias over the temperature of the gyro in °C, mean of all positions. Its uncertainty "
    "is multiplied by √(χ²/dof) where that is above 1, as with a bias that depends on the position."
)
_LOADABLE = (
    "Model of the bias by gyrobench close: polynomial over the temperature T of the gyro in °C, and effects "
    "by the formulas of compensation.yaml."
)
#: Digits of a bias model's numbers beyond those of U: they are correlated; rounded to U they would give
#: another bias.
MODEL_DIGITS = 2
#: Names and units of the numbers in a bias model beside the polynomial.
_LABELS = {
    "rate_dph_per_c_per_h": ("temperature rate", "deg/K"),
    "gradient_dph_per_k": ("gradient", "deg/h/K"),
    "saturating_dph_per_k": ("heat flow, saturating", "deg/h/K"),
    "growing_dph_per_k": ("heat flow, growing", "deg/h/K"),
    "onset_c": ("onset", "degC"),
    "onset_width_c": ("width of the onset", "K"),
    "gravity_dph_per_g": ("g-sensitivity", "deg/h/g"),
    "warm_up_dph": ("warm-up", "deg/h"),
    "warm_up_s": ("time constant of the warm-up", "s"),
    "hysteresis_dph_per_k": ("hysteresis", "deg/h/K"),
    "half_width_k": ("half width of the hysteresis", "K"),
}
_METHOD = (
    "Six-position calibration of the gyro bias: in each position the INS aligns and navigates at rest, is "
    "turned by 180° about the vertical, and navigates again. Each gyro's bias is estimated from velocity "
    "and heading before and after the turn by a state-space estimator of the INS errors. Source: Yu et al., "
    "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial Navigation System Based on "
    "Ring Laser Gyroscope."
)
_DECISION_RULE = (
    "A limit is passed where the true value is below it with a probability of {0:.0f} %, and failed where it "
    "is above it with that probability, jointly for all comparisons of the run; between is marginal. The "
    "uncertainty of measurement is taken into account (guarded acceptance, JCGM 106:2012, 8.3)."
)
_UNCERTAINTY = (
    "U is the expanded uncertainty for a coverage probability of 95 %, k its coverage factor from the "
    "effective degrees of freedom (JCGM 100:2008, annex G). It holds for the power cycle measured and "
    "contains no long-term drift. The results relate only to the item calibrated. This certificate may be "
    "reproduced only in full."
)
_UNIT = re.compile(r"_((deg|ug|mps|arcsec|ppm|dph)(_per_[a-z]+(_[a-z]+)?)?)$")
_EVENTS = {
    "dwell_given_up": "repeated dwell",
    "dwell_skipped": "skipped dwell",
    "held": "hold",
    "tripped": "interlock",
    "run_resumed": "interruption",
    "data_given_up": "loss of data",
    "repeat_commanded": "repeat on command",
}


@dataclass(frozen=True)
class Order:
    """Information that the issuer adds; empty texts are taken from the run, or not stated."""

    customer: str = ""
    order: str = ""
    item: str = ""
    number: str = ""  #: Number of the certificate.
    replaces: str = ""  #: Number of the certificate that it replaces.
    authorised_by: str = ""
    ambient: str = ""  #: Conditions in the room.
    recalibration: str = ""  #: Date until which the biases stay within a limit agreed with the customer.


@dataclass(frozen=True)
class BiasResult:
    """Bias of a gyro in one position and temperature bin, with expanded uncertainty."""

    gyro: str
    position: str
    bin_low_c: float
    bin_high_c: float
    temperature_c: float
    bias_dph: float
    expanded_dph: float
    k: float


@dataclass(frozen=True)
class ModelNumber:
    """One number of the bias model of a gyro, or a coefficient of a sensor, with expanded uncertainty."""

    name: str
    axis: str  #: "x", "y" or "z"; for misalignments the sensor and the axis that it senses.
    value: float
    expanded: float
    k: float
    unit: str
    plateau: int = 0  #: Number of the plateau of a coefficient.
    temperature_c: float = math.nan  #: Temperature there: of the gyro, or of the case for accelerometers.


@dataclass(frozen=True, eq=False)
class Certificate:
    """Everything that a certificate states."""

    run: RunContent
    station: StationFile
    order: Order
    seal: str  #: Number, hash and key of the last seal.
    results: Sequence[BiasResult]
    model: Sequence[ModelNumber]  #: Polynomial over temperature, and effects that a search found.
    model_note: str  #: Description of the model.
    coefficients: Sequence[ModelNumber]  #: Observable coefficients of a full calibration; empty without one.
    issued: date

    @property
    def number(self) -> str:
        """Number of the certificate."""
        return f"{SIMULATED}-{self.order.number}" if self.run.is_simulated else self.order.number

    @property
    def unit(self) -> str:
        """Serial number of the INS."""
        return serial_number_of(self.run)

    @cached_property
    def performed(self) -> tuple[date, date]:
        """First and last day of the measurement."""
        started = self.run.started or datetime(2000, 1, 1, tzinfo=UTC)
        return started.date(), (started + timedelta(seconds=self.run.facts.last_s)).date()

    @property
    def item(self) -> dict[str, str]:
        """Identification of the calibrated item, the customer and the run."""
        started, ended = self.performed
        identity = instruments_of(self.run).get("INS", "")
        facts = {
            "certificate": self.number,
            "replaces the certificate": self.order.replaces,
            "item": f"inertial navigation system, serial number {self.unit}",
            "identification": identity,
            "customer": self.order.customer,
            "order": self.order.order,
            "item of the order": self.order.item,
            "calibrated": f"{started}" if started == ended else f"{started} to {ended}",
            "issued": f"{self.issued}",
            "run": self.run.run_name,
            "data": self.seal,
        }
        return {name: text for name, text in facts.items() if text}

    @property
    def laboratory(self) -> dict[str, str]:
        """The laboratory, and the person who authorised the certificate."""
        lab = self.station.laboratory
        facts = {
            "laboratory": lab.name if lab else "",
            "address": lab.address if lab else "",
            "accreditation": lab.accreditation if lab else "",
            "operator": str(self.run.provenance.get("operator", "")),
            "authorised by": "" if self.run.is_simulated else self.order.authorised_by,
        }
        return {name: text for name, text in facts.items() if text}

    @property
    def method(self) -> list[str]:
        """Method and procedure, in paragraphs."""
        lab = self.station.laboratory
        number = f" Procedure of the laboratory: {lab.procedure}." if lab and lab.procedure else ""
        description = str(self.run.procedure.get("description", "")).strip()
        procedure = f"Procedure {self.run.facts.procedure}" + (f": {description}" if description else ".")
        return [_METHOD, f"{procedure}{number}", _UNCERTAINTY]

    @property
    def deviations(self) -> list[str]:
        """Deviations from the procedure."""
        counts = Counter(str(entry.get("event")) for entry in self.run.journal)
        event_counts = [counted(counts[event], noun) for event, noun in _EVENTS.items() if counts[event]]
        flagged = sum(bool(row.flags) for row in self.run.dwells)
        event_counts += [f"{counted(flagged, 'dwell')} flagged and not used"] if flagged else []
        texts = [f"{listed(event_counts)}."] if event_counts else []
        texts += [
            f"{capitalised(str(entry.get('found', '')))}; acknowledged by {entry.get('operator')}."
            for entry in self.run.entries("past_due")
        ]
        if self.run.facts.ended != "finished":
            texts.append(f"{self.run.ending} {capitalised(self.run.reason)}".strip())
        return texts or ["None."]

    @property
    def conditions(self) -> dict[str, str]:
        """Ambient conditions and location, as measured and as used by the estimator."""
        location, (low, high) = self.station.location, self.chamber_c
        return {
            "air in the chamber": f"{low:.1f} to {high:.1f} °C" if math.isfinite(low) else "not measured",
            "room": self.order.ambient or "not measured by the bench",
            "duration": f"{hours_minutes(self.run.facts.last_s)} h",
            "latitude": f"{location.latitude_deg:g}° ± {location.latitude_uncertainty_arcmin:g}′ (k = 1)",
            "height": f"{location.height_m:g} m above the ellipsoid",
        }

    @cached_property
    def chamber_c(self) -> tuple[float, float]:
        """Lowest and highest temperature of the air in the chamber; NaN if not measured."""
        readings = self.run.telemetry.get("chamber_c", np.array([]))
        finite_c = readings[np.isfinite(readings)]
        return (float(finite_c.min()), float(finite_c.max())) if finite_c.size else (math.nan, math.nan)

    @property
    def inputs(self) -> dict[str, str]:
        """Inputs of the estimator as used: noise and standard uncertainties of the INS."""
        sections: dict[str, Any] = self.station.ins.uncertainty.model_dump()
        noise = self.station.ins.noise
        declared = {"noise": noise} if isinstance(noise, str) else noise.model_dump()
        values = {**declared, **sections}
        return {
            _label_with_unit(name.replace("_output_", "_output_beyond_its_resolution_")): f"{value}"
            for name, value in values.items()
            if value is not None
        }

    @property
    def traceability(self) -> list[tuple[str, ...]]:
        """Instrument, serial number, certificate and issuer, dates and uncertainty of each calibration."""
        return [
            (
                plain_name(name),
                each.serial_number,
                f"{each.certificate}{f', {each.issuer}' if each.issuer else ''}",
                f"{each.calibrated}",
                f"{each.due}",
                each.uncertainty.text,
            )
            for name, each in self.station.traceability.instruments()
        ]

    @property
    def conformity(self) -> tuple[str, str]:
        """Statement of conformity and its decision rule; the rule is empty without limits."""
        acceptance = self.run.acceptance
        if acceptance is None or acceptance.limits is None:
            return "No statement of conformity: the procedure states no limits.", ""
        sentence = f"Unit {acceptance.verdict}. {acceptance_sentence(acceptance)}"
        return sentence, _DECISION_RULE.format(100.0 * acceptance.limits.confidence)


def certificate_of(folder: RunFolder, order: Order, *, simulated: bool = False) -> Certificate:
    """Read the content of a certificate from a run.

    ``simulated``: whether emulated instruments are allowed. Raises RunFolderError if the run has no result,
    is not sealed, or was changed after the seal. Raises DocumentError if the instruments were emulated
    without ``simulated``, the station file lacks the laboratory, or the person who authorises the certificate
    is missing.
    """
    run = read_run(folder)
    _, station = load_station_file(folder.station)
    if run.is_simulated and not simulated:
        raise DocumentError(
            f"{folder.path}: its instruments were emulated. Add --simulated for a certificate that says so"
        )
    check = verify_seals(folder.path)
    if not check.is_intact:
        first_finding = check.findings[0]
        raise RunFolderError(
            f"{folder.path}: changed since it was sealed: {first_finding.path}: {first_finding.text}"
        )
    last_seal = check.seals[-1]
    if not run.is_simulated and station.laboratory is None:
        raise DocumentError(f"{folder.station}: has no section laboratory. Add it before the run")
    if not run.is_simulated and not order.authorised_by:
        raise DocumentError("a certificate names who authorises it. Add --authorised-by NAME")
    coverage_factors = coverage(run.budget)
    digest = file_sha256(folder.path / last_seal.relative_path)
    options = {**run.provenance.get("options", {}), **run.facts.options}
    order_texts = {
        name: getattr(order, name) or str(options.get(name, "")) for name in ("customer", "order", "item")
    }
    number = order.number or f"{serial_number_of(run)}-{run.run_name}-{digest[:8]}"
    model, note = _model_numbers(folder, run)
    certificate = Certificate(
        run=run,
        station=station,
        order=replace(order, **order_texts, number=number),
        seal=f"seal {last_seal.number}, SHA-256 {digest[:16]}…, {last_seal.key or 'not signed'}",
        results=list(_bias_results(run.bins, coverage_factors)),
        model=model,
        model_note=note,
        coefficients=list(_coefficient_numbers(run.coefficients, coverage_factors)),
        issued=WallClock().utc().date(),
    )
    if not (certificate.results or certificate.coefficients):
        raise RunFolderError(f"{folder.path}: has no result to certify. Repeat the run")
    return certificate


def _label_with_unit(name: str) -> str:
    match = _UNIT.search(name)
    if match is None:
        return plain_name(name)
    unit = (
        match[1]
        .replace("_per_", "/")
        .replace("/sqrt_", "/√")
        .replace("mps", "m/s")
        .replace("dph", "deg/h")
        .replace("ug", "µg")
    )
    return f"{plain_name(name[: match.start()])} ({unit.replace('hz', 'Hz').replace('/c', '/K')})"


def _bias_results(bins: Sequence[BiasBin], coverage_factors: Coverage) -> Iterator[BiasResult]:
    for each in bins:
        if each.is_empty:
            continue
        key = each.gyro, each.position, each.bin_low_c
        k, expanded = coverage_factors.get(("gyro_bias", *key), (NORMAL_K, NORMAL_K * each.sigma_dph))
        yield BiasResult(*key, each.bin_high_c, each.temperature_c, each.bias_dph, expanded, k)


def _coefficient_numbers(
    rows: Sequence[PlateauCoefficientRow], coverage_factors: Coverage
) -> Iterator[ModelNumber]:
    for row in rows:
        if not row.finding:
            key = row.coefficient, row.axis, row.plateau, 0.0
            k, expanded = coverage_factors.get(key, (NORMAL_K, NORMAL_K * row.sigma))
            number = (plain_name(row.coefficient), row.axis, row.value, expanded, k, row.unit)
            yield ModelNumber(*number, row.plateau, row.temperature_c)


def _model_numbers(folder: RunFolder, run: RunContent) -> tuple[list[ModelNumber], str]:
    """Numbers and description of the model of `gyrobench close`, or of a polynomial fitted to the dwells."""
    if not holds_search(folder.closure):
        return [number for gyro in AXES for number in _polynomial(gyro, run)], _POLYNOMIAL
    try:
        closure = repeat_search(folder.path)
        model = model_with_effects(closure)
    except (MeasurementError, DocumentError) as error:
        raise RunFolderError(f"{folder.closure}: {error}. Repeat gyrobench close") from error
    compensation = model.compensation
    terms = sum(each.sizes_dph.shape[1] + len(each.parameter_texts) for each in closure.effects)
    residual_dof = float(closure.searched.sum()) - _DEGREE - len(closure.campaign.run_names) - terms
    coverage_factors = {
        gyro: coverage_factor(run.budget.dwells_dof(gyro) if scale == 1.0 else residual_dof)
        for gyro, scale in zip(AXES, closure.noise.scales.tolist(), strict=True)
    }
    rows = [
        ModelNumber(label, gyro, value, coverage_factors[gyro] * sigma, coverage_factors[gyro], unit)
        for name, sigmas in compensation.sigma.items()
        for gyro, values, own_sigmas in zip(AXES, getattr(compensation, name), sigmas, strict=True)
        for (label, unit), value, sigma in zip(
            _labels(name, np.size(values)),
            np.atleast_1d(values).tolist(),
            np.atleast_1d(own_sigmas).tolist(),
            strict=True,
        )
        if sigma > 0.0 and value
    ]
    notes = f" Notes: {'; '.join(model.notes)}." if model.notes else ""
    sizes = {
        each.candidate.effect.name: with_expanded(each.rms_dph, NORMAL_K * each.rms_sigma_dph)
        for each in closure.effects
    }
    effects = "; ".join(
        f"{closure.label(name)} (in all {sizes[name]} deg/h rms, k = {NORMAL_K:.2f})"
        for name in model.effects
    )
    return rows, f"{_LOADABLE} Effects found beyond the temperature: {effects or 'none'}.{notes}"


def _labels(name: str, count: int) -> list[tuple[str, str]]:
    """Label and unit of each number of a parameter of the model."""
    if name == "polynomial_dph":
        return [_power_label(power) for power in range(count)]
    label, unit = _LABELS.get(name, (plain_name(name), ""))
    return [(f"{label} along {axis}", unit) for axis in AXES] if count > 1 else [(label, unit)]


def _power_label(power: int) -> tuple[str, str]:
    """Label and unit of a coefficient of a polynomial."""
    return f"polynomial, degree {power}", f"deg/h/K{power}" if power > 1 else "deg/h/K" if power else "deg/h"


def _polynomial(gyro: str, run: RunContent) -> Iterator[ModelNumber]:
    axis = AXES.index(gyro)
    rows = [row for row in run.dwells if not row.flags]
    columns = zip(*((row.gyro_c[axis], row.bias_dph[axis], row.sigma_dph[axis]) for row in rows), strict=True)
    temperature_c, bias, sigma = (np.array(column) for column in columns) if rows else np.empty((3, 0))
    is_valid = np.isfinite(temperature_c) & np.isfinite(bias) & (sigma > 0.0)
    if is_valid.sum() <= _DEGREE + 1 or np.ptp(temperature_c[is_valid]) < _MIN_SPAN_C:
        return
    design = np.vander(temperature_c[is_valid], _DEGREE + 1, increasing=True)
    fit = weighted_fit(bias[is_valid], sigma[is_valid] ** 2, design)
    ratio = math.sqrt(fit.chi2 / fit.dof)
    k = coverage_factor(fit.dof if ratio > 1.0 else run.budget.dwells_dof(gyro))
    expanded = k * max(ratio, 1.0) * np.sqrt(np.diag(fit.covariance))
    for power, (value, value_expanded) in enumerate(zip(fit.values.tolist(), expanded.tolist(), strict=True)):
        label, unit = _power_label(power)
        yield ModelNumber(label, gyro, value, value_expanded, k, unit)
