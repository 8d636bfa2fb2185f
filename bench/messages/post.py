"""Webhook and ntfy: one HTTP POST.

References
----------
ntfy documentation, "Publishing": the message is the body, title, priority and tags are headers.
"""

from __future__ import annotations

import http.client
import json
import urllib.error
import urllib.request
from email.header import Header
from typing import Any
from urllib.parse import quote

from gyrobench.bench import __version__
from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.secret import server_words
from gyrobench.bench.messages.undelivered import UndeliveredError
from gyrobench.bench.station.messages import SECRET, Ntfy, Webhook

#: A server that says nothing for so long is given up for now.
TIMEOUT_S = 10.0
#: ntfy makes an attachment of what is longer.
_NTFY_BYTES = 4000
_TOO_MANY, _TIMED_OUT = 429, 408
#: So much of an answer is read, far more than is shown: a secret must not be cut in two.
_READ_BYTES = 65_536


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A redirected POST would become a GET that tells nobody anything, or take the secret elsewhere."""

    def redirect_request(self, *_: Any) -> None:
        """Follow nowhere."""
        return


def post_webhook(receiver: Webhook, secret: str, message: Message) -> str:
    """Post a message as JSON; returns the server's answer."""
    body = json.dumps(message.to_json()).encode()
    return _post(receiver.address, secret, body, {"Content-Type": "application/json"})


def post_ntfy(receiver: Ntfy, secret: str, message: Message) -> str:
    """Post a message to a topic; returns the server's answer."""
    headers = {
        "Title": _header(message.title),
        "Priority": "urgent" if message.is_urgent else "default",
        "Tags": _tag(message),
        "Content-Type": "text/plain; charset=utf-8",
    }
    body = message.text.encode()[:_NTFY_BYTES].decode(errors="ignore").encode()
    return _post(receiver.address, secret, body, headers)


def _post(address: str, secret: str, body: bytes, headers: dict[str, str]) -> str:
    headers["User-Agent"] = f"gyrobench/{__version__}"
    if secret and SECRET in address:
        address = address.replace(SECRET, quote(secret, safe="/"))
    elif secret:
        headers["Authorization"] = f"Bearer {secret}"
    request = urllib.request.Request(address, body, headers)  # noqa: S310 - the model allows HTTP alone
    opener = urllib.request.build_opener(_NoRedirect)
    try:
        with opener.open(request, timeout=TIMEOUT_S) as answer:
            return _status(answer.status)
    except urllib.error.HTTPError as error:
        with error:
            said = _first_line(error, secret)
        is_final = error.code < http.HTTPStatus.INTERNAL_SERVER_ERROR
        is_final = is_final and error.code not in (_TOO_MANY, _TIMED_OUT)
        raise UndeliveredError(f"the server answered {_status(error.code)}{said}", is_final) from None
    except urllib.error.URLError as error:
        raise UndeliveredError(_reason(error.reason, secret), is_final=False) from None
    except (OSError, http.client.HTTPException) as error:
        raise UndeliveredError(_reason(error, secret), is_final=False) from None


def _status(code: int) -> str:
    """Code and its meaning by the standard: the server's own words may hold anything."""
    try:
        return f"{code} {http.HTTPStatus(code).phrase}"
    except ValueError:
        return str(code)


def _reason(error: object, secret: str) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {TIMEOUT_S:g} s"
    strerror = getattr(error, "strerror", None)
    return server_words(secret, str(strerror or error)) or type(error).__name__


def _first_line(answer: urllib.error.HTTPError, secret: str) -> str:
    """What the server says beyond its code, in a few words."""
    try:
        text = answer.read(_READ_BYTES).decode(errors="replace")
    except (OSError, http.client.HTTPException):
        return ""
    text = server_words(secret, text)
    return f": {text}" if text else ""


def _header(text: str) -> str:
    """Text as a header can carry it."""
    return text if text.isascii() else Header(text, "utf-8", maxlinelen=10_000).encode()


def _tag(message: Message) -> str:
    """The sign before the title in the ntfy application."""
    if message.is_urgent:
        return "rotating_light"
    return {"ends": "white_check_mark", "holds": "pause_button", "goes_on": "arrow_forward"}.get(
        message.event, "bell"
    )
