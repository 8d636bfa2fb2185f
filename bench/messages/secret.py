"""The secret of a receiver: read when it is needed, kept nowhere, told nobody."""

from __future__ import annotations

import base64
import html
import json
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, quote_plus

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.station.messages import SECRET, Receiver

_MAX_BYTES = 10_000
#: Fewer letters of Base64 may be a part of any word.
_LEAST_BASE64 = 4
_SHOWN = 200


def read_secret(receiver: Receiver) -> str:
    """Read it; empty where the receiver has none.

    Raises
    ------
    DocumentError
        It is not where the station file says.
    """
    if receiver.secret_env is not None:
        source = f"the environment variable {receiver.secret_env}"
        secret = os.environ.get(receiver.secret_env, "")
    elif receiver.secret_file is not None:
        source = receiver.secret_file
        content = read_limited(Path(source), _MAX_BYTES, DocumentError)
        secret = (content.decode("utf-8", errors="replace").splitlines() or [""])[0]
    else:
        return ""
    if not secret.strip() or not secret.isprintable():
        raise DocumentError(
            f"{source}: holds no secret; the {receiver.kind} receiver {receiver.address} needs it"
        )
    return secret.strip()


def without_secret(secret: str, text: str) -> str:
    """Text with ``{secret}`` in place of the secret, however an address, a header or a page writes it."""
    forms = sorted(set(_written(secret)), key=len, reverse=True) if secret else []
    if not forms:
        return text
    return re.sub("|".join(map(re.escape, forms)), SECRET, text, flags=re.IGNORECASE)


def server_words(secret: str, text: str) -> str:
    """What a server said, on one short line and without the secret.

    Parameters
    ----------
    text : str
        All of it: a secret of which a part is left can't be found.
    """
    shown = without_secret(secret, text)[:_SHOWN]
    return " ".join("".join(letter if letter.isprintable() else " " for letter in shown).split())


def _written(secret: str) -> Iterator[str]:
    for plain in (secret, quote(secret, safe="/"), quote(secret, safe=""), quote_plus(secret)):
        yield plain
        yield html.escape(plain)
        yield json.dumps(plain)[1:-1]
        yield json.dumps(plain)[1:-1].replace("/", r"\/")
        yield repr(plain)[1:-1]
    yield from _base64(secret.encode())


def _base64(data: bytes) -> Iterator[str]:
    """Letters of Base64 that the data make, wherever in something longer they stand."""
    for before in range(3):
        first, end = math.ceil(8 * before / 6), 8 * (before + len(data)) // 6
        letters = base64.b64encode(bytes(before) + data).decode()[first:end]
        if len(letters) >= _LEAST_BASE64:
            yield letters
            yield letters.replace("+", "-").replace("/", "_")
