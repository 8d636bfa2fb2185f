"""Signatures of certificates: XAdES in a DCC, PAdES in a PDF; made with a key file, and verified."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.runs.seal import PASSWORD_VARIABLE

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

_MAX_KEY_BYTES, _MAX_FILE_BYTES = 1_000_000, 200_000_000
_PKCS12 = (".p12", ".pfx")
_FIELD = "Certificate"
_CHANGED = "the signature does not fit: the file was changed"
_SIGNATURE = "{http://www.w3.org/2000/09/xmldsig#}Signature"


@dataclass(frozen=True, eq=False)
class SigningKey:
    """A private key, RSA or EC, and the certificates of its owner, the signer's first."""

    key: Any
    certificates: Sequence[Certificate]


@dataclass(frozen=True)
class SignatureCheck:
    """Result of the verification of a file."""

    signer: str  #: Subject of the signer's certificate.
    fingerprint: str  #: SHA-256 of the signer's certificate.
    problem: str  #: Empty if the file is as it was signed, by whom it has to be.


def load_signing_key(path: Path) -> SigningKey:
    """Load a key with its certificates: PKCS#12 (.p12, .pfx), or PEM with both.

    A password is taken from GYROBENCH_KEY_PASSWORD. Raises DocumentError if the file can't be used.
    """
    content = read_limited(path, _MAX_KEY_BYTES, DocumentError)
    password = os.environ.get(PASSWORD_VARIABLE, "").encode() or None
    try:
        if path.suffix in _PKCS12:
            loaded = require("cryptography.hazmat.primitives.serialization.pkcs12")
            key, own, others = loaded.load_key_and_certificates(content, password)
            certificates = [own, *others] if own else []
        else:
            serialization = require("cryptography.hazmat.primitives.serialization")
            key = serialization.load_pem_private_key(content, password)
            certificates = require("cryptography.x509").load_pem_x509_certificates(content)
    except (ValueError, TypeError) as error:
        raise DocumentError(
            f"{path}: the key can't be read: {error}. Check the file, and {PASSWORD_VARIABLE} if it has a "
            "password"
        ) from error
    if key is None or not certificates:
        raise DocumentError(
            f"{path}: holds no private key with a certificate. Give PKCS#12, or PEM with both"
        )
    if certificates[0].public_key() != key.public_key():
        raise DocumentError(f"{path}: the first certificate does not belong to the key")
    return SigningKey(key, certificates)


def sign_dcc(content: bytes, key: SigningKey) -> bytes:
    """Sign a DCC with an enveloped XAdES signature. Raises DocumentError for other keys than RSA and EC."""
    xml, xades, signxml = require("lxml.etree"), require("signxml.xades"), require("signxml")
    signer = xades.XAdESSigner(signature_algorithm=_xml_algorithm(key, signxml), digest_algorithm="sha256")
    pem = [_pem(each) for each in key.certificates]
    root = xml.fromstring(content, _parser(xml))
    signed = signer.sign(root, key=key.key, cert=pem)
    return xml.tostring(signed, xml_declaration=True, encoding="UTF-8")  # type: ignore[no-any-return]


def sign_pdf(content: bytes, key: SigningKey, reason: str) -> bytes:
    """Sign a PDF by PAdES, as an incremental update that leaves its pages as they are."""
    signers, fields = require("pyhanko.sign.signers"), require("pyhanko.sign.fields")
    writer = require("pyhanko.pdf_utils.incremental_writer")
    x509, keys = require("asn1crypto.x509"), require("asn1crypto.keys")
    serialization = require("cryptography.hazmat.primitives.serialization")
    der = serialization.Encoding.DER
    private = key.key.private_bytes(der, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    registry = require("pyhanko_certvalidator.registry").SimpleCertificateStore()
    own, *others = [x509.Certificate.load(each.public_bytes(der)) for each in key.certificates]
    registry.register_multiple(others)
    signer = signers.SimpleSigner(
        signing_cert=own, signing_key=keys.PrivateKeyInfo.load(private), cert_registry=registry
    )
    wanted = signers.PdfSignatureMetadata(
        field_name=_FIELD, md_algorithm="sha256", reason=reason, subfilter=fields.SigSeedSubFilter.PADES
    )
    signed = signers.sign_pdf(writer.IncrementalPdfFileWriter(io.BytesIO(content)), wanted, signer=signer)
    return signed.getvalue()  # type: ignore[no-any-return]


def verify_file(path: Path, trusted: Path | None = None) -> SignatureCheck:
    """Verify the signature of a DCC (.xml) or PDF.

    ``trusted``: PEM file of certificates, one of which has to be the signer's or its issuer's. Raises
    DocumentError if the file can't be read or has no signature.
    """
    content = read_limited(path, _MAX_FILE_BYTES, DocumentError)
    try:
        own, problem = (_verify_pdf if content.startswith(b"%PDF") else _verify_xml)(content, path)
    except DocumentError:
        raise
    except Exception as error:  # noqa: BLE001 - parsers of damaged files raise anything
        return SignatureCheck("", "", f"the file is damaged: {type(error).__name__}: {error}")
    if not problem and trusted is not None and not _is_trusted(own, _certificates(trusted)):
        problem = f"signed with a certificate that is neither in {trusted} nor issued by one in it"
    hashes = require("cryptography.hazmat.primitives.hashes")
    digest = own.fingerprint(hashes.SHA256()).hex()
    return SignatureCheck(own.subject.rfc4514_string(), digest, problem)


def _certificates(path: Path) -> Sequence[Certificate]:
    try:
        found = require("cryptography.x509").load_pem_x509_certificates(
            read_limited(path, _MAX_KEY_BYTES, DocumentError)
        )
    except ValueError as error:
        if isinstance(error, DocumentError):
            raise
        raise DocumentError(f"{path}: holds no certificate in PEM: {error}") from error
    return found  # type: ignore[no-any-return]


def _verify_xml(content: bytes, path: Path) -> tuple[Certificate, str]:
    xml, xades, signxml = require("lxml.etree"), require("signxml.xades"), require("signxml")
    x509 = require("cryptography.x509")
    root = xml.fromstring(content, _parser(xml))
    found = root.find(_SIGNATURE)
    if found is None:
        raise DocumentError(f"{path}: has no signature")
    encoded = found.findtext(".//{*}X509Certificate")
    own: Certificate = x509.load_pem_x509_certificate(
        f"-----BEGIN CERTIFICATE-----\n{encoded.strip()}\n-----END CERTIFICATE-----\n".encode()
    )
    try:
        results = xades.XAdESVerifier().verify(content, x509_cert=_pem(own), expect_references=True)
    except (signxml.exceptions.InvalidInput, signxml.exceptions.InvalidSignature):
        return own, _CHANGED
    signed = [each.signed_xml.tag for each in results if each.signed_xml is not None]
    return own, "" if root.tag in signed else "the signature does not cover the whole document"


def _verify_pdf(content: bytes, path: Path) -> tuple[Certificate, str]:
    reader = require("pyhanko.pdf_utils.reader").PdfFileReader(io.BytesIO(content))
    validation, x509 = require("pyhanko.sign.validation"), require("cryptography.x509")
    general = require("pyhanko.sign.validation.settings")
    signatures = reader.embedded_signatures
    if not signatures:
        raise DocumentError(f"{path}: has no signature")
    last = signatures[-1]
    own: Certificate = x509.load_der_x509_certificate(last.signer_cert.dump())
    context = require("pyhanko_certvalidator").ValidationContext(
        trust_roots=[last.signer_cert], allow_fetching=False
    )
    usage = general.KeyUsageConstraints(key_usage=set(), match_all_key_usages=False)
    status = validation.validate_pdf_signature(last, context, key_usage_settings=usage)
    is_whole = status.coverage is validation.SignatureCoverageLevel.ENTIRE_FILE
    if not (status.intact and status.valid):
        return own, _CHANGED
    return own, "" if is_whole else "the signature does not cover the whole file"


def _is_trusted(own: Certificate, roots: Sequence[Certificate]) -> bool:
    """Whether a certificate is one of these, or was issued by one of them."""
    invalid = require("cryptography.exceptions").InvalidSignature
    for root in roots:
        try:
            own.verify_directly_issued_by(root)
        except (ValueError, TypeError, invalid):
            if own != root:
                continue
        return True
    return False


def _xml_algorithm(key: SigningKey, signxml: Any) -> Any:
    algorithms = {"RSAPrivateKey": "RSA_SHA256", "ECPrivateKey": "ECDSA_SHA256"}
    kind = type(key.key).__name__
    if kind not in algorithms:
        raise DocumentError(f"a {kind} can't sign a certificate. Use an RSA or EC key")
    return getattr(signxml.algorithms.SignatureMethod, algorithms[kind])


def _parser(xml: Any) -> Any:
    return xml.XMLParser(no_network=True, resolve_entities=False)


def _pem(certificate: Certificate) -> str:
    encoding = require("cryptography.hazmat.primitives.serialization").Encoding.PEM
    return certificate.public_bytes(encoding).decode()
