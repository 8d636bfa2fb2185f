"""The station file's section ``messages``: the receivers of messages about a run, and their addresses.

Every run folder has a copy of the station file, so secrets are not in it: a secret comes from an environment
variable or a file, and ``{secret}`` in an address marks its place.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self, get_args
from urllib.parse import parse_qsl, urlsplit

from pydantic import AfterValidator, Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel

#: Events that a receiver can choose; all receivers get those of the guard.
EventName = Literal["ends", "holds", "resumes", "needs_person", "unit_dropped", "dwells_flagged"]
#: Place of the secret in an address.
SECRET = "{secret}"  # noqa: S105 - the place of one

_ALL: list[EventName] = list(get_args(EventName))
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_SECRET_KEY = re.compile(r"passw|secret|token|credential|key|auth|sig", re.IGNORECASE)
#: A random sequence of letters and digits, longer than words are.
_RANDOM = re.compile(r"(?=[^/]*[0-9])(?=[^/]*[A-Za-z])[A-Za-z0-9_@-]{20,}")
_MAIL = re.compile(r"[^\s@,;<>]{1,64}@[A-Za-z0-9.-]{1,190}")
_WHERE = (
    f"every run folder has a copy of this file. Write {SECRET} in its place and give secret_file or "
    "secret_env"
)


def _http_address(address: str) -> str:
    try:
        parts = urlsplit(address)
        host, _ = parts.hostname, parts.port  # raises if the port is not a number
    except ValueError as error:
        raise ValueError(f"not an address: {error}") from error
    if parts.scheme not in ("http", "https") or not host or not address.isprintable() or " " in address:
        raise ValueError("an address begins with https:// or http:// and a host")
    if parts.username is not None:
        raise ValueError(f"an address can't hold a user or password: {_WHERE}")
    for key, value in parse_qsl(parts.query):
        if _SECRET_KEY.search(key) and value != SECRET:
            raise ValueError(f"'{key}' in the address looks like a secret: {_WHERE}")
    if any(_RANDOM.fullmatch(word) for word in re.split(r"[/?&=]", parts.path + "?" + parts.query)):
        raise ValueError(f"a part of the address looks like a secret: {_WHERE}")
    return address


def _absolute(path: str) -> str:
    if not Path(path).is_absolute():
        raise ValueError("must be an absolute path: a resumed run reads this file from its run folder")
    return path


def _mail_address(address: str) -> str:
    if not _MAIL.fullmatch(address):
        raise ValueError("expected a mail address, name@host")
    return address


HttpAddress = Annotated[str, Field(max_length=1000), AfterValidator(_http_address)]
MailAddress = Annotated[str, AfterValidator(_mail_address)]


class _Receiver(StrictModel):
    """Keys of all receivers."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"most_per_hour": "max_per_hour"}
    renamed_values: ClassVar[Mapping[str, Mapping[str, str]]] = {"on": {"goes_on": "resumes"}}

    kind: str
    address: str
    on: list[EventName] = Field(
        _ALL,
        min_length=1,
        description="events that cause a message. ends: the run ends; holds: it holds until all values are "
        "good again; resumes: it resumes after a hold; needs_person: it waits for an operator's confirmation "
        "or answer; unit_dropped: one of several units is dropped; dwells_flagged: three successive dwells "
        "of a unit are flagged. A message is always sent after the guard brought the bench to its safe state",
    )
    max_per_hour: int = Field(6, ge=1, le=60, description="messages per hour about the same event")
    secret_env: str | None = Field(
        None, pattern="^[A-Za-z_][A-Za-z0-9_]{0,99}$", description="environment variable with the secret"
    )
    secret_file: Annotated[str, AfterValidator(_absolute)] | None = Field(
        None, description="absolute path of a file whose first line is the secret"
    )

    @property
    def name(self) -> str:
        """Kind and address: "ntfy https://ntfy.example/bench"."""
        return f"{self.kind} {self.address}"

    @property
    def has_secret(self) -> bool:
        """Whether it needs a secret."""
        return self.secret_env is not None or self.secret_file is not None

    @model_validator(mode="after")
    def _check_secret(self) -> Self:
        if self.secret_env is not None and self.secret_file is not None:
            raise ValueError("give one of secret_env and secret_file")
        if SECRET in self.address and not self.has_secret:
            raise ValueError(f"{SECRET} in the address needs secret_file or secret_env")
        return self


class _HttpReceiver(_Receiver):
    """A receiver reached by HTTP."""

    @model_validator(mode="after")
    def _check_encryption(self) -> Self:
        parts = urlsplit(self.address)
        if self.has_secret and parts.scheme != "https" and parts.hostname not in _LOOPBACK:
            raise ValueError("a secret is sent over https:// only")
        return self


class Webhook(_HttpReceiver):
    """A server that receives messages as JSON."""

    kind: Literal["webhook"]
    address: HttpAddress = Field(
        description=f"address for the POST of JSON; a secret replaces {SECRET} in it, otherwise it goes to "
        "the header Authorization: Bearer"
    )


class Ntfy(_HttpReceiver):
    """A topic of an ntfy server."""

    kind: Literal["ntfy"]
    address: HttpAddress = Field(
        description=f"server and topic, https://HOST/TOPIC; the secret is an access token, or the topic "
        f"if the address has {SECRET} in its place"
    )

    @model_validator(mode="after")
    def _check_topic(self) -> Self:
        if not urlsplit(self.address).path.strip("/"):
            raise ValueError("the address lacks the topic: https://HOST/TOPIC")
        return self


class Email(_Receiver):
    """A mailbox, by way of a mail server."""

    kind: Literal["email"]
    address: MailAddress = Field(description="recipient")
    sender: MailAddress = Field(description="sender")
    server: str = Field(pattern=r"^[A-Za-z0-9.:-]{1,200}$", description="host of the mail server")
    port: int = Field(587, ge=1, le=65535, description="its port")
    security: Literal["starttls", "tls", "none"] = Field(
        "starttls", description="encryption: by STARTTLS, from the start, or none"
    )
    user: str | None = Field(
        None, min_length=1, max_length=200, description="user name for the login; the secret is its password"
    )

    @model_validator(mode="after")
    def _check_login(self) -> Self:
        if (self.user is not None) != self.has_secret:
            raise ValueError("a login needs user, and secret_file or secret_env for its password")
        if self.user is not None and self.security == "none" and self.server not in _LOOPBACK:
            raise ValueError("a password is sent over starttls or tls only")
        return self


Receiver = Annotated[Webhook | Ntfy | Email, Field(discriminator="kind")]
