"""Certificates of runs: what they state, as PDF and DCC, marked where emulated, signed and verified."""

import datetime
import json
import math
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from gyrobench.bench.bias.budget import NORMAL_K, Budget, Contribution, coverage_factor
from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, Judgement
from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.certificate import content, pdf
from gyrobench.bench.certificate.content import BiasResult, ModelNumber, Order, certificate_of
from gyrobench.bench.certificate.dcc import certificate_dcc, validate_dcc
from gyrobench.bench.certificate.issue import file_names, issue_certificate
from gyrobench.bench.certificate.signatures import load_signing_key, sign_dcc, sign_pdf, verify_file
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.foundations.operator_name import OPERATOR_VARIABLE
from gyrobench.bench.foundations.text import with_expanded
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.seal import seal_run, verify_seals
from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE, COMBINED, coefficient_budget_rows
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE, PlateauCoefficientRow
from tests.bench.certificate.conftest import LABEL, PIN, new_signing_key
from tests.bench.command_line import gyrobench, output_of, refusal_of
from tests.bench.report.made_up_closure import explained

etree = pytest.importorskip("lxml.etree")

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
SIGNED_BY = Order(authorised_by="B. Jones", number="C-1", ambient="23 °C, 45 % RH")
#: Folder with PTB's dcc.xsd and SI_Format.xsd, which no package registry carries.
SCHEMA = os.environ.get("GYROBENCH_DCC_SCHEMA", "")


@pytest.fixture(scope="module")
def simulated(emulated_run):
    return certificate_of(emulated_run, Order(), simulated=True)


def texts(document, path):
    return [each.text for each in etree.fromstring(document).iterfind(path, NAMES)]


def test_a_certificate_of_an_emulated_run_is_refused_unless_it_may_say_so(emulated_run):
    with pytest.raises(DocumentError, match="Add --simulated"):
        certificate_of(emulated_run, SIGNED_BY)
    assert certificate_of(emulated_run, SIGNED_BY, simulated=True).run.is_simulated


def test_a_certificate_states_order_laboratory_conditions_and_traceability(measured_run):
    made = certificate_of(measured_run, SIGNED_BY)
    assert not made.run.is_simulated
    assert made.number == "C-1"
    assert made.item["customer"] == "ACME, Harbour Street 5, Porttown"
    assert made.item["order"] == "4711"
    assert made.item["data"].startswith("seal 1, SHA-256 ")
    assert made.laboratory["authorised by"] == "B. Jones"
    assert made.laboratory["operator"] == "A. Smith"
    assert made.deviations == ["None."]
    assert made.conditions["room"] == "23 °C, 45 % RH"
    assert made.inputs["angle random walk (deg/√h)"] == "0.0006"
    assert made.inputs["velocity random walk (µg/√Hz)"] == "5.0"
    assert made.inputs["velocity output beyond its resolution (m/s)"] == "0.0"
    assert made.traceability[0][:3] == ("rate table", "RT-17", "2026-0815")
    assert made.conformity == ("No statement of conformity: the procedure states no limits.", "")


def test_k_and_u_are_those_of_the_budget(measured_run):
    made = certificate_of(measured_run, SIGNED_BY)
    sums = {
        (row.axis, row.position): (row.k, row.expanded)
        for row in BUDGET_TABLE.iterate(measured_run.budget)
        if (row.result, row.contribution) == ("bin", COMBINED)
    }
    assert len(made.results) == 3
    assert {(each.gyro, each.position): (each.k, each.expanded_dph) for each in made.results} == sums


def test_without_a_budget_u_is_the_normal_one(measured_run):
    shutil.rmtree(measured_run.path / "seals")
    measured_run.budget.unlink()
    seal_run(measured_run)
    made = certificate_of(measured_run, SIGNED_BY)
    sigmas = [each.sigma_dph for each in made.run.bins if not each.is_empty]
    assert [each.expanded_dph for each in made.results] == pytest.approx([NORMAL_K * each for each in sigmas])


def test_a_coefficient_has_k_and_u_of_its_budget(measured_run):
    row = PlateauCoefficientRow(
        1, 1, 50.0, 62.0, "gyro_misalignment", "xy", 6.4, 0.18, "arcsec", "", math.nan, math.nan
    )
    budget = Budget((Contribution("misfit", math.nan, row.sigma, 5.0),))
    [coefficient] = [each for each in COEFFICIENTS if (each.name, each.axis) == (row.coefficient, row.axis)]
    shutil.rmtree(measured_run.path / "seals")
    COEFFICIENT_TABLE.write(measured_run.coefficients, [row, replace(row, plateau=2)])
    rows = [*BUDGET_TABLE.iterate(measured_run.budget), *coefficient_budget_rows(1, [(coefficient, budget)])]
    BUDGET_TABLE.write(measured_run.budget, rows)
    seal_run(measured_run)
    made = certificate_of(measured_run, SIGNED_BY)
    known, unknown = made.coefficients
    assert (known.k, known.expanded) == pytest.approx((2.5706, 2.5706 * 0.18), abs=1e-4)
    assert (unknown.k, unknown.expanded) == (NORMAL_K, NORMAL_K * 0.18)
    document = certificate_dcc(made)
    assert "2.5706" in texts(document, ".//si:coverageFactor")
    assert texts(document, ".//si:distribution")[-2:] == ["t", "normal"]


def test_a_polynomial_whose_scatter_is_estimated_has_its_degrees_of_freedom(measured_run):
    shutil.rmtree(measured_run.path / "seals")
    [first, *_] = read_dwells(measured_run.dwells)
    rows = [
        replace(first, dwell=n + 1, gyro_c=(6.0 * n,) * 3, bias_dph=(0.1 * (-1) ** n,) * 3) for n in range(9)
    ]
    write_dwells(measured_run.dwells, rows)
    seal_run(measured_run)
    model = certificate_of(measured_run, SIGNED_BY).model
    assert len(model) == 3 * 4
    assert {each.k for each in model} == {coverage_factor(9 - 4)}


def test_an_effect_has_the_label_that_the_report_gives_it(measured_run, monkeypatch):
    monkeypatch.setattr(content, "holds_search", lambda folder: True)
    monkeypatch.setattr(content, "repeat_search", lambda folder: explained())
    monkeypatch.setattr(Closure, "label", lambda self, name: f"label of {name}")
    note = certificate_of(measured_run, SIGNED_BY).model_note
    assert re.search(
        r"temperature: label of temperature_rate \(in all 0\.\d+ ± 0\.\d+ deg/h rms, k = 1\.96\)\.", note
    )


def test_each_bias_and_its_u_have_the_digits_of_that_u():
    result = BiasResult("x", "z_up", 20.0, 30.0, 25.0, 0.0075823, 0.0034412, NORMAL_K)
    precise = replace(result, position="y_up", expanded_dph=0.00011)
    (row,) = pdf._bias_table([result, precise]).rows
    assert row[1:] == ["7.6 ± 3.4", "7.58 ± 0.11"]


def test_numbers_of_a_model_are_not_rounded_to_u():
    number = ModelNumber("growing", "x", -2.74937e-5, 3.44e-5, 1.96, "deg/h/K")
    numbers = [number, replace(number, value=5.801e-4, expanded=5.68e-3, axis="y")]
    section = pdf._model_section(SimpleNamespace(model=numbers, model_note=""))
    assert section.tables[0].rows == [["growing", "deg/h/K", "(-2.749 ± 3.4)e-5", "0.000580 ± 0.0057", "–"]]


def test_a_certificate_is_not_overwritten_and_another_one_names_the_one_that_it_replaces(
    measured_run, tmp_path
):
    certificate = certificate_of(measured_run, replace(SIGNED_BY, number="C-2", replaces="C-1"))
    (first,) = issue_certificate(certificate, {"dcc"}, tmp_path / "first", None, None)
    issued = first.read_bytes()
    with pytest.raises(DocumentError, match=r"certificate\.xml: was issued before.*--replaces NUMBER"):
        issue_certificate(certificate, {"pdf"}, tmp_path / "first", None, None)
    assert first.read_bytes() == issued
    assert certificate.item["replaces the certificate"] == "C-1"
    assert texts(issued, ".//dcc:coreData/dcc:reportAmendedSubstituted/*") == ["substituted", "C-1"]


def test_a_run_that_changed_or_has_no_name_to_authorise_it_gets_none(measured_run):
    with pytest.raises(DocumentError, match="Add --authorised-by"):
        certificate_of(measured_run, Order())
    content = bytearray(measured_run.dwells.read_bytes())
    content[-20] ^= 1
    measured_run.dwells.write_bytes(content)
    with pytest.raises(RunFolderError, match=r"changed since it was sealed: dwells\.csv: byte \d+ is"):
        certificate_of(measured_run, SIGNED_BY)


def test_the_dcc_has_the_numbers_of_the_bins_and_d_si_units(measured_run):
    made = certificate_of(measured_run, SIGNED_BY)
    document = certificate_dcc(made)
    assert texts(document, ".//dcc:uniqueIdentifier") == ["C-1"]
    assert texts(document, ".//dcc:calibrationLaboratory//dcc:city") == ["Sampletown"]
    assert texts(document, ".//dcc:respPerson//dcc:content") == ["B. Jones"]
    lists = texts(document, ".//si:valueXMLList")
    expanded = texts(document, ".//si:valueExpandedMUXMLList")
    written = [f"{bias} ± {u}" for bias, u in zip(lists[1::2], expanded, strict=True)]
    assert written == [with_expanded(each.bias_dph, each.expanded_dph) for each in made.results]
    assert set(texts(document, ".//si:unitXMLList")) == {r"\degreecelsius", r"\degree\hour\tothe{-1}"}
    assert b"SIMULATED" not in document


def test_the_dcc_has_methods_software_instruments_and_conditions_with_the_results(measured_run):
    made = certificate_of(measured_run, SIGNED_BY)
    document = certificate_dcc(made)
    [measurement] = etree.fromstring(document).find("dcc:measurementResults", NAMES)
    assert [etree.QName(each).localname for each in measurement] == [
        "name",
        "usedMethods",
        "usedSoftware",
        "measuringEquipments",
        "influenceConditions",
        "results",
    ]
    assert re.fullmatch(r"v\d+\.\d+\.\d+", texts(document, ".//dcc:usedSoftware//dcc:release")[0])
    inputs = texts(document, ".//dcc:usedMethodQuantity/dcc:noQuantity/dcc:content")
    assert inputs == list(made.inputs.values())
    assert texts(document, ".//dcc:item/dcc:description/dcc:content") == [made.item["identification"]]
    dates = texts(document, ".//dcc:measuringEquipment/dcc:description/dcc:content")
    assert dates == ["Calibrated 2026-01-15, due 2099-01-15."]


def test_the_dcc_names_its_numbers_by_ref_types(measured_run):
    made = certificate_of(measured_run, replace(SIGNED_BY, recalibration="Due in 2027."))
    document = etree.fromstring(certificate_dcc(made))

    def texts_of(ref_type, path):
        return [
            each.findtext(path, namespaces=NAMES)
            for each in document.iterfind(f".//*[@refType='{ref_type}']")
        ]

    assert texts_of("basic_serialNumber", "dcc:value") == [made.unit, "RT-17"]
    numbers = [*made.results, *made.coefficients]
    assert len(texts_of("basic_measuredValue", "dcc:name/dcc:content")) == len(numbers)
    limits = [texts_of(f"basic_temperature{each}", "si:real/si:value")[0] for each in ("Min", "Max")]
    assert limits == [f"{each:.9g}" for each in (round(value, 1) for value in made.chamber_c)]
    assert texts_of("basic_recalibration", "dcc:declaration/dcc:content") == ["Due in 2027."]


@pytest.mark.parametrize(
    ("verdict", "value_dph", "conformity"),
    [
        ("accepted", 0.004, ["pass"]),
        ("marginal", 0.007, ["conditionalPass"]),
        ("marginal", 0.009, ["conditionalFail"]),
        ("rejected", 0.02, ["fail"]),
        ("not judged", 0.004, []),
    ],
)
def test_a_marginal_unit_passes_conditionally_up_to_the_limit(measured_run, verdict, value_dph, conformity):
    made = certificate_of(measured_run, SIGNED_BY)
    judgement = Judgement(
        gyro="x",
        quantity="position difference",
        bin_low_c=20.0,
        bin_high_c=25.0,
        positions=["z_up", "z_down"],
        worst=["z_up", "z_down"],
        value_dph=value_dph,
        sigma_dph=0.002,
        at_least_dph=value_dph - 0.004,
        at_most_dph=value_dph + 0.004,
        limit_dph=0.008,
        verdict={"accepted": "pass", "rejected": "fail"}.get(verdict, "marginal"),
    )
    limits = AcceptanceLimits(position_difference_dph=0.008)
    acceptance = Acceptance(
        verdict=verdict, limits=limits, gyros={"x": judgement.verdict}, judgements=[judgement]
    )
    document = certificate_dcc(replace(made, run=replace(made.run, acceptance=acceptance)))
    assert texts(document, ".//dcc:statement[@refType='basic_conformity']/dcc:conformity") == conformity


def test_the_dcc_rounds_to_two_digits_of_u_in_its_own_unit(measured_run):
    made = certificate_of(measured_run, SIGNED_BY)
    bias = ModelNumber("accelerometer bias", "x", 151.2345678, 12.345678, 1.96, "ug")
    made = replace(made, coefficients=[bias], model=[replace(bias, name="onset", unit="degC")])
    document = certificate_dcc(made)
    assert texts(document, ".//si:real/si:value")[-2:] == ["151.23", "0.00148"]
    assert texts(document, ".//si:valueExpandedMU") == ["12", "0.00012"]


def test_an_emulated_certificate_says_so_in_document_figures_and_file_names(simulated):
    document = certificate_dcc(simulated)
    assert texts(document, ".//dcc:uniqueIdentifier")[0].startswith("SIMULATED-")
    assert texts(document, ".//dcc:statement/dcc:name/dcc:content")[0] == "SIMULATED"
    assert texts(document, ".//dcc:respPerson//dcc:content") == ["none: SIMULATED"]
    assert file_names(simulated, ["dcc", "pdf"]) == {
        "dcc": "certificate_SIMULATED.xml",
        "pdf": "certificate_SIMULATED.pdf",
    }
    assert "authorised by" not in simulated.laboratory


def test_the_folder_of_an_emulated_run_says_so_beside_its_tables(emulated_run):
    assert "were emulated" in (emulated_run.path / "SIMULATED.txt").read_text()
    assert json.loads(emulated_run.provenance.read_text())["simulated"] is True


@pytest.mark.skipif(not SCHEMA, reason="GYROBENCH_DCC_SCHEMA names no folder with dcc.xsd and SI_Format.xsd")
def test_the_dcc_is_valid_against_the_schema_signed_too(measured_run, simulated, signing_key):
    for made in (certificate_of(measured_run, SIGNED_BY), simulated):
        document = certificate_dcc(made)
        validate_dcc(document, Path(SCHEMA))
        validate_dcc(sign_dcc(document, load_signing_key(str(signing_key))), Path(SCHEMA))
    with pytest.raises(DocumentError, match=r"line .*uniqueIdentifier"):
        validate_dcc(document.replace(b"uniqueIdentifier", b"identifier"), Path(SCHEMA))


def test_a_folder_without_the_schema_is_named(tmp_path, simulated):
    with pytest.raises(DocumentError, match=r"holds no dcc\.xsd"):
        validate_dcc(certificate_dcc(simulated), tmp_path)
    (tmp_path / "dcc.xsd").write_text(
        '<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" xmlns:si="https://ptb.de/si">'
        '<xs:import namespace="https://ptb.de/si" schemaLocation="https://ptb.de/si/SI_Format.xsd"/>'
        '<xs:element name="a" type="si:realQuantityType"/></xs:schema>'
    )
    with pytest.raises(DocumentError, match=r"SI_Format\.xsd, which is not in .*nothing is fetched"):
        validate_dcc(certificate_dcc(simulated), tmp_path)


def test_a_signed_dcc_is_refused_after_one_byte_was_changed(simulated, signing_key, tmp_path):
    path = tmp_path / "certificate.xml"
    signed = sign_dcc(certificate_dcc(simulated), load_signing_key(str(signing_key)))
    path.write_bytes(signed)
    check = verify_file(path, signing_key.with_suffix(".crt"))
    assert (check.signer, check.problem) == ("CN=Example Laboratory", "")
    at = signed.index(b"<si:valueXMLList>") + 20
    path.write_bytes(signed[:at] + b"7" + signed[at + 1 :])
    assert verify_file(path).problem.startswith("the signature does not fit")
    path.write_bytes(certificate_dcc(simulated))
    with pytest.raises(DocumentError, match="has no signature"):
        verify_file(path)


def test_a_key_whose_certificate_is_not_valid_signs_nothing(tmp_path):
    with pytest.raises(DocumentError, match="valid from 2026-01-01 to 2026-01-03, and not on 20"):
        load_signing_key(str(new_signing_key(tmp_path / "old.pem", "Old Laboratory", days=2)))


def test_a_document_is_unchanged_after_its_signers_certificate_has_expired(simulated, tmp_path, monkeypatch):
    xades, weasyprint = pytest.importorskip("signxml.xades.xades"), pytest.importorskip("weasyprint")
    monkeypatch.setattr("gyrobench.bench.certificate.signatures._validity_problem", lambda *_: "")
    key = load_signing_key(str(new_signing_key(tmp_path / "old.pem", "Old Laboratory", days=2)))
    monkeypatch.undo()
    document, late, printed = (tmp_path / name for name in ("in_time.xml", "late.xml", "late.pdf"))
    late.write_bytes(sign_dcc(certificate_dcc(simulated), key))
    printed.write_bytes(sign_pdf(weasyprint.HTML(string="<h1>Late</h1>").write_pdf(), key, "Calibration"))
    then = datetime.datetime(2026, 1, 2, tzinfo=datetime.UTC)
    clock = SimpleNamespace(now=lambda _: then)
    monkeypatch.setattr(xades, "datetime", SimpleNamespace(datetime=clock, timezone=datetime.timezone))
    document.write_bytes(sign_dcc(certificate_dcc(simulated), key))
    trusted = tmp_path / "old.crt"
    assert verify_file(document, trusted).problem == ""
    for path in (late, printed):
        assert "valid from 2026-01-01 to 2026-01-03" in verify_file(path, trusted).problem


@pytest.fixture(scope="module")
def certified(emulated_run, signing_key, tmp_path_factory):
    """A run folder with the certificate that the command wrote, and what it printed."""
    pytest.importorskip("weasyprint")
    run = RunFolder(tmp_path_factory.mktemp("certified") / "run")
    shutil.copytree(emulated_run.path, run.path)
    options = ("--simulated", "--key", signing_key, "--operator", "B. Jones")
    with pytest.MonkeyPatch.context() as environment:
        environment.delenv("GYROBENCH_DCC_SCHEMA", raising=False)
        environment.setenv(OPERATOR_VARIABLE, "A. Smith")
        done = gyrobench("certificate", run.path, *options, cwd=run.path.parent)
        assert os.environ[OPERATOR_VARIABLE] == "A. Smith"  # the option holds for its command alone
    assert done.returncode == 0, done.stderr
    return run, done.stdout


@pytest.fixture
def signed_pdf(certified, tmp_path):
    return Path(shutil.copy(certified[0].path / "certificate" / "certificate_SIMULATED.pdf", tmp_path))


def test_a_signed_pdf_is_tagged_has_the_dcc_and_is_refused_after_one_byte_was_changed(
    signed_pdf, signing_key
):
    reader = pytest.importorskip("pyhanko.pdf_utils.reader")
    with signed_pdf.open("rb") as stream:
        root = reader.PdfFileReader(stream).root
        assert root["/MarkInfo"]["/Marked"]
        assert "/AF" in root
        assert b"pdfaid" in root["/Metadata"].data
    assert verify_file(signed_pdf, signing_key.with_suffix(".crt")).problem == ""
    changed = bytearray(signed_pdf.read_bytes())
    changed[len(changed) // 3] ^= 1
    signed_pdf.write_bytes(changed)
    assert verify_file(signed_pdf).problem


@pytest.mark.parametrize("kind", ["rsa", "ec"])
def test_a_key_on_a_token_signs_document_and_pdf(simulated, token, kind, tmp_path, monkeypatch):
    weasyprint = pytest.importorskip("weasyprint")
    monkeypatch.setenv("GYROBENCH_KEY_PASSWORD", PIN)
    uri, trusted = token[kind]
    key = load_signing_key(uri)
    pdf = weasyprint.HTML(string="<h1>Certificate</h1>").write_pdf()
    document, printed = tmp_path / "certificate.xml", tmp_path / "certificate.pdf"
    document.write_bytes(sign_dcc(certificate_dcc(simulated), key))
    printed.write_bytes(sign_pdf(pdf, key, "Calibration certificate"))
    for path in (document, printed):
        check = verify_file(path, trusted)
        assert (check.signer, check.problem) == (f"CN=Token {kind}", "")
        path.write_bytes(path.read_bytes().replace(b"ertificate", b"ertificatf", 1))
        assert verify_file(path).problem


def test_a_token_that_does_not_fit_is_named(token, monkeypatch):
    monkeypatch.setenv("GYROBENCH_KEY_PASSWORD", "4321")
    uri, _ = token["rsa"]
    with pytest.raises(DocumentError, match="PinIncorrect"):
        load_signing_key(uri)
    monkeypatch.setenv("GYROBENCH_KEY_PASSWORD", PIN)
    with pytest.raises(DocumentError, match="0 private keys on the token instead of one"):
        load_signing_key(uri.replace("object=rsa", "object=other"))
    with pytest.raises(DocumentError, match="NoSuchToken"):
        load_signing_key(uri.replace("token=bench", "token=other"))
    with pytest.raises(DocumentError, match="write pkcs11:token=NAME;object=KEY"):
        load_signing_key("pkcs11:token=bench")


@pytest.fixture
def damaged_certificate(token):
    """Stores a certificate that is none, with an identifier, on the token."""
    pkcs11 = pytest.importorskip("pkcs11")
    attribute = pkcs11.Attribute
    module = token["rsa"][0].partition("module-path=")[2]
    opened = pkcs11.lib(module).get_token(token_label=LABEL).open
    kind = {attribute.CLASS: pkcs11.ObjectClass.CERTIFICATE, attribute.LABEL: "damaged"}

    def store(identifier):
        of_none = {attribute.SUBJECT: b"0", attribute.VALUE: b"no certificate", attribute.TOKEN: True}
        of_none[attribute.CERTIFICATE_TYPE] = pkcs11.CertificateType.X_509
        with opened(rw=True, user_pin=PIN) as session:
            session.create_object({**kind, **of_none, attribute.ID: identifier})

    yield store
    with opened(rw=True, user_pin=PIN) as session:
        for each in session.get_objects(kind):
            each.destroy()


def test_a_certificate_on_a_token_that_can_not_be_read_is_named(token, damaged_certificate, monkeypatch):
    monkeypatch.setenv("GYROBENCH_KEY_PASSWORD", PIN)
    uri, _ = token["rsa"]
    damaged_certificate(b"of another key")
    assert load_signing_key(uri).certificates
    damaged_certificate(b"rsa")
    with pytest.raises(DocumentError, match="the certificate of the key can't be read"):
        load_signing_key(uri)


def test_a_uri_with_the_pin_is_refused_without_repeating_it():
    pytest.importorskip("pkcs11")
    with pytest.raises(DocumentError, match="holds a PIN") as refused:
        load_signing_key("pkcs11:token=bench;object=rsa?module-path=/nowhere.so&pin-value=97531")
    assert "97531" not in str(refused.value)


def test_a_certificate_of_another_key_is_refused(simulated, signing_key, other_key, tmp_path):
    mixed = tmp_path / "mixed.pem"
    mixed.write_bytes(
        signing_key.read_bytes().partition(b"-----BEGIN CERTIFICATE")[0]
        + other_key.with_suffix(".crt").read_bytes()
    )
    with pytest.raises(DocumentError, match="does not belong to the key"):
        sign_dcc(certificate_dcc(simulated), load_signing_key(str(mixed)))


def test_a_certificate_of_another_signer_is_not_trusted(simulated, signing_key, other_key, tmp_path):
    path = tmp_path / "certificate.xml"
    path.write_bytes(sign_dcc(certificate_dcc(simulated), load_signing_key(str(signing_key))))
    assert "neither in" in verify_file(path, other_key.with_suffix(".crt")).problem
    with pytest.raises(DocumentError, match="holds no certificate in PEM"):
        verify_file(path, path)


def test_the_password_of_another_key_is_no_obstacle(signing_key, monkeypatch):
    monkeypatch.setenv("GYROBENCH_KEY_PASSWORD", "of another key")
    assert len(load_signing_key(str(signing_key)).certificates) == 1


def test_a_file_without_key_or_certificate_is_refused(tmp_path, signing_key):
    alone = tmp_path / "alone.pem"
    alone.write_bytes(signing_key.read_bytes().partition(b"-----BEGIN CERTIFICATE")[0])
    with pytest.raises(DocumentError, match=r"key can't be read|no private key with a certificate"):
        load_signing_key(str(alone))


def test_the_command_writes_seals_and_verifies(certified, signed_pdf, tmp_path):
    run, printed = certified
    assert "The DCC is not validated" in printed
    last = verify_seals(run.path).seals[-1]
    assert last.operator == "B. Jones"
    assert last.changes.added == [f"certificate/certificate_SIMULATED.{kind}" for kind in ("pdf", "xml")]
    output = output_of("certificate", "--verify", signed_pdf, cwd=tmp_path)
    assert "Unchanged since it was signed by CN=Example Laboratory" in output
    signed_pdf.write_bytes(signed_pdf.read_bytes().replace(b"/Title", b"/Titlf", 1))
    changed = gyrobench("certificate", "--verify", signed_pdf, cwd=tmp_path)
    assert changed.returncode == 1
    assert "does not fit" in changed.stdout or "damaged" in changed.stdout


def test_a_certificate_of_an_unfinished_run_is_written_with_a_warning(measured_run, tmp_path):
    finished = measured_run.journal.read_text()
    measured_run.journal.write_text(finished.replace('"ended": "finished"', '"ended": "stopped"'))
    shutil.rmtree(measured_run.path / "seals")
    seal_run(measured_run)
    options = ("--format", "dcc", "--authorised-by", "B. Jones")
    printed = output_of("certificate", measured_run.path, *options, cwd=tmp_path)
    assert "the run has not finished" in printed
    assert "Written  " in printed


def test_a_certificate_states_until_when_the_biases_stay_within_an_agreed_limit(emulated_run, tmp_path):
    for month in (1, 4, 7):
        run = tmp_path / f"run-{month}"
        shutil.copytree(emulated_run.path, run, ignore=shutil.ignore_patterns("seals", "certificate"))
        provenance = json.loads((run / "provenance.json").read_text())
        provenance["started_utc"] = f"2026-0{month}-01T00:00:00+00:00"
        (run / "provenance.json").write_text(json.dumps(provenance))
        seal_run(RunFolder(run))
    options = ("--simulated", "--format", "dcc", "--limit-dph")
    output_of("certificate", "run-7", *options, "2.0", cwd=tmp_path)
    [written] = (tmp_path / "run-7" / "certificate").iterdir()
    assert any(
        "stay within 2 deg/h with 95 %" in text for text in texts(written.read_bytes(), ".//dcc:content")
    )
    shutil.rmtree(tmp_path / "run-1")
    shutil.rmtree(tmp_path / "run-4")
    problem = refusal_of("certificate", "run-7", *options, "2.0", cwd=tmp_path)
    assert "too few runs of unit" in problem
