"""Bringing a message to one receiver, now."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from bench.errors import DocumentError
from bench.messages.mail import send_mail
from bench.messages.message import Message
from bench.messages.post import post_ntfy, post_webhook
from bench.messages.secret import read_secret
from bench.messages.undelivered import UndeliveredError
from bench.station.messages import Receiver

_SEND: Mapping[str, Callable[[Any, str, Message], str]] = MappingProxyType(
    {"webhook": post_webhook, "ntfy": post_ntfy, "email": send_mail}
)


def deliver(receiver: Receiver, message: Message) -> str:
    """Deliver a message; returns what the receiver answered.

    It may take some ten seconds where the receiver does not answer.

    Raises
    ------
    UndeliveredError
        It could not be delivered, and why.
    """
    try:
        return _SEND[receiver.kind](receiver, read_secret(receiver), message)
    except DocumentError as error:  # somebody may put the secret in its place yet
        raise UndeliveredError(str(error), is_final=False) from error
    except ValueError as error:  # an address or secret that the protocol can't carry
        raise UndeliveredError(str(error), is_final=True) from error
