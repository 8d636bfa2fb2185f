"""Webhook and ntfy against real servers."""

import http
import json
from dataclasses import replace
from urllib.parse import unquote_to_bytes

import pytest

from gyrobench.bench.messages import delivery
from gyrobench.bench.messages import delivery as post
from gyrobench.bench.messages.delivery import UndeliveredError, deliver
from tests.bench.messages.made_up import ENDS, NEEDS_PERSON
from tests.bench.messages.servers import free_port


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
    monkeypatch.setattr(post, "TIMEOUT_S", 0.2)
    with pytest.raises(UndeliveredError, match=r"no answer within 0.2 s") as caught:
        deliver(receiver(kind="webhook", address=serve("hang").url), ENDS)
    assert not caught.value.is_final


SECRET = "Geheim/Wort+9 x&y"  # noqa: S105 - made up


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
