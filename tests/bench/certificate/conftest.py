import datetime
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.seal import seal_run
from tests.bench.command_line import gyrobench

#: Of the token in software.
LABEL, PIN = "bench", "1234"
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


@pytest.fixture(scope="session")
def token(tmp_path_factory):
    """URI by label, certificate's file and PIN of two keys on a software token: RSA and EC."""
    pkcs11 = pytest.importorskip("pkcs11")
    x509 = pytest.importorskip("cryptography.x509")
    rsa = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.rsa")
    Encoding = pytest.importorskip("cryptography.hazmat.primitives.serialization").Encoding
    module = next(Path("/usr/lib").rglob("libsofthsm2.so"), None)
    if module is None or shutil.which("softhsm2-util") is None:
        pytest.skip("needs softhsm2, a PKCS#11 token in software")
    folder = tmp_path_factory.mktemp("token")
    (folder / "conf").write_text(f"directories.tokendir = {folder}\n")
    os.environ["SOFTHSM2_CONF"] = str(folder / "conf")
    softhsm("--init-token", "--free", "--label", LABEL, "--so-pin", "5678")
    found = {}
    for label, key in (("rsa", rsa.generate_private_key(65537, 2048)), ("ec", None)):
        pem = new_signing_key(folder / f"{label}.pem", f"Token {label}", key)
        identifier = label.encode().hex()
        softhsm("--import", pem, "--token", LABEL, "--label", label, "--id", identifier)
        certificate = x509.load_pem_x509_certificate(pem.with_suffix(".crt").read_bytes())
        with pkcs11.lib(str(module)).get_token(token_label=LABEL).open(rw=True, user_pin=PIN) as session:
            session.create_object(
                {
                    pkcs11.Attribute.CLASS: pkcs11.ObjectClass.CERTIFICATE,
                    pkcs11.Attribute.CERTIFICATE_TYPE: pkcs11.CertificateType.X_509,
                    pkcs11.Attribute.TOKEN: True,
                    pkcs11.Attribute.ID: label.encode(),
                    pkcs11.Attribute.SUBJECT: certificate.subject.public_bytes(),
                    pkcs11.Attribute.VALUE: certificate.public_bytes(Encoding.DER),
                }
            )
        found[label] = f"pkcs11:token={LABEL};object={label}?module-path={module}", pem.with_suffix(".crt")
    return found


def softhsm(*arguments):
    subprocess.run(["softhsm2-util", *map(str, arguments), "--pin", PIN], check=True, capture_output=True)


def new_signing_key(path, owner, key=None, days=30000):
    x509 = pytest.importorskip("cryptography.x509")
    ec = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ec")
    hashes = pytest.importorskip("cryptography.hazmat.primitives.hashes")
    serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")
    key = key or ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, owner)])
    begin = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(begin)
        .not_valid_after(begin + datetime.timedelta(days=days))
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    secret = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    path.write_bytes(secret + certificate.public_bytes(pem))
    path.with_suffix(".crt").write_bytes(certificate.public_bytes(pem))
    return path
