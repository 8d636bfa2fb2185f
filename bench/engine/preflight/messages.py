"""Preflight of the messages: who is told, and whether the secrets for that are there."""

from __future__ import annotations

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import listed, plain_name
from gyrobench.bench.messages.delivery import read_secret
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.receivers import Receiver
from gyrobench.bench.station.station import Station


def message_checks(station: Station) -> list[Check]:
    """Look at each receiver; nothing is sent."""
    return [_check(receiver) for receiver in station.file.messages]


def _check(receiver: Receiver) -> Check:
    what = receiver.kind
    try:
        read_secret(receiver)
    except DocumentError as error:
        return Check.of(
            "messages", what, False, str(error), "Put the secret there, or leave the receiver out."
        )
    events = listed([plain_name(event) for event in receiver.on])
    return Check.of("messages", what, True, f"{receiver.address} is told of: {events}", "")
