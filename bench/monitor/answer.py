"""What the monitor answers to a request, and what browsers may do with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from http import HTTPStatus

#: For what needs neither script nor style.
BARE_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
#: For pages that a run leaves: pictures and style inside, and never a script, whatever is in them.
RECORD_POLICY = f"{BARE_POLICY}; img-src data:; style-src 'unsafe-inline'; sandbox allow-popups"

HTML = "text/html; charset=utf-8"
PLAIN = "text/plain; charset=utf-8"


@dataclass(frozen=True)
class Answer:
    """An answer without the headers that all have.

    Attributes
    ----------
    status : HTTPStatus
        Status.
    body : bytes
        Content.
    content_type : str
        What the content is.
    policy : str
        Content security policy.
    headers : dict
        Headers that only this answer has.
    """

    status: HTTPStatus
    body: bytes
    content_type: str = HTML
    policy: str = BARE_POLICY
    headers: dict[str, str] = field(default_factory=dict)


def page_policy(nonce: str) -> str:
    """Policy of the monitor's own pages: a style and a script with the nonce, which asks this server."""
    return f"{BARE_POLICY}; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; connect-src 'self'"


def refusal(status: HTTPStatus, text: str, **headers: str) -> Answer:
    """Say in plain text why there is nothing else."""
    return Answer(status, f"{text}\n".encode(), PLAIN, headers=headers)
