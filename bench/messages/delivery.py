"""A message, as data and as text, and its delivery to one receiver: by HTTP or e-mail, with its secret.

References
----------
ntfy documentation, "Publishing": the message is the body, title, priority and tags are headers.
"""

from __future__ import annotations

import base64
import html
import http.client
import json
import math
import os
import platform
import re
import smtplib
import ssl
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from email.header import Header
from email.message import EmailMessage
from email.utils import format_datetime, make_msgid
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote, quote_plus

from gyrobench.bench import __version__
from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError, GyrobenchError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.bench.foundations.text import hours_minutes, listed
from gyrobench.bench.station.receivers import SECRET, Email, EventName, Ntfy, Receiver, Webhook
from gyrobench.bench.station.time_limit import LimitedCall

#: Event of a message. Receivers select events with their key ``on``; the last two go to all.
Event = Literal[EventName, "guard_acted", "test"]

#: Names of events in the data of a message, a format that receivers rely on, if they differ.
_NAMES_IN_DATA = {"resumes": "goes_on"}
_EVENT_TEXTS = {
    "ends": "the run has ended",
    "holds": "the run holds",
    "resumes": "the run has resumed",
    "needs_person": "an operator is needed",
    "unit_dropped": "a unit was dropped, the run continues with the others",
    "dwells_flagged": "several successive dwells are flagged, the run continues",
    "guard_acted": "the run died, the guard brought the bench to its safe state",
    "test": "test message",
}


@dataclass(frozen=True)
class Remaining:
    """Remaining time and dwells of a run according to its plan."""

    hours: float
    dwells: int

    @property
    def text(self) -> str:
        """Text such as "44:59 h, 12 dwells"."""
        return f"{hours_minutes(self.hours * S_PER_H)} h, {self.dwells} dwells"


@dataclass(frozen=True)
class Message:
    """One message."""

    event: Event
    why: str  #: Reason of the event.
    station: str
    time: datetime  #: UTC.
    folder: Path | None = None  #: Run folder; None without a run.
    #: procedure, unit: Name of the procedure, serial number of the INS; empty if unknown.
    procedure: str = ""
    unit: str = ""
    ended: str = ""  #: How the run ended: "finished", "stopped" or "failed"; empty while it has not.
    #: question, answers: Question to the operator and the answers to choose from; empty without one.
    question: str = ""
    answers: tuple[str, ...] = ()
    remaining: Remaining | None = None

    @property
    def is_urgent(self) -> bool:
        """Whether an operator has to act."""
        return self.event in ("needs_person", "guard_acted") or self.ended == "failed"

    @property
    def title(self) -> str:
        """One line of printable characters: bench, unit and event."""
        event_text = f"the run {self.ended}" if self.ended else _EVENT_TEXTS[self.event]
        unit = f", unit {self.unit}" if self.unit else ""
        line = f"{self.station}{unit}: {event_text}"
        return "".join(letter if letter.isprintable() else " " for letter in line)

    @property
    def text(self) -> str:
        """The whole message as text."""
        lines = [self.why] if self.why else []
        if self.question:
            choice = listed(self.answers).replace(" and ", " or ")
            lines.append(f"{self.question}\nAnswer {choice} at the terminal of the bench.")
        if lines:
            lines.append("")
        run = f"{self.folder.name} ({self.procedure})" if self.folder and self.procedure else ""
        rows = {
            "Bench": self.station,
            "Unit": self.unit,
            "Run": run,
            "Remaining": self.remaining.text if self.remaining else "",
            "Time": f"{self.time:%Y-%m-%d %H:%M:%S} UTC",
            "Host": platform.node(),
            "Folder": str(self.folder or ""),
        }
        return "\n".join([*lines, *(f"{name:<9} {value}" for name, value in rows.items() if value)])

    def to_json(self) -> dict[str, Any]:
        """Plain data, always with the same keys; null if unknown."""
        return {
            "event": _NAMES_IN_DATA.get(self.event, self.event),
            "run": self.folder.name if self.folder else None,
            "unit": self.unit or None,
            "station": self.station,
            "procedure": self.procedure or None,
            "ended": self.ended or None,
            "why": self.why,
            "question": self.question or None,
            "answers": list(self.answers),
            "time": self.time.isoformat(),
            "host": platform.node(),
            "folder": str(self.folder) if self.folder else None,
            "left": {"hours": round(self.remaining.hours, 3), "dwells": self.remaining.dwells}
            if self.remaining
            else None,
            "urgent": self.is_urgent,
            "title": self.title,
            "text": self.text,
        }


class UndeliveredError(GyrobenchError):
    """A message could not be delivered.

    The message gives the reason without the secret; ``is_final``: whether a new attempt would be useless.
    """

    def __init__(self, message: str, is_final: bool) -> None:
        super().__init__(message)
        self.is_final = is_final


_MAX_BYTES = 10_000
#: Minimum number of Base64 letters to replace: fewer may occur in any word.
_MIN_BASE64 = 4
_MAX_SHOWN = 200


def read_secret(receiver: Receiver) -> str:
    """Read the secret of a receiver; empty if it has none.

    Raises DocumentError if it is missing in the variable or file that the station file names.
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
            f"{source}: no secret found; the {receiver.kind} receiver {receiver.address} needs one"
        )
    return secret.strip()


def missing_secrets(receivers: Iterable[Receiver]) -> Iterator[str]:
    """Yield a note for each receiver that gets no message because its secret is missing."""
    for receiver in receivers:
        try:
            read_secret(receiver)
        except DocumentError as error:
            yield f"{receiver.name} gets no message: {error}"


def without_secret(secret: str, text: str) -> str:
    """Replace the secret by ``{secret}`` in every encoding used by addresses, headers or pages."""
    encodings = sorted(set(_encodings_of(secret)), key=len, reverse=True) if secret else []
    if not encodings:
        return text
    return re.sub("|".join(map(re.escape, encodings)), SECRET, text, flags=re.IGNORECASE)


def server_words(secret: str, text: str) -> str:
    """One short line of a server's reply without the secret; ``text`` is the whole reply."""
    shown = without_secret(secret, text)[:_MAX_SHOWN]
    return " ".join("".join(letter if letter.isprintable() else " " for letter in shown).split())


def _encodings_of(secret: str) -> Iterator[str]:
    for plain in (secret, quote(secret, safe="/"), quote(secret, safe=""), quote_plus(secret)):
        yield plain
        yield html.escape(plain)
        yield json.dumps(plain)[1:-1]
        yield json.dumps(plain)[1:-1].replace("/", r"\/")
        yield repr(plain)[1:-1]
    yield from _base64_forms(secret.encode())


def _base64_forms(data: bytes) -> Iterator[str]:
    """Base64 letters of the data at each possible offset inside longer data."""
    for offset in range(3):
        first, end = math.ceil(8 * offset / 6), 8 * (offset + len(data)) // 6
        letters = base64.b64encode(bytes(offset) + data).decode()[first:end]
        if len(letters) >= _MIN_BASE64:
            yield letters
            yield letters.replace("+", "-").replace("/", "_")


#: Time limit of one operation on a socket.
TIMEOUT_S = 10.0
#: Mail servers refuse permanently with codes from here on.
_PERMANENT = 500


def _send_mail(receiver: Email, password: str, message: Message) -> str:
    """Send an e-mail through the receiver's mail server; returns the server's answer."""
    mail = EmailMessage()
    mail["From"], mail["To"] = receiver.sender, receiver.address
    mail["Subject"] = f"gyrobench {message.title}"
    mail["Date"] = format_datetime(message.time)
    mail["Message-ID"] = make_msgid("gyrobench", receiver.sender.rpartition("@")[2])
    if message.is_urgent:
        mail["Importance"] = "high"
    mail.set_content(message.text + "\n")
    try:
        with _mail_server(receiver) as server:
            if receiver.security == "starttls":
                server.starttls(context=ssl.create_default_context())
            if receiver.user is not None:
                server.login(receiver.user, password)
            server.send_message(mail)
            return f"taken by {receiver.server}"
    except smtplib.SMTPRecipientsRefused as error:
        code, reply = next(iter(error.recipients.values()))
        raise _refusal_error(code, reply, password) from None
    except smtplib.SMTPResponseException as error:
        raise _refusal_error(error.smtp_code, error.smtp_error, password) from None
    except smtplib.SMTPNotSupportedError as error:
        raise UndeliveredError(str(error), is_final=True) from None
    except TimeoutError:
        raise UndeliveredError(f"no answer within {TIMEOUT_S:g} s", is_final=False) from None
    except (OSError, smtplib.SMTPException) as error:
        text = server_words(password, str(getattr(error, "strerror", None) or error))
        raise UndeliveredError(text, is_final=False) from None


def _mail_server(receiver: Email) -> smtplib.SMTP:
    if receiver.security == "tls":
        context = ssl.create_default_context()
        return smtplib.SMTP_SSL(receiver.server, receiver.port, timeout=TIMEOUT_S, context=context)
    return smtplib.SMTP(receiver.server, receiver.port, timeout=TIMEOUT_S)


def _refusal_error(code: int, reply: bytes | str, password: str) -> UndeliveredError:
    text = reply.decode(errors="replace") if isinstance(reply, bytes) else reply
    answer = f"{code} {server_words(password, text)}".strip()
    return UndeliveredError(f"the mail server answered {answer}", is_final=code >= _PERMANENT)


#: ntfy converts a longer message to an attachment.
_NTFY_BYTES = 4000
#: Names of the symbols before titles in the ntfy application.
_NTFY_TAGS = {"ends": "white_check_mark", "holds": "pause_button", "resumes": "arrow_forward"}
_TOO_MANY, _TIMED_OUT = 429, 408
#: Bytes read of a reply: far more than shown, so that no part of a secret remains at its end.
_READ_BYTES = 65_536


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirect: a redirected POST would become an empty GET, or send the secret elsewhere."""

    def redirect_request(self, *_: Any) -> None:
        """Do not follow."""
        return


def _post_webhook(receiver: Webhook, secret: str, message: Message) -> str:
    """Post a message as JSON; returns the server's answer."""
    body = json.dumps(message.to_json()).encode()
    return _post(receiver.address, secret, body, {"Content-Type": "application/json"})


def _post_ntfy(receiver: Ntfy, secret: str, message: Message) -> str:
    """Post a message to a topic; returns the server's answer."""
    title = message.title
    headers = {
        "Title": title if title.isascii() else Header(title, "utf-8", maxlinelen=10_000).encode(),
        "Priority": "urgent" if message.is_urgent else "default",
        "Tags": "rotating_light" if message.is_urgent else _NTFY_TAGS.get(message.event, "bell"),
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
            first_line = _first_line(error, secret)
        is_final = error.code < http.HTTPStatus.INTERNAL_SERVER_ERROR
        is_final = is_final and error.code not in (_TOO_MANY, _TIMED_OUT)
        raise UndeliveredError(f"the server answered {_status(error.code)}{first_line}", is_final) from None
    except urllib.error.URLError as error:
        raise UndeliveredError(_reason(error.reason, secret), is_final=False) from None
    except (OSError, http.client.HTTPException) as error:
        raise UndeliveredError(_reason(error, secret), is_final=False) from None


def _status(code: int) -> str:
    """Code and its standard phrase; the server's phrase may contain anything."""
    return f"{code} {http.client.responses.get(code, '')}".strip()


def _reason(error: object, secret: str) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {TIMEOUT_S:g} s"
    strerror = getattr(error, "strerror", None)
    return server_words(secret, str(strerror or error)) or type(error).__name__


def _first_line(answer: urllib.error.HTTPError, secret: str) -> str:
    """First words of the reply's text."""
    try:
        text = answer.read(_READ_BYTES).decode(errors="replace")
    except (OSError, http.client.HTTPException):
        return ""
    text = server_words(secret, text)
    return f": {text}" if text else ""


#: Time limit of the whole exchange, from the host's name to the end of the reply. Time-outs of sockets
#: apply to single operations: a slow name server, or a server that sends byte by byte, could take forever.
MAX_EXCHANGE_S = 30.0

_SEND: dict[str, Callable[[Any, str, Message], str]] = {
    "webhook": _post_webhook,
    "ntfy": _post_ntfy,
    "email": _send_mail,
}


def deliver(receiver: Receiver, message: Message) -> str:
    """Deliver a message and return the receiver's reply, within :data:`MAX_EXCHANGE_S`.

    Raises UndeliveredError if it could not be delivered.
    """
    try:
        secret = read_secret(receiver)
    except DocumentError as error:  # a file may be provided later
        raise UndeliveredError(str(error), is_final=receiver.secret_env is not None) from error
    try:
        send = _SEND[receiver.kind]
        call = LimitedCall(
            WallClock(), MAX_EXCHANGE_S, receiver.name, lambda: send(receiver, secret, message)
        )
        answer = call.result()
    except UndeliveredError as error:
        raise UndeliveredError(without_secret(secret, str(error)), error.is_final) from None
    except ConnectionFailedError:
        raise UndeliveredError(f"no answer within {MAX_EXCHANGE_S:g} s", is_final=False) from None
    except ValueError as error:  # an address or secret that the protocol can't carry
        raise UndeliveredError(without_secret(secret, str(error)), is_final=True) from None
    return without_secret(secret, answer)
