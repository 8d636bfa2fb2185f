"""A test message, sent at once to everybody."""

from __future__ import annotations

from dataclasses import dataclass

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.documents import Problem
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.messages.delivery import deliver
from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.undelivered import UndeliveredError
from gyrobench.bench.station.document import load_station_file
from gyrobench.bench.station.messages import Receiver


@dataclass(frozen=True)
class Attempt:
    """What came of a message to one receiver."""

    receiver: str
    is_sent: bool
    said: str


def send_test(station: str, text: str) -> list[Attempt]:
    """Send a test message to all receivers of a station, one after the other, each once.

    Parameters
    ----------
    station : str
        Station file, or the name of a shipped one.

    Raises
    ------
    DocumentError
        The station file is wrong, or names no receiver.
    """
    document, file = load_station_file(find_document("stations", station))
    if not file.messages:
        raise document.error([Problem((), "has no `messages`, so there is nobody to tell anything")])
    message = Message("test", text, file.station, WallClock().utc())
    return [_attempt(receiver, message) for receiver in file.messages]


def _attempt(receiver: Receiver, message: Message) -> Attempt:
    try:
        return Attempt(receiver.name, True, deliver(receiver, message))
    except UndeliveredError as error:
        return Attempt(receiver.name, False, str(error))
