"""Bringing a message to one receiver, now."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from types import MappingProxyType
from typing import Any

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.messages.mail import send_mail
from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.post import post_ntfy, post_webhook
from gyrobench.bench.messages.secret import read_secret, without_secret
from gyrobench.bench.messages.undelivered import UndeliveredError
from gyrobench.bench.station.messages import Receiver

#: The whole exchange, from the name of the host to the end of the answer.
LONGEST_S = 30.0

_SEND: Mapping[str, Callable[[Any, str, Message], str]] = MappingProxyType(
    {"webhook": post_webhook, "ntfy": post_ntfy, "email": send_mail}
)


def deliver(receiver: Receiver, message: Message) -> str:
    """Deliver a message; returns what the receiver answered.

    It may take half a minute where the receiver does not answer.

    Raises
    ------
    UndeliveredError
        It could not be delivered, and why.
    """
    try:
        secret = read_secret(receiver)
    except DocumentError as error:  # somebody may put the secret in its place yet
        raise UndeliveredError(str(error), is_final=False) from error
    try:
        answer = _in_time(lambda: _SEND[receiver.kind](receiver, secret, message))
    except UndeliveredError as error:
        raise UndeliveredError(without_secret(secret, str(error)), error.is_final) from None
    except ValueError as error:  # an address or secret that the protocol can't carry
        raise UndeliveredError(without_secret(secret, str(error)), is_final=True) from None
    return without_secret(secret, answer)


def _in_time(exchange: Callable[[], str]) -> str:
    """Carry out an exchange, but wait no longer than :data:`LONGEST_S` for all of it.

    The time-outs of sockets are for one piece each: a name that is not found, or a server that sends
    letter by letter, could hold things up for ever. An exchange that is given up ends with its thread.
    """
    outcome: Future[str] = Future()

    def carry_out() -> None:
        try:
            outcome.set_result(exchange())
        except Exception as error:  # noqa: BLE001 - raised where it is waited for
            outcome.set_exception(error)

    threading.Thread(target=carry_out, name="one message", daemon=True).start()
    try:
        return outcome.result(LONGEST_S)
    except TimeoutError:
        raise UndeliveredError(f"no answer within {LONGEST_S:g} s", is_final=False) from None
