"""Messages sent by threads, against real servers."""

import json
import threading
import time
from dataclasses import replace

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.messages.messenger import Messenger, Quota, send_test
from tests.bench.messages.made_up import ENDS, NEEDS_PERSON
from tests.bench.messages.servers import free_port, wait_for


class Record:
    """What would be journaled."""

    def __init__(self):
        self.entries = []

    def __call__(self, event, **details):
        self.entries.append((event, details))

    @property
    def events(self):
        return [event for event, _ in self.entries]


def test_each_receiver_gets_the_events_of_its_choice(serve, receiver):
    all_of_it, ends = serve(), serve()
    receivers = [
        receiver(kind="webhook", address=all_of_it.url),
        receiver(kind="webhook", address=ends.url, on=["ends"]),
    ]
    record = Record()
    with Messenger(receivers, record, patience_s=20.0) as messenger:
        messenger.send(NEEDS_PERSON, "chamber")
        messenger.send(ENDS, "finished")
        messenger.send(replace(ENDS, event="guard_acted", ended=""), "")
    assert [json.loads(body)["event"] for _, _, body in all_of_it.received] == [
        "needs_person",
        "ends",
        "guard_acted",
    ]
    assert [json.loads(body)["event"] for _, _, body in ends.received] == ["ends", "guard_acted"]
    assert record.events == ["message_sent"] * 5
    first = next(details for _, details in record.entries if details["about"] == "needs_person")
    assert first | {"to": ""} == {"to": "", "about": "needs_person", "answer": "200 OK", "attempts": 1}


def test_sending_never_waits_for_a_server_that_hangs(serve, receiver):
    hanging, good = serve("hang"), serve()
    receivers = [receiver(kind="webhook", address=each.url) for each in (hanging, good)]
    record = Record()
    with Messenger(receivers, record) as messenger:
        messenger.send(ENDS, "finished")
        wait_for(lambda: good.received and hanging.received)
        wait_for(lambda: record.events == ["message_sent"])
    assert record.events == ["message_sent", "message_not_sent"]
    assert record.entries[1][1]["why"] == "the process ended first"


def test_a_server_that_has_troubles_is_tried_again_until_it_takes_the_message(serve, receiver):
    server = serve(500, 503)
    record = Record()
    with Messenger(
        [receiver(kind="webhook", address=server.url)], record, 20.0, pauses_s=(0.01,)
    ) as messenger:
        messenger.send(ENDS, "finished")
        wait_for(lambda: "message_sent" in record.events)
    assert record.events == ["message_delayed", "message_sent"]
    assert "500" in record.entries[0][1]["why"]
    assert record.entries[1][1]["attempts"] == 3


def test_a_server_that_is_down_gets_all_in_order_when_it_comes_back(serve, receiver):
    port, record = free_port(), Record()
    address = f"http://127.0.0.1:{port}"
    with Messenger([receiver(kind="webhook", address=address)], record, 20.0, (0.05,)) as messenger:
        messenger.send(NEEDS_PERSON, "chamber")
        messenger.send(ENDS, "finished")
        wait_for(lambda: record.events == ["message_delayed"])
        server = serve(port=port)
        wait_for(lambda: record.events.count("message_sent") == 2)
    assert [json.loads(body)["event"] for _, _, body in server.received] == ["needs_person", "ends"]


def test_leaving_does_not_wait_for_a_pause_between_attempts(serve, receiver):
    server, record = serve(500), Record()
    with Messenger([receiver(kind="webhook", address=server.url)], record, 20.0, (3600.0,)) as messenger:
        messenger.send(ENDS, "finished")
        wait_for(lambda: record.events == ["message_delayed"])
    assert record.events == ["message_delayed", "message_sent"]


def test_what_could_not_be_sent_until_the_end_is_recorded(receiver):
    record = Record()
    address = f"http://127.0.0.1:{free_port()}"
    with Messenger([receiver(kind="webhook", address=address)], record, 0.3, (3600.0,)) as messenger:
        messenger.send(ENDS, "finished")
        wait_for(lambda: record.events)
    assert record.events == ["message_delayed", "message_not_sent"]
    before = list(record.entries)
    time.sleep(0.1)
    assert record.entries == before


def test_a_refusal_is_not_tried_again_and_the_next_message_is_sent(serve, receiver):
    server, record = serve(404), Record()
    with Messenger([receiver(kind="webhook", address=server.url)], record, 20.0) as messenger:
        messenger.send(ENDS, "finished")
        messenger.send(NEEDS_PERSON, "chamber")
    assert record.events == ["message_not_sent", "message_sent"]
    assert len(server.received) == 2


def test_the_same_event_is_not_sent_more_often_than_allowed(serve, receiver):
    server, record = serve(), Record()
    hook = receiver(kind="webhook", address=server.url, max_per_hour=2)
    with Messenger([hook], record, 20.0) as messenger:
        for _ in range(4):
            messenger.send(NEEDS_PERSON, "chamber")
        messenger.send(NEEDS_PERSON, "table")
    assert len(server.received) == 3
    assert record.events.count("message_withheld") == 2


def test_without_receivers_there_is_nothing_to_wait_for(receiver):
    before = threading.active_count()
    idle = receiver(kind="webhook", address="http://127.0.0.1:9")
    with Messenger([idle], Record(), 60.0), Messenger([], Record(), 60.0) as messenger:
        messenger.send(ENDS, "finished")
        assert threading.active_count() == before


def test_the_hour_slides():
    quota = Quota(2)
    assert [quota.lets_pass("a", now_s) for now_s in (0.0, 1800.0, 3599.0, 3600.0, 3601.0, 5400.0)] == [
        True,
        True,
        False,
        True,
        False,
        True,
    ]


def test_what_is_not_the_same_has_an_hour_of_its_own():
    quota = Quota(1)
    assert quota.lets_pass("a", 0.0)
    assert quota.lets_pass("b", 0.0)
    assert not quota.lets_pass("a", 1.0)


@pytest.fixture
def station_with(tmp_path):
    """Write the shipped emulated station with these receivers."""

    def write(*receivers):
        path = tmp_path / "station.yaml"
        listed = "".join(f"  - {each}\n" for each in receivers)
        text = find_document("stations", "emulated").read_text()
        path.write_text(f"{text}\nmessages:\n{listed}" if receivers else text)
        return path

    return write


def test_every_receiver_gets_the_text_and_every_reply_is_returned(serve, station_with):
    server = serve()
    down = f"http://127.0.0.1:{free_port()}"
    station = station_with(
        f"{{kind: ntfy, address: '{server.url}/bench', on: [ends]}}", f"{{kind: webhook, address: '{down}'}}"
    )
    first, second = send_test(str(station), "Hello.")
    assert (first.is_sent, first.reply) == (True, "200 OK")
    assert first.receiver == f"ntfy {server.url}/bench"
    assert server.received[0][2].decode().startswith("Hello.")
    assert not second.is_sent
    assert "refused" in second.reply


def test_a_station_without_receivers_is_reported(station_with):
    with pytest.raises(
        DocumentError, match=r"station.yaml:\d+:1: no receivers: the section `messages` is missing"
    ):
        send_test(str(station_with()), "Hello.")
