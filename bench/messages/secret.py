"""The secret of a receiver: read when it is needed, kept nowhere."""

from __future__ import annotations

import os
from pathlib import Path

from bench.errors import DocumentError
from bench.reading import read_limited
from bench.station.messages import Receiver

_MAX_BYTES = 10_000


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
