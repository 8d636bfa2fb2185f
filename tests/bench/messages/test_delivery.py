"""Messages as data and text, their secrets, and their delivery by HTTP and e-mail to real servers."""

import base64
import email
import html
import http
import json
import socket
import ssl
import subprocess
from dataclasses import replace
from email.policy import default
from pathlib import Path
from urllib.parse import quote, quote_plus, unquote_to_bytes

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult, LoginPassword

from gyrobench.bench.messages import delivery
from gyrobench.bench.messages.delivery import Message, UndeliveredError, deliver, server_words, without_secret
from tests.bench.messages.made_up import ENDS, NEEDS_PERSON
from tests.bench.messages.servers import free_port


def test_data_have_the_same_keys_for_every_event():
    bare = Message("test", "A test.", "bench_2", ENDS.time)
    assert bare.to_json().keys() == NEEDS_PERSON.to_json().keys() == ENDS.to_json().keys()
    assert json.loads(json.dumps(NEEDS_PERSON.to_json())) == NEEDS_PERSON.to_json()
    assert bare.to_json()["run"] is None


def test_data_state_what_where_when_and_what_is_left():
    data = NEEDS_PERSON.to_json()
    assert data["event"] == "needs_person"
    assert (data["run"], data["folder"]) == ("fig7-001", "/data/runs/fig7-001")
    assert (data["unit"], data["station"], data["procedure"]) == ("1001", "bench_2", "six_position_fig7")
    assert data["answers"] == ["continue", "abort"]
    assert data["time"] == "2026-03-01T02:30:00+00:00"
    assert data["left"] == {"hours": 31.7, "dwells": 45}
    assert data["urgent"]


def test_the_end_of_a_hold_has_the_name_that_receivers_know():
    assert replace(NEEDS_PERSON, event="resumes").to_json()["event"] == "goes_on"


def test_text_says_what_can_be_answered():
    assert "Answer continue or abort" in NEEDS_PERSON.text
    assert NEEDS_PERSON.why in NEEDS_PERSON.text
    assert "/data/runs/fig7-001" in NEEDS_PERSON.text


def test_title_is_one_printable_line_for_every_name_of_a_unit():
    title = replace(ENDS, unit="10\r\n01").title
    assert title.isprintable()
    assert title.startswith("bench_2, unit 10  01: the run finished")


def test_a_failed_end_is_urgent_and_a_good_one_is_not():
    assert not ENDS.is_urgent
    assert replace(ENDS, ended="failed").is_urgent


def test_a_run_folder_with_a_strange_name_is_reported():
    assert "ü\n" not in replace(ENDS, folder=Path("/x/ü\n")).title


SECRET = "Geheim/Wort+9 x&y"  # noqa: S105 - made up


@pytest.mark.parametrize(
    "written",
    [
        SECRET,
        quote(SECRET, safe="/"),
        quote(SECRET, safe=""),
        quote(SECRET, safe="").lower(),
        quote_plus(SECRET),
        html.escape(SECRET),
        json.dumps(SECRET)[1:-1],
        SECRET.replace("/", r"\/"),
        SECRET.upper(),
    ],
)
def test_it_is_left_out_however_it_is_written(written):
    assert without_secret(SECRET, f"Cannot POST /hook/{written}!") == "Cannot POST /hook/{secret}!"


@pytest.mark.parametrize("user", ["", "a", "ab", "abc"])
def test_it_is_left_out_of_a_login_in_base64(user):
    said = base64.b64encode(f"{user}\0{SECRET}\0".encode()).decode()
    shown = without_secret(SECRET, said)
    assert "{secret}" in shown
    assert len(shown.replace("{secret}", "")) < 12


def test_no_part_of_it_is_left_where_an_answer_is_cut():
    for before in range(150, 220):
        shown = server_words(SECRET, "x" * before + SECRET)
        assert "Geh" not in shown
        assert len(shown) <= 200


def test_without_a_secret_all_is_shown():
    assert without_secret("", "nothing to hide") == "nothing to hide"


def test_words_of_a_server_are_one_printable_line():
    assert server_words("", "a\x1b[2J\r\n\tb  c") == "a [2J b c"


def test_a_webhook_gets_json(serve, receiver):
    server = serve()
    assert deliver(receiver(kind="webhook", address=f"{server.url}/hook"), NEEDS_PERSON) == "200 OK"
    ((path, headers, body),) = server.received
    assert path == "/hook"
    assert headers["Content-Type"] == "application/json"
    assert json.loads(body) == NEEDS_PERSON.to_json()
    assert "Authorization" not in headers


def test_ntfy_gets_text_with_title_priority_and_tag(serve, receiver):
    server = serve()
    deliver(receiver(kind="ntfy", address=f"{server.url}/bench2"), NEEDS_PERSON)
    deliver(receiver(kind="ntfy", address=f"{server.url}/bench2"), ENDS)
    (path, headers, body), (_, later, _) = server.received
    assert path == "/bench2"
    assert headers["Title"] == NEEDS_PERSON.title
    assert (headers["Priority"], headers["Tags"]) == ("urgent", "rotating_light")
    assert body.decode() == NEEDS_PERSON.text
    assert (later["Priority"], later["Tags"]) == ("default", "white_check_mark")


def test_a_long_text_stays_what_ntfy_shows_as_a_message(serve, receiver):
    server = serve()
    deliver(receiver(kind="ntfy", address=f"{server.url}/bench2"), replace(ENDS, why="°" * 5000))
    assert 3990 < len(server.received[0][2]) <= 4000
    assert server.received[0][2].decode().startswith("°°")


def test_a_title_outside_ascii_is_encoded(serve, receiver):
    server = serve()
    deliver(receiver(kind="ntfy", address=f"{server.url}/bench2"), replace(ENDS, unit="Ж7"))
    assert server.received[0][1]["Title"].startswith("=?utf-8?")


def test_a_secret_goes_into_the_header(serve, receiver, monkeypatch):
    server = serve()
    monkeypatch.setenv("BENCH_TOKEN", "s3cret")
    deliver(receiver(kind="ntfy", address=f"{server.url}/a", secret_env="BENCH_TOKEN"), ENDS)  # noqa: S106 - a name
    assert server.received[0][1]["Authorization"] == "Bearer s3cret"


def test_a_secret_goes_where_the_address_wants_it_and_is_never_shown(serve, receiver, tmp_path):
    server = serve(403)
    (tmp_path / "token").write_text("T0/s3cret\n")
    address = f"{server.url}/services/{{secret}}"
    hook = receiver(kind="webhook", address=address, secret_file=str(tmp_path / "token"))
    with pytest.raises(UndeliveredError, match="403 Forbidden: said the server") as caught:
        deliver(hook, ENDS)
    assert server.received[0][0] == "/services/T0/s3cret"
    assert "Authorization" not in server.received[0][1]
    assert "s3cret" not in str(caught.value)


@pytest.mark.parametrize(("key", "is_final"), [("secret_file", False), ("secret_env", True)])
def test_a_missing_secret_is_reported_and_that_of_a_file_may_be_there_later(
    receiver, tmp_path, monkeypatch, key, is_final
):
    monkeypatch.delenv("BENCH_TOKEN", raising=False)
    source = {"secret_file": str(tmp_path / "BENCH_TOKEN"), "secret_env": "BENCH_TOKEN"}[key]
    hook = receiver(kind="webhook", address="https://127.0.0.1/", **{key: source})
    with pytest.raises(UndeliveredError, match="BENCH_TOKEN") as caught:
        deliver(hook, ENDS)
    assert caught.value.is_final == is_final


@pytest.mark.parametrize(
    ("code", "is_final"), [(500, False), (503, False), (429, False), (404, True), (401, True)]
)
def test_what_a_server_answers_says_whether_trying_again_is_of_use(serve, receiver, code, is_final):
    with pytest.raises(UndeliveredError, match=str(code)) as caught:
        deliver(receiver(kind="webhook", address=serve(code).url), ENDS)
    assert caught.value.is_final == is_final


def test_a_redirection_is_no_delivery(serve, receiver):
    server = serve(302)
    with pytest.raises(UndeliveredError, match="302"):
        deliver(receiver(kind="webhook", address=server.url), ENDS)
    assert len(server.received) == 1


def test_no_server_is_reported(receiver):
    with pytest.raises(UndeliveredError, match="refused") as caught:
        deliver(receiver(kind="webhook", address=f"http://127.0.0.1:{free_port()}"), ENDS)
    assert not caught.value.is_final


def test_a_server_that_hangs_is_given_up(serve, receiver, monkeypatch):
    monkeypatch.setattr(delivery, "TIMEOUT_S", 0.2)
    with pytest.raises(UndeliveredError, match=r"no answer within 0.2 s") as caught:
        deliver(receiver(kind="webhook", address=serve("hang").url), ENDS)
    assert not caught.value.is_final


@pytest.mark.parametrize("code", [200, 404, 503])
@pytest.mark.parametrize("place", ["/hook/{secret}", "/hook"])
def test_a_server_that_repeats_the_secret_never_shows_it(serve_raw, receiver, monkeypatch, code, place):
    def answer(request):
        path = request.split(b" ")[1]
        token = request.partition(b"Authorization: ")[2].partition(b"\r\n")[0]
        body = b"x" * 185 + b" " + unquote_to_bytes(path) + b" " + path + b" " + token
        return b"HTTP/1.0 %d Bad %s %s\r\n\r\n%s" % (code, path, token, body)

    monkeypatch.setenv("BENCH_TOKEN", SECRET)
    hook = receiver(kind="webhook", address=serve_raw(answer) + place, secret_env="BENCH_TOKEN")  # noqa: S106 - a name
    try:
        shown = deliver(hook, ENDS)
    except UndeliveredError as error:
        shown = str(error)
        assert shown.startswith(f"the server answered {code} {http.HTTPStatus(code).phrase}: xxx")
    else:
        assert shown == "200 OK"
    assert "Geh" not in shown
    assert "Bad" not in shown


def test_a_server_that_speaks_no_http_never_shows_it_either(serve_raw, receiver, monkeypatch):
    monkeypatch.setenv("BENCH_TOKEN", SECRET)
    url = serve_raw(lambda request: b"y" * 190 + request.split(b" ")[1] + b"\r\n\r\n")
    hook = receiver(kind="webhook", address=url + "/{secret}", secret_env="BENCH_TOKEN")  # noqa: S106 - a name
    with pytest.raises(UndeliveredError) as caught:
        deliver(hook, ENDS)
    assert "Geh" not in str(caught.value)


def test_a_server_that_answers_line_by_line_without_end_is_given_up(serve_drip, receiver, monkeypatch):
    monkeypatch.setattr(delivery, "MAX_EXCHANGE_S", 0.5)
    with pytest.raises(UndeliveredError, match=r"no answer within 0.5 s") as caught:
        deliver(receiver(kind="webhook", address=serve_drip()), ENDS)
    assert not caught.value.is_final


class Mailbox:
    """Keeps what it is sent; refuses those whose name says so."""

    def __init__(self):
        self.mails = []

    async def handle_RCPT(self, server, session, envelope, address, options):  # noqa: N802 - aiosmtpd's name
        if address.startswith("unknown"):
            return "550 no such mailbox"
        if address.startswith("full"):
            return "452 mailbox full"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, server, session, envelope):  # noqa: N802
        self.mails.append((session, email.message_from_bytes(envelope.content, policy=default)))
        return "250 OK"


def _log_in(server, session, envelope, mechanism, data):
    good = isinstance(data, LoginPassword) and (data.login, data.password) == (b"bench", b"s3cret")
    return AuthResult(success=good, handled=False)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificate")
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost"
    command += f" -addext subjectAltName=DNS:localhost -keyout {folder}/key.pem -out {folder}/cert.pem"
    subprocess.run(command.split(), check=True, capture_output=True)
    return folder


@pytest.fixture
def serve_mail():
    started = []

    def start(**options):
        box = Mailbox()
        controller = Controller(box, hostname="127.0.0.1", port=free_port(), **options)
        controller.start()
        started.append(controller)
        return box, controller.port

    yield start
    for controller in started:
        controller.stop()


@pytest.fixture
def mailbox(receiver):
    def make(port, **keys):
        settings = {"address": "me@example.org", "sender": "bench@example.org", "server": "127.0.0.1"}
        return receiver(**{"kind": "email", "port": port, "security": "none"} | settings | keys)

    return make


def test_a_mail_has_everything(serve_mail, mailbox):
    box, port = serve_mail()
    assert deliver(mailbox(port), NEEDS_PERSON) == "taken by 127.0.0.1"
    ((_, received),) = box.mails
    assert received["Subject"] == f"gyrobench {NEEDS_PERSON.title}"
    assert (received["To"], received["From"]) == ("me@example.org", "bench@example.org")
    assert received["Date"].datetime == NEEDS_PERSON.time
    assert received["Importance"] == "high"
    assert received.get_content().splitlines() == NEEDS_PERSON.text.splitlines()


def test_a_login_goes_over_starttls_to_a_server_that_can_be_trusted(
    serve_mail, mailbox, certificate, monkeypatch
):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate / "cert.pem", certificate / "key.pem")
    box, port = serve_mail(
        tls_context=context, require_starttls=True, authenticator=_log_in, auth_required=True
    )
    monkeypatch.setenv("MAIL_PASSWORD", "s3cret")
    login = {"server": "localhost", "security": "starttls", "user": "bench", "secret_env": "MAIL_PASSWORD"}
    with pytest.raises(UndeliveredError, match=r"(?i)certificate"):
        deliver(mailbox(port, **login), ENDS)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate / "cert.pem"))
    deliver(mailbox(port, **login), ENDS)
    assert box.mails[0][0].ssl is not None
    monkeypatch.setenv("MAIL_PASSWORD", "wrong")
    with pytest.raises(UndeliveredError, match="535") as caught:
        deliver(mailbox(port, **login), ENDS)
    assert caught.value.is_final


def test_a_server_without_starttls_gets_nothing(serve_mail, mailbox):
    box, port = serve_mail()
    with pytest.raises(UndeliveredError, match="STARTTLS"):
        deliver(mailbox(port, security="starttls"), ENDS)
    assert not box.mails


@pytest.mark.parametrize(("name", "code", "is_final"), [("unknown", 550, True), ("full", 452, False)])
def test_what_the_server_refuses_is_reported(serve_mail, mailbox, name, code, is_final):
    _, port = serve_mail()
    with pytest.raises(UndeliveredError, match=str(code)) as caught:
        deliver(mailbox(port, address=f"{name}@example.org"), ENDS)
    assert caught.value.is_final == is_final


def test_a_mail_server_that_is_down_is_reported(mailbox):
    with pytest.raises(UndeliveredError, match="refused") as caught:
        deliver(mailbox(free_port()), ENDS)
    assert not caught.value.is_final


def test_a_mail_server_that_hangs_is_given_up(mailbox, monkeypatch):
    monkeypatch.setattr(delivery, "TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(UndeliveredError, match="timed out"):
        deliver(mailbox(silent.getsockname()[1]), ENDS)


@pytest.mark.filterwarnings("ignore:Requiring AUTH while not requiring TLS")
def test_a_server_that_repeats_the_password_never_shows_it(serve_mail, mailbox, monkeypatch):
    password = "Geheim/Wort+9 x&y"  # noqa: S105 - made up

    def refuse(server, session, envelope, mechanism, data):
        said = data.password.decode()
        coded = base64.b64encode(b"\0bench\0" + data.password).decode()
        return AuthResult(success=False, handled=False, message=f"535 no {said} {quote(said)} {coded}")

    _, port = serve_mail(authenticator=refuse, auth_required=True, auth_require_tls=False)
    monkeypatch.setenv("MAIL_PASSWORD", password)
    with pytest.raises(UndeliveredError, match=r"535 no \{secret\} \{secret\} ") as caught:
        deliver(mailbox(port, user="bench", secret_env="MAIL_PASSWORD"), ENDS)  # noqa: S106 - a name
    coded = base64.b64encode(f"\0bench\0{password}".encode()).decode()
    assert coded[10:-4] not in str(caught.value)
