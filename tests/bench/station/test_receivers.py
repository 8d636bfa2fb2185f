import pytest

from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station_file import StationFile

TEXT = find_document("stations", "emulated").read_text()


def load(*receivers, tmp="s.yaml"):
    listed = "".join(f"  - {each}\n" for each in receivers)
    return validate(parse_document(f"{TEXT}\nmessages:\n{listed}", tmp), StationFile).messages


def test_all_kinds_are_read_with_what_they_leave_out():
    webhook, ntfy, mail = load(
        '{kind: webhook, address: "https://hooks.example.org/{secret}", secret_file: /etc/bench/hook}',
        "{kind: ntfy, address: https://ntfy.example.org/bench-2, on: [ends, needs_person], max_per_hour: 2}",
        "{kind: email, address: a@example.org, sender: b@example.org, server: mail.example.org}",
    )
    assert webhook.on == ["ends", "holds", "resumes", "needs_person", "unit_dropped", "dwells_flagged"]
    assert webhook.max_per_hour == 6
    assert ntfy.on == ["ends", "needs_person"]
    assert (mail.port, mail.security, mail.user) == (587, "starttls", None)


@pytest.mark.parametrize(
    ("entry", "problem"),
    [
        ("kind: webhook, address: 'https://me:pw@host/x'", "user or password"),
        ("kind: webhook, address: 'https://host/x?token=abc'", "'token' in the address looks like a secret"),
        ("kind: webhook, address: 'https://host/services/T00/x8Fq2Lk9Zp0aWn4RtY7u'", "looks like a secret"),
        ("kind: webhook, address: 'https://host/{secret}'", "needs secret_file or secret_env"),
        ("kind: webhook, address: 'https://host/', token: abc", "unknown key 'token'"),
        ("kind: webhook, address: 'ftp://host/'", "https:// or http://"),
        ("kind: webhook, address: 'http://host:port/'", "not an address"),
        ("kind: webhook, address: 'http://host/', secret_env: A", "over https:// only"),
        ("kind: webhook, address: 'https://host/', secret_env: A, secret_file: /b", "one of"),
        ("kind: webhook, address: 'https://host/', secret_file: b", "absolute path"),
        ("kind: ntfy, address: 'https://host'", "lacks the topic"),
        ("kind: email, address: a, sender: b@c, server: d", "a mail address"),
        ("kind: email, address: a@b, sender: b@c, server: d, user: e", "secret_file or secret_env"),
        (
            "kind: email, address: a@b, sender: b@c, server: d, user: e, secret_env: F, security: none",
            "starttls or tls only",
        ),
        ("kind: pager, address: x", "unknown kind 'pager'; allowed here: webhook, ntfy, email"),
        ("kind: ntfy, address: 'https://host/t', on: []", "at least 1 item"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(entry, problem):
    line = TEXT.count("\n") + 3
    with pytest.raises(DocumentError, match=rf"s.yaml:{line}:") as caught:
        load(f"{{{entry}}}")
    assert problem in str(caught.value)


def test_a_secret_may_go_in_clear_to_this_very_machine():
    (hook,) = load("{kind: webhook, address: 'http://127.0.0.1:8080/', secret_env: A}")
    assert hook.has_secret


def test_the_receivers_of_the_example_can_be_used_as_they_stand():
    example = find_document("stations", "example_bench").read_text()
    commented = example[example.index("# messages:") :].splitlines()
    text = "\n".join(line.removeprefix("# ") for line in commented)
    station = validate(parse_document(f"{TEXT}\n{text}\n", "s.yaml"), StationFile)
    assert [each.kind for each in station.messages] == ["ntfy", "webhook", "email"]
