"""Messages off the bench: a webhook, a phone or a mailbox is told when a run needs somebody.

:class:`~gyrobench.bench.messages.message.Message` says what happened,
:mod:`~gyrobench.bench.messages.delivery` brings it to
one receiver, and a :class:`~gyrobench.bench.messages.messenger.Messenger` does that for all receivers of a
station in threads of their own, so that a dead network holds nothing up.
"""
