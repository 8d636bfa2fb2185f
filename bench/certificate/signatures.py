"""Signatures of certificates: XAdES in a DCC, PAdES in a PDF; made with a key file or a token, and verified.

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
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, unquote_to_bytes

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.runs.seal import PASSWORD_VARIABLE, pem_key

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

    sign_unchecked: Callable[[bytes], bytes]  #: Signature of data, as of :meth:`sign`.
    certificates: Sequence[Certificate]  #: The signer's first.

    def __getattr__(self, name: str) -> Any:
        """What signxml reads of a key beside its signature, as ``key_size``: that of the public key."""
        return getattr(self.public_key(), name)

    def public_key(self) -> Any:
        """Public key in the signer's certificate."""
        return self.certificates[0].public_key()

    def sign(self, data: bytes, **_: object) -> bytes:
        """Sign data: SHA-256 with RSA by PKCS#1 v1.5, or with ECDSA in DER.

        Raises DocumentError if the certificate does not belong to the key, or is for another kind of key.
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
    problem: str  #: Empty if the file is as it was signed, by whom it has to be.


def load_signing_key(source: str) -> SigningKey:
    """A key with its certificates: from PKCS#12 (.p12, .pfx), from PEM with both, or on a PKCS#11 token.

    A token is named by a URI of RFC 7512 with the path of its module:
    ``pkcs11:token=NAME;object=KEY?module-path=/usr/lib/module.so``. The password of a file, or the token's
    PIN, is taken from GYROBENCH_KEY_PASSWORD. Raises DocumentError if the key can't be used.
    """
    secret = os.environ.get(PASSWORD_VARIABLE, "")
    found = _of_token(source, secret) if source.startswith(_TOKEN) else _of_file(Path(source), secret)
    if not found.certificates:
        raise DocumentError(
            f"{source}: holds no private key with a certificate. Give PKCS#12, or PEM or a token with both"
        )
    _scheme(found.public_key())
    return found


def _of_file(path: Path, password: str) -> SigningKey:
    content, secret = read_limited(path, _MAX_KEY_BYTES, DocumentError), password.encode() or None
    try:
        if path.suffix in _PKCS12:
            loaded = require("cryptography.hazmat.primitives.serialization.pkcs12")
            key, own, others = loaded.load_key_and_certificates(content, secret)
            certificates = [own, *others] if own and key else []
        else:
            key = pem_key(content)
            certificates = require("cryptography.x509").load_pem_x509_certificates(content)
    except (ValueError, TypeError) as error:
        raise DocumentError(
            f"{path}: the key can't be read: {error}. Check the file, and {PASSWORD_VARIABLE} if it has a "
            "password"
        ) from error
    return SigningKey(lambda data: key.sign(data, *_scheme(key.public_key())), certificates)


def _of_token(uri: str, pin: str) -> SigningKey:
    pkcs11, x509 = require("pkcs11"), require("cryptography.x509")
    encode = require("cryptography.hazmat.primitives.asymmetric.utils").encode_dss_signature
    attribute = pkcs11.Attribute

    def sign(data: bytes) -> bytes:
        with _opened(uri, pin) as (_, key):
            if key.key_type is pkcs11.KeyType.RSA:
                return key.sign(data, mechanism=pkcs11.Mechanism.SHA256_RSA_PKCS)  # type: ignore[no-any-return]
            raw = key.sign(hashlib.sha256(data).digest(), mechanism=pkcs11.Mechanism.ECDSA)
        half = len(raw) // 2
        return encode(int.from_bytes(raw[:half]), int.from_bytes(raw[half:]))  # type: ignore[no-any-return]

    with _opened(uri, pin) as (session, key):
        held = {}
        for each in session.get_objects({attribute.CLASS: pkcs11.ObjectClass.CERTIFICATE}):
            is_own = each[attribute.ID] == key[attribute.ID]
            try:
                held[x509.load_der_x509_certificate(each[attribute.VALUE])] = is_own
            except ValueError as error:
                if is_own:  # that of another key is not needed
                    raise DocumentError(
                        f"{uri}: the certificate of the key can't be read: {error}. Write it to the token "
                        "again, as DER"
                    ) from error
    chain = [each for each, is_own in held.items() if is_own][:1]
    for each in chain:  # which grows by the issuer of its last one
        chain += [other for other in held if other.subject == each.issuer and other not in chain][:1]
    return SigningKey(sign, chain)


@contextmanager
def _opened(uri: str, pin: str) -> Iterator[tuple[Any, Any]]:
    """Session on a token and the private key on it; the user is logged out at the end."""
    path, _, query = uri.removeprefix(_TOKEN).partition("?")
    named, asked = (
        dict(part.partition("=")[::2] for part in text.split(mark))
        for text, mark in ((path, ";"), (query, "&"))
    )
    if "pin-value" in {*named, *asked}:
        raise DocumentError(
            "the URI of --key holds a PIN, which seals and the list of processes would show. Leave pin-value "
            f"out, and set {PASSWORD_VARIABLE}"
        )
    module = unquote(asked.get("module-path", ""))
    if not (module and named.get("token") and ("object" in named or "id" in named)):
        raise DocumentError(
            f"{uri}: write pkcs11:token=NAME;object=KEY?module-path=FILE, or id=%01 instead of object"
        )
    pkcs11 = require("pkcs11")
    wanted: dict[Any, Any] = {pkcs11.Attribute.CLASS: pkcs11.ObjectClass.PRIVATE_KEY}
    if "object" in named:
        wanted[pkcs11.Attribute.LABEL] = unquote(named["object"])
    if "id" in named:
        wanted[pkcs11.Attribute.ID] = unquote_to_bytes(named["id"])
    try:
        token = pkcs11.lib(module).get_token(token_label=unquote(named["token"]))
        with token.open(user_pin=pin or None) as session:
            found = list(session.get_objects(wanted))
            if len(found) != 1:
                raise DocumentError(
                    f"{uri}: {counted(len(found), 'private key')} on the token instead of one. Check object, "
                    f"id and the PIN in {PASSWORD_VARIABLE}"
                )
            yield session, found[0]
    except (pkcs11.exceptions.PKCS11Error, RuntimeError) as error:
        raise DocumentError(
            f"{uri}: the token can't be used: {f'{type(error).__name__} {error}'.strip()}. Check its module "
            f"and name, and the PIN in {PASSWORD_VARIABLE}"
        ) from error


def _scheme(public: Any) -> tuple[Any, ...]:
    """Padding and hash by which a key signs; raises DocumentError for other keys than RSA and EC."""
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
    """Sign a PDF by PAdES, as an incremental update that leaves its pages as they are."""
    signers, fields = require("pyhanko.sign.signers"), require("pyhanko.sign.fields")
    writer, x509 = require("pyhanko.pdf_utils.incremental_writer"), require("asn1crypto.x509")
    der = require("cryptography.hazmat.primitives.serialization").Encoding.DER

    class KeySigner(signers.Signer):  # type: ignore[misc, name-defined]
        async def async_sign_raw(self, data: bytes, digest_algorithm: str, dry_run: bool = False) -> bytes:  # noqa: ARG002
            return bytes(key.key_size // 4) if dry_run else key.sign(data)

    registry = require("pyhanko_certvalidator.registry").SimpleCertificateStore()
    own, *others = [x509.Certificate.load(each.public_bytes(der)) for each in key.certificates]
    registry.register_multiple(others)
    wanted = signers.PdfSignatureMetadata(
        field_name=_FIELD, md_algorithm="sha256", reason=reason, subfilter=fields.SigSeedSubFilter.PADES
    )
    signer = KeySigner(signing_cert=own, cert_registry=registry)
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


def _parser(xml: Any) -> Any:
    return xml.XMLParser(no_network=True, resolve_entities=False)


def _pem(certificate: Certificate) -> str:
    encoding = require("cryptography.hazmat.primitives.serialization").Encoding.PEM
    return certificate.public_bytes(encoding).decode()
