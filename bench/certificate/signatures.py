"""Signs certificates with a key file or a token, and verifies them: XAdES in a DCC, PAdES in a PDF.

References
----------
RFC 7512 (PKCS#11 URI).
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, unquote_to_bytes

from gyrobench.bench.foundations.clock import WallClock, parse_utc
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.runs.seal_keys import PASSWORD_VARIABLE, pem_key, read_private_key

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

_MAX_KEY_BYTES, _MAX_FILE_BYTES = 1_000_000, 200_000_000
_PKCS12, _TOKEN = (".p12", ".pfx"), "pkcs11:"
_FIELD = "Certificate"
_CHANGED = "the signature does not fit: the file was changed"
_SIGNATURE = "{http://www.w3.org/2000/09/xmldsig#}Signature"


@dataclass(frozen=True, eq=False)
class SigningKey:
    """A private key, RSA or EC, in a file or on a token, with the certificates of its owner."""

    sign_unchecked: Callable[[bytes], bytes]  #: Like :meth:`sign`, without the check of the certificate.
    certificates: Sequence[Certificate]  #: Certificate of the signer, then its chain.

    def __getattr__(self, name: str) -> Any:
        """Other attributes that signxml reads, such as ``key_size``: those of the public key."""
        return getattr(self.public_key(), name)

    def public_key(self) -> Any:
        """Public key in the signer's certificate."""
        return self.certificates[0].public_key()

    def sign(self, data: bytes, **_: object) -> bytes:
        """Sign data: SHA-256 with RSA (PKCS#1 v1.5), or with ECDSA (DER).

        Raises DocumentError if the certificate does not belong to the key, or is for another type of key.
        """
        signature = self.sign_unchecked(data)
        try:
            self.public_key().verify(signature, data, *_scheme(self.public_key()))
        except require("cryptography.exceptions").InvalidSignature as error:
            raise DocumentError("the signer's certificate does not belong to the key") from error
        return signature


@dataclass(frozen=True)
class SignatureCheck:
    """Result of the verification of a file."""

    signer: str  #: Subject of the signer's certificate.
    fingerprint: str  #: SHA-256 of the signer's certificate.
    problem: str  #: Empty if the file is unchanged and its signer is trusted.


def load_signing_key(source: str) -> SigningKey:
    """Load a key with its certificates: from PKCS#12 (.p12, .pfx), from PEM with both, or on a PKCS#11 token.

    A token is given as a URI of RFC 7512 with the path of its module:
    ``pkcs11:token=NAME;object=KEY?module-path=/usr/lib/module.so``. The password of a file, or the PIN of a
    token, is read from GYROBENCH_KEY_PASSWORD. Raises DocumentError if the key can't be used, or the signer's
    certificate is not valid now.
    """
    secret = os.environ.get(PASSWORD_VARIABLE, "")
    key = (
        _load_from_token(source, secret)
        if source.startswith(_TOKEN)
        else _load_from_file(Path(source), secret)
    )
    if not key.certificates:
        raise DocumentError(
            f"{source}: holds no private key with a certificate. Give PKCS#12, or PEM or a token with both"
        )
    _scheme(key.public_key())
    if problem := _validity_problem(key.certificates[0], WallClock().utc()):
        raise DocumentError(f"{source}: {problem}. Renew it: recipients would refuse what it signs")
    return key


def _validity_problem(certificate: Certificate, moment: datetime | None) -> str:
    """Statement that a certificate is not valid at a time of signing, or that this is unknown; else empty."""
    if moment is None:
        return "it has no time of signing"
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if begin <= moment <= end:
        return ""
    return (
        f"the signer's certificate is valid from {begin:%Y-%m-%d} to {end:%Y-%m-%d}, and not on "
        f"{moment:%Y-%m-%d}"
    )


def _load_from_file(path: Path, password: str) -> SigningKey:
    content, secret = read_private_key(path), password.encode() or None
    try:
        if path.suffix in _PKCS12:
            pkcs12 = require("cryptography.hazmat.primitives.serialization.pkcs12")
            key, certificate, others = pkcs12.load_key_and_certificates(content, secret)
            certificates = [certificate, *others] if certificate and key else []
        else:
            key = pem_key(content)
            certificates = require("cryptography.x509").load_pem_x509_certificates(content)
    except (ValueError, TypeError) as error:
        raise DocumentError(
            f"{path}: the key can't be read: {error}. Check the file, and {PASSWORD_VARIABLE} if it has a "
            "password"
        ) from error
    return SigningKey(lambda data: key.sign(data, *_scheme(key.public_key())), certificates)


def _load_from_token(uri: str, pin: str) -> SigningKey:
    pkcs11, x509 = require("pkcs11"), require("cryptography.x509")
    encode = require("cryptography.hazmat.primitives.asymmetric.utils").encode_dss_signature
    attribute = pkcs11.Attribute

    def sign(data: bytes) -> bytes:
        with _open_token(uri, pin) as (_, key):
            if key.key_type is pkcs11.KeyType.RSA:
                return key.sign(data, mechanism=pkcs11.Mechanism.SHA256_RSA_PKCS)  # type: ignore[no-any-return]
            raw = key.sign(hashlib.sha256(data).digest(), mechanism=pkcs11.Mechanism.ECDSA)
        half = len(raw) // 2
        return encode(int.from_bytes(raw[:half]), int.from_bytes(raw[half:]))  # type: ignore[no-any-return]

    with _open_token(uri, pin) as (session, key):
        is_own_by_certificate = {}
        for each in session.get_objects({attribute.CLASS: pkcs11.ObjectClass.CERTIFICATE}):
            is_own = each[attribute.ID] == key[attribute.ID]
            try:
                is_own_by_certificate[x509.load_der_x509_certificate(each[attribute.VALUE])] = is_own
            except ValueError as error:
                if is_own:  # certificates of other keys are not needed
                    raise DocumentError(
                        f"{uri}: the certificate of the key can't be read: {error}. Write it to the token "
                        "again, as DER"
                    ) from error
    chain = [each for each, is_own in is_own_by_certificate.items() if is_own][:1]
    for each in chain:  # the chain grows by the issuer of its last certificate
        chain += [
            other for other in is_own_by_certificate if other.subject == each.issuer and other not in chain
        ][:1]
    return SigningKey(sign, chain)


@contextmanager
def _open_token(uri: str, pin: str) -> Iterator[tuple[Any, Any]]:
    """Session on a token and its private key; logs out at the end."""
    path, _, query = uri.removeprefix(_TOKEN).partition("?")
    path_attributes, query_attributes = (
        dict(part.partition("=")[::2] for part in text.split(mark))
        for text, mark in ((path, ";"), (query, "&"))
    )
    if "pin-value" in {*path_attributes, *query_attributes}:
        raise DocumentError(
            "the URI of --key holds a PIN, which seals and the list of processes would show. Leave pin-value "
            f"out, and set {PASSWORD_VARIABLE}"
        )
    module = unquote(query_attributes.get("module-path", ""))
    if not (
        module and path_attributes.get("token") and ("object" in path_attributes or "id" in path_attributes)
    ):
        raise DocumentError(
            f"{uri}: write pkcs11:token=NAME;object=KEY?module-path=FILE, or id=%01 instead of object"
        )
    pkcs11 = require("pkcs11")
    search_attributes: dict[Any, Any] = {pkcs11.Attribute.CLASS: pkcs11.ObjectClass.PRIVATE_KEY}
    if "object" in path_attributes:
        search_attributes[pkcs11.Attribute.LABEL] = unquote(path_attributes["object"])
    if "id" in path_attributes:
        search_attributes[pkcs11.Attribute.ID] = unquote_to_bytes(path_attributes["id"])
    try:
        token = pkcs11.lib(module).get_token(token_label=unquote(path_attributes["token"]))
        with token.open(user_pin=pin or None) as session:
            keys = list(session.get_objects(search_attributes))
            if len(keys) != 1:
                raise DocumentError(
                    f"{uri}: {counted(len(keys), 'private key')} on the token instead of one. Check object, "
                    f"id and the PIN in {PASSWORD_VARIABLE}"
                )
            yield session, keys[0]
    except (pkcs11.exceptions.PKCS11Error, RuntimeError) as error:
        raise DocumentError(
            f"{uri}: the token can't be used: {f'{type(error).__name__} {error}'.strip()}. Check its module "
            f"and name, and the PIN in {PASSWORD_VARIABLE}"
        ) from error


def _scheme(public: Any) -> tuple[Any, ...]:
    """Padding and hash with which a key signs. Raises DocumentError for keys other than RSA and EC."""
    asymmetric = "cryptography.hazmat.primitives.asymmetric."
    rsa, ec, padding = (require(asymmetric + name) for name in ("rsa", "ec", "padding"))
    sha256 = require("cryptography.hazmat.primitives.hashes").SHA256()
    if isinstance(public, rsa.RSAPublicKey):
        return padding.PKCS1v15(), sha256
    if isinstance(public, ec.EllipticCurvePublicKey):
        return (ec.ECDSA(sha256),)
    raise DocumentError(f"a {type(public).__name__} can't sign a certificate. Use an RSA or EC key")


def sign_dcc(content: bytes, key: SigningKey) -> bytes:
    """Sign a DCC with an enveloped XAdES signature."""
    xml, xades, signxml = require("lxml.etree"), require("signxml.xades"), require("signxml")
    method = signxml.algorithms.SignatureMethod
    is_rsa = len(_scheme(key.public_key())) > 1
    algorithm = method.RSA_SHA256 if is_rsa else method.ECDSA_SHA256
    signer = xades.XAdESSigner(signature_algorithm=algorithm, digest_algorithm="sha256")
    root = xml.fromstring(content, _parser(xml))
    signed = signer.sign(root, key=key, cert=[_pem(each) for each in key.certificates])
    return xml.tostring(signed, xml_declaration=True, encoding="UTF-8")  # type: ignore[no-any-return]


def sign_pdf(content: bytes, key: SigningKey, reason: str) -> bytes:
    """Sign a PDF by PAdES, as an incremental update that does not change its pages."""
    signers, fields = require("pyhanko.sign.signers"), require("pyhanko.sign.fields")
    writer, x509 = require("pyhanko.pdf_utils.incremental_writer"), require("asn1crypto.x509")
    der = require("cryptography.hazmat.primitives.serialization").Encoding.DER

    class KeySigner(signers.Signer):  # type: ignore[misc, name-defined]
        async def async_sign_raw(self, data: bytes, digest_algorithm: str, dry_run: bool = False) -> bytes:  # noqa: ARG002
            return bytes(key.key_size // 4) if dry_run else key.sign(data)

    registry = require("pyhanko_certvalidator.registry").SimpleCertificateStore()
    signer_certificate, *others = [x509.Certificate.load(each.public_bytes(der)) for each in key.certificates]
    registry.register_multiple(others)
    metadata = signers.PdfSignatureMetadata(
        field_name=_FIELD, md_algorithm="sha256", reason=reason, subfilter=fields.SigSeedSubFilter.PADES
    )
    signer = KeySigner(signing_cert=signer_certificate, cert_registry=registry)
    signed = signers.sign_pdf(writer.IncrementalPdfFileWriter(io.BytesIO(content)), metadata, signer=signer)
    return signed.getvalue()  # type: ignore[no-any-return]


def verify_file(path: Path, trusted: Path | None = None) -> SignatureCheck:
    """Verify the signature of a DCC (.xml) or PDF.

    ``trusted``: PEM file of certificates, one of which must be that of the signer or of its issuer. Raises
    DocumentError if the file can't be read or has no signature.
    """
    content = read_limited(path, _MAX_FILE_BYTES, DocumentError)
    try:
        certificate, problem = (_verify_pdf if content.startswith(b"%PDF") else _verify_xml)(content, path)
    except DocumentError:
        raise
    except Exception as error:  # noqa: BLE001 - parsers of damaged files raise anything
        return SignatureCheck("", "", f"the file is damaged: {type(error).__name__}: {error}")
    if not problem and trusted is not None and not _is_trusted(certificate, _load_certificates(trusted)):
        problem = f"signed with a certificate that is neither in {trusted} nor issued by one in it"
    hashes = require("cryptography.hazmat.primitives.hashes")
    digest = certificate.fingerprint(hashes.SHA256()).hex()
    return SignatureCheck(certificate.subject.rfc4514_string(), digest, problem)


def _load_certificates(path: Path) -> Sequence[Certificate]:
    content = read_limited(path, _MAX_KEY_BYTES, DocumentError)
    try:
        return require("cryptography.x509").load_pem_x509_certificates(content)  # type: ignore[no-any-return]
    except ValueError as error:
        raise DocumentError(f"{path}: holds no certificate in PEM: {error}") from error


def _verify_xml(content: bytes, path: Path) -> tuple[Certificate, str]:
    xml, xades, signxml = require("lxml.etree"), require("signxml.xades"), require("signxml")
    x509 = require("cryptography.x509")
    root = xml.fromstring(content, _parser(xml))
    signature = root.find(_SIGNATURE)
    if signature is None:
        raise DocumentError(f"{path}: has no signature")
    encoded = signature.findtext(".//{*}X509Certificate")
    certificate: Certificate = x509.load_pem_x509_certificate(
        f"-----BEGIN CERTIFICATE-----\n{encoded.strip()}\n-----END CERTIFICATE-----\n".encode()
    )
    # A certificate that has expired since does not change the document; its validity is checked below.
    settings = xades.XAdESSignatureConfiguration(verification_time=certificate.not_valid_after_utc)
    try:
        results = xades.XAdESVerifier().verify(
            content, x509_cert=_pem(certificate), expect_config=settings, expect_references=True
        )
    except (signxml.exceptions.InvalidInput, signxml.exceptions.InvalidSignature):
        return certificate, _CHANGED
    signed = [each.signed_xml.tag for each in results if each.signed_xml is not None]
    if root.tag not in signed:
        return certificate, "the signature does not cover the whole document"
    signed_at = parse_utc(signature.findtext(".//{*}SigningTime"))
    return certificate, _validity_problem(certificate, signed_at)


def _verify_pdf(content: bytes, path: Path) -> tuple[Certificate, str]:
    reader = require("pyhanko.pdf_utils.reader").PdfFileReader(io.BytesIO(content))
    validation, x509 = require("pyhanko.sign.validation"), require("cryptography.x509")
    settings = require("pyhanko.sign.validation.settings")
    signatures = reader.embedded_signatures
    if not signatures:
        raise DocumentError(f"{path}: has no signature")
    last = signatures[-1]
    certificate: Certificate = x509.load_der_x509_certificate(last.signer_cert.dump())
    context = require("pyhanko_certvalidator").ValidationContext(
        trust_roots=[last.signer_cert], allow_fetching=False
    )
    usage = settings.KeyUsageConstraints(key_usage=set(), match_all_key_usages=False)
    status = validation.validate_pdf_signature(last, context, key_usage_settings=usage)
    is_whole = status.coverage is validation.SignatureCoverageLevel.ENTIRE_FILE
    if not (status.intact and status.valid):
        return certificate, _CHANGED
    if not is_whole:
        return certificate, "the signature does not cover the whole file"
    signed_at = last.self_reported_timestamp
    return certificate, _validity_problem(certificate, signed_at)


def _is_trusted(certificate: Certificate, roots: Sequence[Certificate]) -> bool:
    """Whether a certificate is one of ``roots``, or was issued by one of them."""
    invalid = require("cryptography.exceptions").InvalidSignature
    for root in roots:
        try:
            certificate.verify_directly_issued_by(root)
        except (ValueError, TypeError, invalid):
            if certificate != root:
                continue
        return True
    return False


def _parser(xml: Any) -> Any:
    return xml.XMLParser(no_network=True, resolve_entities=False)


def _pem(certificate: Certificate) -> str:
    encoding = require("cryptography.hazmat.primitives.serialization").Encoding.PEM
    return certificate.public_bytes(encoding).decode()
