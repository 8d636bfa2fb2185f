"""The station file's section ``messages``: who off the bench is told how a run goes, and where.

No secret stands in it, since every run folder has a copy of the station file. A secret comes from an
environment variable or from a file, and ``{secret}`` in an address is where it belongs.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import parse_qsl, urlsplit

from pydantic import AfterValidator, Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel

#: What a receiver can be told of; that the guard had to act is told to all.
EventName = Literal["ends", "holds", "goes_on", "needs_person"]
#: Where the secret goes in an address.
SECRET = "{secret}"  # noqa: S105 - the place of one

_ALL: list[EventName] = ["ends", "holds", "goes_on", "needs_person"]
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_SECRET_KEY = re.compile(r"passw|secret|token|credential|key|auth|sig", re.IGNORECASE)
#: So many characters with letters and digits are no word.
_RANDOM = re.compile(r"(?=[^/]*[0-9])(?=[^/]*[A-Za-z])[A-Za-z0-9_@-]{20,}")
_MAIL = re.compile(r"[^\s@,;<>]{1,64}@[A-Za-z0-9.-]{1,190}")
_WHERE = (
    "every run folder has a copy of this file. "
    f"Write {SECRET} in its place and give secret_file or secret_env"
)


def _http_address(address: str) -> str:
    try:
        parts = urlsplit(address)
        host, _ = parts.hostname, parts.port  # a port that is no number is told here
    except ValueError as error:
        raise ValueError(f"is no address: {error}") from error
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
    """What all receivers have."""

    kind: str
    address: str
    on: list[EventName] = Field(
        default=_ALL,
        min_length=1,
        description="what is told: ends; holds: goes on by itself when all is good; goes_on: after a hold; "
        "needs_person: holds until a person says to go on, or asks something. That the guard made the bench "
        "safe in the place of a run that died is told in any case",
    )
    most_per_hour: int = Field(default=6, ge=1, le=60, description="not more messages of the same in an hour")
    secret_env: str | None = Field(
        default=None,
        pattern="^[A-Za-z_][A-Za-z0-9_]{0,99}$",
        description="environment variable with the secret",
    )
    secret_file: Annotated[str, AfterValidator(_absolute)] | None = Field(
        default=None, description="absolute path of a file whose first line is the secret"
    )

    @property
    def name(self) -> str:
        """Kind and address: "ntfy https://ntfy.example/bench"."""
        return f"{self.kind} {self.address}"

    @property
    def has_secret(self) -> bool:
        """Whether there is a secret to be read."""
        return self.secret_env is not None or self.secret_file is not None

    @model_validator(mode="after")
    def _one_secret(self) -> Self:
        if self.secret_env is not None and self.secret_file is not None:
            raise ValueError("give one of secret_env and secret_file")
        if SECRET in self.address and not self.has_secret:
            raise ValueError(f"{SECRET} in the address needs secret_file or secret_env")
        return self


class _HttpReceiver(_Receiver):
    """A receiver that HTTP reaches."""

    @model_validator(mode="after")
    def _no_secret_in_clear(self) -> Self:
        parts = urlsplit(self.address)
        if self.has_secret and parts.scheme != "https" and parts.hostname not in _LOOPBACK:
            raise ValueError("a secret is sent over https:// only")
        return self


class Webhook(_HttpReceiver):
    """A server that takes messages as JSON."""

    kind: Literal["webhook"]
    address: HttpAddress = Field(
        description=f"address that JSON is posted to; a secret goes where {SECRET} stands in it, else into "
        "the header Authorization: Bearer"
    )


class Ntfy(_HttpReceiver):
    """A topic of an ntfy server."""

    kind: Literal["ntfy"]
    address: HttpAddress = Field(
        description=f"server and topic, https://HOST/TOPIC; the secret is an access token, or the topic "
        f"where {SECRET} stands for it"
    )

    @model_validator(mode="after")
    def _names_a_topic(self) -> Self:
        if not urlsplit(self.address).path.strip("/"):
            raise ValueError("the address lacks the topic: https://HOST/TOPIC")
        return self


class Email(_Receiver):
    """A mailbox, by way of a mail server."""

    kind: Literal["email"]
    address: MailAddress = Field(description="who gets the mail")
    sender: MailAddress = Field(description="whom it comes from")
    server: str = Field(pattern=r"^[A-Za-z0-9.:-]{1,200}$", description="host of the mail server")
    port: int = Field(default=587, ge=1, le=65535, description="its port")
    security: Literal["starttls", "tls", "none"] = Field(
        default="starttls", description="encryption: from STARTTLS on, from the start, or none"
    )
    user: str | None = Field(
        default=None,
        min_length=1,
        max_length=200,
        description="name to log in with; the secret is its password",
    )

    @model_validator(mode="after")
    def _logs_in_with_both(self) -> Self:
        if (self.user is not None) != self.has_secret:
            raise ValueError("a login needs user, and secret_file or secret_env for its password")
        if self.user is not None and self.security == "none" and self.server not in _LOOPBACK:
            raise ValueError("a password is sent over starttls or tls only")
        return self


Receiver = Annotated[Webhook | Ntfy | Email, Field(discriminator="kind")]
