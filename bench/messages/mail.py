"""A message as e-mail."""

from __future__ import annotations

import smtplib
import ssl
from email.message import EmailMessage
from email.utils import format_datetime, make_msgid

from gyrobench.bench.messages.message import Message
from gyrobench.bench.messages.secret import server_words
from gyrobench.bench.messages.undelivered import UndeliveredError
from gyrobench.bench.station.messages import Email

#: A server that says nothing for so long is given up for now.
TIMEOUT_S = 10.0
#: Codes from here on say that trying again is no use.
_PERMANENT = 500


def send_mail(receiver: Email, password: str, message: Message) -> str:
    """Send a mail by way of the receiver's mail server; returns the server's answer."""
    mail = EmailMessage()
    mail["From"], mail["To"] = receiver.sender, receiver.address
    mail["Subject"] = f"gyrobench {message.title}"
    mail["Date"] = format_datetime(message.time)
    mail["Message-ID"] = make_msgid("gyrobench", receiver.sender.rpartition("@")[2])
    if message.is_urgent:
        mail["Importance"] = "high"
    mail.set_content(message.text + "\n")
    try:
        with _connected(receiver) as server:
            if receiver.security == "starttls":
                server.starttls(context=ssl.create_default_context())
            if receiver.user is not None:
                server.login(receiver.user, password)
            server.send_message(mail)
            return f"taken by {receiver.server}"
    except smtplib.SMTPRecipientsRefused as error:
        code, said = next(iter(error.recipients.values()))
        raise _refused(code, said, password) from None
    except smtplib.SMTPResponseException as error:
        raise _refused(error.smtp_code, error.smtp_error, password) from None
    except smtplib.SMTPNotSupportedError as error:
        raise UndeliveredError(str(error), is_final=True) from None
    except TimeoutError:
        raise UndeliveredError(f"no answer within {TIMEOUT_S:g} s", is_final=False) from None
    except (OSError, smtplib.SMTPException) as error:
        told = server_words(password, str(getattr(error, "strerror", None) or error))
        raise UndeliveredError(told, is_final=False) from None


def _connected(receiver: Email) -> smtplib.SMTP:
    if receiver.security == "tls":
        context = ssl.create_default_context()
        return smtplib.SMTP_SSL(receiver.server, receiver.port, timeout=TIMEOUT_S, context=context)
    return smtplib.SMTP(receiver.server, receiver.port, timeout=TIMEOUT_S)


def _refused(code: int, said: bytes | str, password: str) -> UndeliveredError:
    text = said.decode(errors="replace") if isinstance(said, bytes) else said
    answer = f"{code} {server_words(password, text)}".strip()
    return UndeliveredError(f"the mail server answered {answer}", is_final=code >= _PERMANENT)
