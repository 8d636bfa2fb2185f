import datetime
import shutil

import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.seal import seal_run
from tests.bench.command_line import gyrobench

LABORATORY = """
laboratory: {name: Example Laboratory, street: Long Road 1, city: Sampletown, country: DE, procedure: GYRO-07}
traceability:
  rate_table:
    serial_number: RT-17
    certificate: 2026-0815
    calibrated: 2026-01-15
    due: 2099-01-15
    uncertainty: {value: 0.5, unit: arcsec}
"""


@pytest.fixture(scope="session")
def emulated_run(tmp_path_factory):
    """A sealed run of one dwell on emulated instruments."""
    folder = tmp_path_factory.mktemp("certificate")
    station = folder / "station.yaml"
    station.write_text(find_document("stations", "emulated").read_text() + LABORATORY)
    order = ("--customer", "ACME, Harbour Street 5, Porttown", "--order", "4711", "--operator", "A. Smith")
    run = folder / "run"
    done = gyrobench("run", "ten_minute_check", "--station", station, "--out", run, *order, cwd=folder)
    assert done.returncode == 0, done.stderr
    return RunFolder(run)


@pytest.fixture
def measured_run(emulated_run, tmp_path):
    """The same as if real instruments had been used."""
    run = RunFolder(tmp_path / "run")
    shutil.copytree(emulated_run.path, run.path, ignore=shutil.ignore_patterns("seals"))
    for path in (run.provenance, run.journal):
        text = path.read_text().replace('"world"', '"bench"').replace("gyrobench emulator", "revision 3")
        path.write_text(text)
    seal_run(run)
    return run


@pytest.fixture(scope="session")
def signing_key(tmp_path_factory):
    """PEM file with a key and its certificate, which is also in a file .crt beside it."""
    return new_signing_key(tmp_path_factory.mktemp("keys") / "laboratory.pem", "Example Laboratory")


@pytest.fixture(scope="session")
def other_key(tmp_path_factory):
    return new_signing_key(tmp_path_factory.mktemp("keys") / "other.pem", "Other Laboratory")


def new_signing_key(path, owner):
    x509 = pytest.importorskip("cryptography.x509")
    ec = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ec")
    hashes = pytest.importorskip("cryptography.hazmat.primitives.hashes")
    serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, owner)])
    begin = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(begin)
        .not_valid_after(begin + datetime.timedelta(days=30000))
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    secret = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    path.write_bytes(secret + certificate.public_bytes(pem))
    path.with_suffix(".crt").write_bytes(certificate.public_bytes(pem))
    return path
