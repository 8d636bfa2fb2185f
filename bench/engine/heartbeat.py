"""What happens at every tick of a run, whatever the procedure does."""

from __future__ import annotations

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.orders import GivenOrder, Order
from gyrobench.bench.engine.people import People
from gyrobench.bench.foundations.errors import RunStoppedError
from gyrobench.bench.guard.link import Guard
from gyrobench.bench.runs.journal import Journal

#: A calendar that differs by so much more than before has been set, or was corrected for long.
_CALENDAR_SET_S = 1.0


class Heartbeat:
    """Lets ticks pass: the bench is polled, the guard gets a sign of life, orders are taken.

    Parameters
    ----------
    bench, journal, people, guard
        Those of the run.
    """

    def __init__(self, bench: LiveBench, journal: Journal, people: People, guard: Guard) -> None:
        self._bench = bench
        self._journal = journal
        self._people = people
        self._guard = guard
        self._calendar_offset_s = 0.0

    def beat(self) -> None:
        """Let one tick pass."""
        self._bench.tick()
        self.tell_guard()
        self._people.progress.beat(self._bench)
        self._notice_calendar()

    def _notice_calendar(self) -> None:
        """Note a calendar that was set: the run's times go on as before, other logs of the host do not."""
        offset_s = self._bench.clock.calendar_offset_s()
        if abs(offset_s - self._calendar_offset_s) > _CALENDAR_SET_S:
            self._calendar_offset_s = offset_s
            self.note(f"this machine's calendar is now {offset_s:+.1f} s from the run's time, which goes on")

    def tell_guard(self) -> None:
        """Say to the guard that the engine is alive."""
        note = self._guard.beat()
        if note:
            self.note(note)

    def ordered(self) -> GivenOrder | None:
        """What somebody orders; it is in the journal when this returns.

        Raises
        ------
        RunStoppedError
            The order is to abort.
        """
        typed = self._people.operator.order()
        if typed:
            self._people.orders.give(typed, "the terminal")
        given = self._people.orders.take()
        if given is None:
            return None
        self._journal.record("ordered", order=given.order, by=given.by)
        if given.order is Order.ABORT:
            raise RunStoppedError(f"stopped by {given.by}")
        return given

    def note(self, text: str) -> None:
        """Tell something that a person should know, in the journal and to who watches."""
        self._journal.record("note", text=text)
        self._people.progress.told(text)
