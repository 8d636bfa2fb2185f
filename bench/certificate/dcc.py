"""The certificate as PTB's Digital Calibration Certificate (DCC 3.3.0), with units in D-SI.

References
----------
https://ptb.de/dcc/v3.3.0 (schema), https://ptb.de/si (D-SI), https://digilab.ptb.de/dkd/refType/vocab (names
``basic_...``), ILAC-G8:09/2019, 4.2.3 (conditional pass and fail). Documents are validated against schemas in
a folder; nothing is fetched.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrobench.bench import __version__
from gyrobench.bench.bias.budget import COVERAGE, NORMAL_K
from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.certificate.content import MODEL_DIGITS, BiasResult, Certificate, ModelNumber
from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import plain_name, with_expanded
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.runs.provenance import SIMULATED
from gyrobench.bench.runs.tables.coefficient_table import FRAME_TEXT, plateau_findings, plateau_notes

if TYPE_CHECKING:
    from lxml import etree

_VERSION = "3.3.0"
_DCC, _SI = "https://ptb.de/dcc", "https://ptb.de/si"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_LANGUAGE = "en"
_ROOT = "digitalCalibrationCertificate"
_SERIAL_NUMBER, _MEASURED = "Serial number", "basic_measuredValue"
_EMULATED = (
    "emulated instruments, no measurement; this document shows what a certificate contains and is none"
)
#: D-SI units by the unit of a value, each with the factor that converts to it.
_UNITS: Mapping[str, tuple[str, float]] = {
    "deg/h": (r"\degree\hour\tothe{-1}", 1.0),
    "deg/h/K": (r"\degree\hour\tothe{-1}\kelvin\tothe{-1}", 1.0),
    "deg/h/K2": (r"\degree\hour\tothe{-1}\kelvin\tothe{-2}", 1.0),
    "deg/h/K3": (r"\degree\hour\tothe{-1}\kelvin\tothe{-3}", 1.0),
    "deg/h/g": (r"\degree\hour\tothe{-1}\metre\tothe{-1}\second\tothe{2}", 1.0 / STANDARD_GRAVITY),
    "deg/K": (r"\degree\kelvin\tothe{-1}", 1.0),
    "deg": (r"\degree", 1.0),
    "deg/s": (r"\degree\second\tothe{-1}", 1.0),
    "arcsec": (r"\arcsecond", 1.0),
    "ppm": (r"\ppm", 1.0),
    "ug": (r"\metre\second\tothe{-2}", 1e-6 * STANDARD_GRAVITY),
    "degC": (r"\degreecelsius", 1.0),
    "K": (r"\kelvin", 1.0),
    "m": (r"\metre", 1.0),
    "s": (r"\second", 1.0),
    "mm": (r"\milli\metre", 1.0),
    "ms": (r"\milli\second", 1.0),
    "ug/g2": (r"\metre\tothe{-1}\second\tothe{2}", 1e-6 / STANDARD_GRAVITY),
    "Hz": (r"\hertz", 1.0),
}
_NO_NETWORK = "the schema names {}, which is not in {}. Copy it there: nothing is fetched"


def certificate_dcc(certificate: Certificate) -> bytes:
    """The certificate as DCC without signature. Raises MissingPackageError without lxml."""
    xml = require("lxml.etree")
    return xml.tostring(_root(certificate), xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def validate_dcc(content: bytes, schema: Path) -> None:
    """Validate a DCC against ``dcc.xsd`` and the SI types in a folder.

    Raises DocumentError with all errors and their lines, or if the folder has no usable schema.
    """
    xml = require("lxml.etree")
    schema_files = sorted(schema.rglob("dcc.xsd"))
    if not schema_files:
        raise DocumentError(
            f"{schema}: holds no dcc.xsd. Download the DCC schema {_VERSION} and SI_Format.xsd from PTB "
            "into this folder"
        )

    class InFolder(xml.Resolver):  # type: ignore[misc, name-defined]
        def resolve(self, url: str, public_id: str | None, context: object) -> object:  # noqa: ARG002
            name = url.rsplit("/", 1)[-1]
            path = next(iter(sorted(schema.rglob(name))), None)
            if path is None:
                missing.append(_NO_NETWORK.format(name, schema))
                return self.resolve_empty(context)
            return self.resolve_filename(str(path), context)

    missing: list[str] = []
    parser = xml.XMLParser(no_network=True, resolve_entities=False)
    parser.resolvers.add(InFolder())
    try:
        xml_schema = xml.XMLSchema(xml.parse(str(schema_files[0]), parser))
        document = xml.fromstring(content, xml.XMLParser(no_network=True, resolve_entities=False))
    except (xml.XMLSyntaxError, xml.XMLSchemaParseError) as error:
        raise DocumentError(f"{schema_files[0]}: {'; '.join(missing) or error}") from error
    if not xml_schema.validate(document):
        problems = "\n".join(f"line {each.line}: {each.message}" for each in xml_schema.error_log)
        raise DocumentError(f"the certificate is not valid against {schema_files[0]}:\n{problems}")


def _dcc(name: str, *children: etree._Element | str | None, **attributes: str) -> etree._Element:
    return _element(_DCC, name, children, attributes)


def _si(name: str, *children: etree._Element | str | None) -> etree._Element:
    return _element(_SI, name, children, {})


def _element(space: str, name: str, children: Iterable[Any], attributes: Mapping[str, str]) -> etree._Element:
    """Element of a name space with children and text, without children that are None and empty attributes."""
    element: etree._Element = require("lxml.etree").Element(
        f"{{{space}}}{name}",
        {key: value for key, value in attributes.items() if value},
        nsmap={"dcc": _DCC, "si": _SI, "xsi": _XSI} if name == _ROOT else None,
    )
    for child in children:
        if isinstance(child, str):
            element.text = child
        elif child is not None:
            element.append(child)
    return element


def _root(certificate: Certificate) -> etree._Element:
    """The whole document."""
    comment = None
    if certificate.run.is_simulated:
        comment = _dcc("comment", _dcc("content", f"{SIMULATED}: {_EMULATED}", lang=_LANGUAGE))
    return _dcc(
        _ROOT,
        _administration(certificate),
        _dcc("measurementResults", _measurement(certificate)),
        comment,
        schemaVersion=_VERSION,
        **{f"{{{_XSI}}}schemaLocation": f"{_DCC} {_DCC}/v{_VERSION}/dcc.xsd"},
    )


def _text(tag: str, *texts: str) -> etree._Element:
    return _dcc(tag, *(_dcc("content", text, lang=_LANGUAGE) for text in texts))


def _identifications(*identifications: tuple[str, str, str]) -> etree._Element | None:
    """Element of the identifications (issuer, name, value) that have a value; None without any."""
    elements = [
        _dcc(
            "identification",
            _dcc("issuer", issuer),
            _dcc("value", _collapse_spaces(value)),
            _text("name", name),
            refType="basic_serialNumber" if name == _SERIAL_NUMBER else "",
        )
        for issuer, name, value in identifications
        if value.strip()
    ]
    return _dcc("identifications", *elements) if elements else None


def _administration(certificate: Certificate) -> etree._Element:
    started, ended = certificate.performed
    order, lab = certificate.order, certificate.station.laboratory
    core = _dcc(
        "coreData",
        _dcc("countryCodeISO3166_1", lab.country if lab else "XX"),
        _dcc("usedLangCodeISO639_1", _LANGUAGE),
        _dcc("mandatoryLangCodeISO639_1", _LANGUAGE),
        _dcc("uniqueIdentifier", _collapse_spaces(certificate.number)),
        _identifications(
            ("customer", "Order", order.order),
            ("customer", "Item of the order", order.item),
            ("calibrationLaboratory", "Run", certificate.run.run_name),
            ("calibrationLaboratory", "Sealed data", certificate.seal),
        ),
        _dcc("beginPerformanceDate", f"{started}"),
        _dcc("endPerformanceDate", f"{ended}"),
        _dcc("performanceLocation", "laboratory"),
        _dcc("issueDate", f"{certificate.issued}"),
        _dcc(
            "reportAmendedSubstituted",
            _dcc("typeOfChange", "substituted"),
            _dcc("replacedUniqueIdentifier", _collapse_spaces(order.replaces)),
        )
        if order.replaces
        else None,
    )
    identification = certificate.item.get("identification")
    item = _dcc(
        "item",
        _text("name", "Inertial navigation system"),
        _text("description", identification) if identification else None,
        _identifications(("manufacturer", _SERIAL_NUMBER, certificate.unit or "unknown")),
    )
    address = [
        _dcc(tag, value)
        for tag, value in (
            ("city", lab.city if lab else "unknown"),
            ("countryCode", lab.country if lab else "XX"),
            ("postCode", lab.post_code if lab else ""),
            ("street", lab.street if lab else ""),
        )
        if value
    ]
    laboratory = _dcc(
        "calibrationLaboratory",
        _dcc("calibrationLaboratoryCode", lab.accreditation) if lab and lab.accreditation else None,
        _dcc(
            "contact",
            _text("name", lab.name if lab else "not stated"),
            _dcc("eMail", lab.email) if lab and lab.email else None,
            _dcc("location", *address),
        ),
    )
    name = f"none: {SIMULATED}" if certificate.run.is_simulated else order.authorised_by
    person = _dcc(
        "respPerson",
        _dcc("person", _text("name", name)),
        _dcc("role", "authorises the certificate"),
        _dcc("mainSigner", "true"),
    )
    customer = _dcc(
        "customer",
        _text("name", order.customer or "not stated"),
        _dcc("location", _text("further", order.customer or "not stated")),
    )
    return _dcc(
        "administrativeData",
        _dcc("dccSoftware", _software()),
        core,
        _dcc("items", item),
        laboratory,
        _dcc("respPersons", person),
        customer,
        _statements(certificate),
    )


def _software() -> etree._Element:
    return _dcc(
        "software",
        _text("name", "gyrobench"),
        _dcc("release", f"v{__version__}"),
        _dcc("type", "application"),
    )


def _statements(certificate: Certificate) -> etree._Element:
    sentence, rule = certificate.conformity
    conformity = _conformity(certificate.run.acceptance)
    return _dcc(
        "statements",
        _statement("", SIMULATED, _EMULATED if certificate.run.is_simulated else ""),
        _statement("basic_conformity", "Statement of conformity", sentence, rule, conformity),
        _statement("", "Deviations from the procedure", " ".join(certificate.deviations)),
        _statement("basic_recalibration", "Recalibration", certificate.order.recalibration),
    )


def _conformity(acceptance: Acceptance | None) -> str:
    """Status of conformity; empty without a judgement."""
    if acceptance is None or acceptance.limits is None:
        return ""
    if acceptance.verdict == "marginal":
        is_beyond = any(each.value_dph > each.limit_dph for each in acceptance.judgements)
        return "conditionalFail" if is_beyond else "conditionalPass"
    return {"accepted": "pass", "rejected": "fail"}.get(acceptance.verdict, "")


def _statement(
    ref_type: str, name: str, declaration: str, convention: str = "", conformity: str = ""
) -> etree._Element | None:
    """A statement; None without declaration."""
    if not declaration:
        return None
    return _dcc(
        "statement",
        _text("name", name),
        _dcc("convention", _collapse_spaces(convention)) if convention else None,
        _text("declaration", declaration),
        _dcc("conformity", conformity) if conformity else None,
        refType=ref_type,
    )


def _measurement(certificate: Certificate) -> etree._Element:
    """All results, with method, software, instruments and conditions.

    The schema allows the latter also beside the results; PTB's Schematron rules require them here.
    """
    inputs = [
        _dcc("usedMethodQuantity", _text("name", f"Input: {name}"), _text("noQuantity", value))
        for name, value in certificate.inputs.items()
    ]
    method = _dcc(
        "usedMethod",
        _text("name", "Six-position calibration of gyro biases"),
        _text("description", " ".join(certificate.method)),
        _dcc("norm", "JCGM 100:2008"),
        _dcc("usedMethodQuantities", *inputs),
        refType="basic_calibrationMethod",
    )
    location, conditions = certificate.station.location, certificate.conditions
    air = [
        _dcc("quantity", _real_quantity(round(value, 1), "degC"), refType=f"basic_temperature{limit}")
        for limit, value in zip(("Min", "Max"), certificate.chamber_c, strict=True)
        if math.isfinite(value)
    ]
    influences = [
        _condition("Air in the chamber, lowest and highest", *air, ref_type="basic_temperature"),
        _condition("Latitude", _dcc("quantity", _real_quantity(location.latitude_deg, "deg"))),
        _condition("Height above the ellipsoid", _dcc("quantity", _real_quantity(location.height_m, "m"))),
        _condition("Room", _text("text", conditions["room"])),
    ]
    return _dcc(
        "measurementResult",
        _text("name", "Calibration of the inertial navigation system"),
        _dcc("usedMethods", method),
        _dcc("usedSoftware", _software()),
        _equipment(certificate),
        _dcc("influenceConditions", *influences),
        _dcc("results", *_results(certificate)),
    )


def _equipment(certificate: Certificate) -> etree._Element | None:
    elements = [
        _dcc(
            "measuringEquipment",
            _text("name", plain_name(name)),
            _text("description", f"Calibrated {each.calibrated}, due {each.due}."),
            _identifications(
                ("manufacturer", _SERIAL_NUMBER, each.serial_number),
                ("calibrationLaboratory", "Certificate", f"{each.certificate} {each.issuer}"),
            ),
            _dcc(
                "measuringEquipmentQuantities",
                _dcc(
                    "measuringEquipmentQuantity",
                    _text("name", f"Expanded uncertainty, k = {each.uncertainty.coverage_factor:g}"),
                    _real_quantity(each.uncertainty.value, each.uncertainty.unit),
                ),
            ),
        )
        for name, each in certificate.station.traceability.instruments()
    ]
    return _dcc("measuringEquipments", *elements) if elements else None


def _condition(name: str, *data: etree._Element, ref_type: str = "") -> etree._Element | None:
    """An influence condition; None without data."""
    if not data:
        return None
    return _dcc("influenceCondition", _text("name", name), _dcc("data", *data), refType=ref_type)


def _results(certificate: Certificate) -> list[etree._Element]:
    by_place: dict[tuple[str, str], list[BiasResult]] = {
        (gyro, position): [] for gyro in AXES for position in POSITIONS
    }
    for each in certificate.results:
        by_place[each.gyro, each.position].append(each)
    results = [
        _bias_result(*gyro_and_position, place_results)
        for gyro_and_position, place_results in by_place.items()
        if place_results
    ]
    if certificate.model:
        quantities = [
            _named_quantity(f"{gyro_label(each.axis)}, {each.name}", each, MODEL_DIGITS)
            for each in certificate.model
        ]
        results.append(_list_result("Numbers of the bias model", quantities, certificate.model_note))
    if certificate.coefficients:
        quantities = [
            _named_quantity(
                f"{each.name} {each.axis}, {each.temperature_c:.1f} °C "
                f"({'gyro' if each.name.startswith('gyro') else 'case'})",
                each,
                ref_type=_MEASURED,
            )
            for each in certificate.coefficients
        ]
        rows = certificate.run.coefficients
        note = " ".join([FRAME_TEXT, *plateau_findings(rows), *plateau_notes(rows)])
        results.append(_list_result("Coefficients of the sensors", quantities, note))
    return results


def _bias_result(gyro: str, position: str, results: Sequence[BiasResult]) -> etree._Element:
    temperatures = _si(
        "realListXMLList",
        _si("valueXMLList", " ".join(f"{each.temperature_c:z.2f}" for each in results)),
        _si("unitXMLList", _UNITS["degC"][0]),
    )
    texts = [with_expanded(each.bias_dph, each.expanded_dph).split(" ± ") for each in results]
    expanded = _si(
        "expandedMUXMLList",
        _si("valueExpandedMUXMLList", " ".join(expanded_text for _, expanded_text in texts)),
        _si("coverageFactorXMLList", " ".join(f"{each.k:.4f}" for each in results)),
        _si("coverageProbabilityXMLList", f"{COVERAGE:g}"),
        _si("distributionXMLList", " ".join(_distribution(each.k) for each in results)),
    )
    biases = _si(
        "realListXMLList",
        _si("valueXMLList", " ".join(bias_text for bias_text, _ in texts)),
        _si("unitXMLList", _UNITS["deg/h"][0]),
        _si("measurementUncertaintyUnivariateXMLList", expanded),
    )
    quantities = [
        _dcc("quantity", _text("name", "Temperature of the gyro"), temperatures),
        _dcc("quantity", _text("name", "Bias"), biases, refType=_MEASURED),
    ]
    name = f"Bias of the {gyro_label(gyro)}, {position_label(position)}"
    return _dcc("result", _text("name", name), _dcc("data", _dcc("list", *quantities)))


def _named_quantity(
    name: str, number: ModelNumber, more_digits: int = 0, ref_type: str = ""
) -> etree._Element:
    dsi, factor = _UNITS[number.unit]
    value, expanded = with_expanded(factor * number.value, factor * number.expanded, more_digits).split(" ± ")
    uncertainty = _si(
        "measurementUncertaintyUnivariate",
        _si(
            "expandedMU",
            _si("valueExpandedMU", expanded),
            _si("coverageFactor", f"{number.k:.4f}"),
            _si("coverageProbability", f"{COVERAGE:g}"),
            _si("distribution", _distribution(number.k)),
        ),
    )
    real = _si("real", _si("value", value), _si("unit", dsi), uncertainty)
    return _dcc("quantity", _text("name", name), real, refType=ref_type)


def _list_result(name: str, quantities: Sequence[etree._Element], note: str) -> etree._Element:
    return _dcc(
        "result", _text("name", name), _text("description", note), _dcc("data", _dcc("list", *quantities))
    )


def _real_quantity(value: float, unit: str) -> etree._Element:
    dsi, factor = _UNITS[unit]
    return _si("real", _si("value", f"{factor * value:z.9g}"), _si("unit", dsi))


def _distribution(k: float) -> str:
    """Distribution of a result: normal, or Student's with finite degrees of freedom."""
    return "normal" if math.isclose(k, NORMAL_K, rel_tol=1e-6) else "t"


def _collapse_spaces(text: str) -> str:
    return " ".join(text.split())
