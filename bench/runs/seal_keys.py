"""Ed25519 keys of seals: they are made, loaded from PEM files, sign and verify.

All of it needs the extra ``certificate``.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shlex
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrobench.bench.foundations.documents import log_once
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError, UnusablePathError
from gyrobench.bench.foundations.files import read_limited, write_error, write_whole
from gyrobench.bench.foundations.packages import require

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

#: Environment variables: file of the key that signs seals (PEM), and its password if it has one.
KEY_VARIABLE, PASSWORD_VARIABLE = "GYROBENCH_SEAL_KEY", "GYROBENCH_KEY_PASSWORD"
_MAX_KEY_BYTES = 1_000_000
_READABLE_BY_OTHERS = stat.S_IRGRP | stat.S_IROTH


def new_key(path: Path) -> Path:
    """Make an Ed25519 key pair for seals: a private key, readable only by its owner, and FILE.pub beside it.

    Returns the path of the public key. Raises RunFolderError if a file exists or can't be written.
    """
    ed25519 = require("cryptography.hazmat.primitives.asymmetric.ed25519")
    serialization = require("cryptography.hazmat.primitives.serialization")
    public = path.with_name(path.name + ".pub")
    if path.exists() or public.exists():
        raise UnusablePathError(f"{path}: a key of this name exists. Choose another name")
    private_key = ed25519.Ed25519PrivateKey.generate()
    pem = serialization.Encoding.PEM
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise write_error(path, error) from error
    with open(descriptor, "wb") as stream:  # noqa: PTH123 - a descriptor
        stream.write(
            private_key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
        )
    key_format = serialization.PublicFormat.SubjectPublicKeyInfo
    write_whole(public, private_key.public_key().public_bytes(pem, key_format))
    return public


def signature_problem(text: bytes, signature: Mapping[str, Any], key: bytes, trusted: bytes | None) -> str:
    """Problem of the signature of a seal; empty if there is none."""
    if hashlib.sha256(text).hexdigest() != signature["sha256"]:
        return "was changed: its hash does not fit"
    if trusted is not None and key != trusted:
        return "is not signed by the trusted key"
    if not key:
        return ""
    invalid = require("cryptography.exceptions").InvalidSignature
    ed25519 = require("cryptography.hazmat.primitives.asymmetric.ed25519")
    try:
        ed25519.Ed25519PublicKey.from_public_bytes(key).verify(base64.b64decode(signature["signature"]), text)
    except invalid:
        return "was changed: its signature does not fit"
    return ""


def signature_of(text: bytearray, key: Path | None) -> dict[str, str]:
    """Signature of a seal; the reason in place of it if no key is given or usable."""
    configured = os.environ.get(KEY_VARIABLE, "")
    if key is None and not configured:
        return {"unsigned": f"no key; {KEY_VARIABLE} names one"}
    try:
        private_key = _load_key(key or Path(configured))
    except GyrobenchError as error:
        if key is not None:
            raise
        return {"unsigned": str(error)}
    public = base64.b64encode(private_key.public_key().public_bytes_raw()).decode()
    return {
        "algorithm": "Ed25519",
        "public_key": public,
        "signature": base64.b64encode(private_key.sign(text)).decode(),
    }


def require_usable_key() -> None:
    """Raise DocumentError if GYROBENCH_SEAL_KEY names a key that can't sign."""
    if configured := os.environ.get(KEY_VARIABLE):
        _load_key(Path(configured))


def _load_key(path: Path) -> Ed25519PrivateKey:
    """Load an Ed25519 key, with its password in GYROBENCH_KEY_PASSWORD if any; raises DocumentError."""
    ed25519 = require("cryptography.hazmat.primitives.asymmetric.ed25519")
    try:
        key = pem_key(read_private_key(path))
    except (ValueError, TypeError) as error:
        raise DocumentError(f"{path}: is not a private key that can be read: {error}") from error
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise DocumentError(f"{path}: is not an Ed25519 key. Make one with: gyrobench seal --new-key FILE")
    return key  # type: ignore[no-any-return]


def read_private_key(path: Path) -> bytes:
    """Content of the file of a private key, and a warning if others can read it; raises DocumentError."""
    content = read_limited(path, _MAX_KEY_BYTES, DocumentError)
    if path.stat().st_mode & _READABLE_BY_OTHERS:
        log_once(
            f"{path}: other users can read this private key, and sign with it. Take that from them: "
            f"chmod 600 {shlex.quote(str(path))}"
        )
    return content


def pem_key(content: bytes) -> Any:
    """Private key in PEM, its password in GYROBENCH_KEY_PASSWORD if any; raises ValueError or TypeError."""
    load = require("cryptography.hazmat.primitives.serialization").load_pem_private_key
    password = os.environ.get(PASSWORD_VARIABLE, "").encode() or None
    try:
        return load(content, password)
    except TypeError:  # also if the password is that of another key, and this one has none
        return load(content, None)


def public_bytes(path: Path) -> bytes:
    """Load a public Ed25519 key from a PEM file; raises DocumentError."""
    serialization = require("cryptography.hazmat.primitives.serialization")
    try:
        key = serialization.load_pem_public_key(read_limited(path, _MAX_KEY_BYTES, DocumentError))
        return key.public_bytes_raw()  # type: ignore[no-any-return]
    except (ValueError, AttributeError) as error:
        raise DocumentError(f"{path}: is not a public Ed25519 key in PEM: {error}") from error
