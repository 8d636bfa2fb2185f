"""E-mail against a real server."""

import base64
import email
import socket
import ssl
import subprocess
from email.policy import default
from urllib.parse import quote

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult, LoginPassword

from gyrobench.bench.messages import delivery as mail
from gyrobench.bench.messages.delivery import UndeliveredError, deliver
from tests.bench.messages.made_up import ENDS, NEEDS_PERSON
from tests.bench.messages.servers import free_port


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
    monkeypatch.setattr(mail, "TIMEOUT_S", 0.2)
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
