"""Makes the bench safe in place of the engine, and sends an alarm about it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import BenchInUseError, GyrobenchError
from gyrobench.bench.foundations.text import capitalised
from gyrobench.bench.guard.watching import EngineEnd, EngineProcess, GuardConfig, GuardLog
from gyrobench.bench.messages.delivery import Message
from gyrobench.bench.messages.messenger import Messenger
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal, facts_of, read_journal
from gyrobench.bench.runs.provenance import identities_in
from gyrobench.bench.station.bench_lock import GUARD_COMMAND, BenchLock, bench_holders
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.safe_state import RAMP_PERIOD_S, SafeAction, finish_ramp, make_safe
from gyrobench.bench.station.station import Station
from gyrobench.drivers.serial_line import share_ports

#: Pauses between attempts, s: a quarter of an hour in all.
_PAUSES_S = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, *[60.0] * 14)

_KILL_TIME_S = 10.0
_LOCK_PERIOD_S = 0.2
#: Long, as the guard has nothing else to do and networks recover.
_ALARM_PATIENCE_S = 900.0


class Rescue:
    """Makes table and chamber of a bench safe over their ports, with repeated attempts.

    An instrument with another identity than in the run is not commanded.

    Raises DocumentError if the station file is wrong.
    """

    def __init__(self, config: GuardConfig, engine: EngineProcess, clock: Clock, log: GuardLog) -> None:
        self._station = Station(Path(config.station))
        self._folder = RunFolder(Path(config.folder))
        self._silence_s = config.silence_s
        self._engine = engine
        self._clock = clock
        self._log = log
        self._killed = False
        self._identities = identities_in(self._folder)
        self._engine_holders = [
            each for each in bench_holders(self._station) if each.pid == config.engine_pid
        ]

    def act(self, end: EngineEnd) -> None:
        """Make the bench safe, unless another run has taken it over."""
        self._log.add(end.value)
        if end is EngineEnd.SILENT:
            self._kill()
        # Leaving the context waits until the alarm is sent.
        with Messenger(self._station.file.messages, self._log_sending, _ALARM_PATIENCE_S) as messenger:
            self._act(end, messenger)

    def _act(self, end: EngineEnd, messenger: Messenger) -> None:
        remaining: list[str] | None = None
        for pause_s in _PAUSES_S:
            self._clock.sleep(pause_s)
            try:
                with (
                    self._lock(),
                    Outputs(self._station, self._clock, identities=self._identities) as outputs,
                ):
                    results: dict[str, SafeAction] = {}
                    for actions in self._make_safe(outputs, remaining):
                        is_first = remaining is None
                        if is_first or not all(action.problem for action in actions):
                            self._record(end, actions)
                        results |= {action.what: action for action in actions}
                        remaining = [action.what for action in results.values() if action.problem]
                        if is_first and remaining:
                            problems = "; ".join(
                                f"{action.what}: {action.problem}" for action in actions if action.problem
                            )
                            bench = f"The bench is NOT in its safe state yet: {problems}"
                            self._send_alarm(messenger, end, bench)
            except BenchInUseError as error:
                self._log.add(f"ends without acting: {error}")
                return
            if not remaining:
                self._log.add("the bench is in its safe state")
                self._send_alarm(messenger, end, "The bench is in its safe state.")
                return
        gives_up = "gives up: the bench is NOT in its safe state. Check table and chamber."
        self._log.add(gives_up)
        self._send_alarm(messenger, end, f"The guard {gives_up}")

    def _kill(self) -> None:
        self._engine.kill()
        self._killed = True
        ended = self._engine.wait_for_end(_KILL_TIME_S)
        if not ended:
            share_ports()
        self._log.add("killed the engine" if ended else "the killed engine still hangs in the kernel")

    def _lock(self) -> AbstractContextManager[object]:
        """Lock the bench as soon as the engine has released it.

        Raises BenchInUseError if another run has locked it.
        """
        deadline = Deadline(self._clock, self._silence_s * self._clock.speed)
        while True:
            lock = BenchLock(self._station, self._folder.path, self._clock, GUARD_COMMAND)
            with ExitStack() as resources:
                try:
                    resources.enter_context(lock)
                    return resources.pop_all()
                except BenchInUseError:
                    holders = bench_holders(self._station)
                    if holders and not any(each in self._engine_holders for each in holders):
                        raise
                    if self._killed:  # a killed engine can't act, so its lock protects nothing
                        return nullcontext()
                except GyrobenchError as error:
                    self._log.add(f"acts without the lock: {error}")
                    return nullcontext()
            if deadline.expired():
                self._log.add("the engine does not release the bench")
                self._kill()
            self._clock.sleep(_LOCK_PERIOD_S)

    def _make_safe(self, outputs: Outputs, only: list[str] | None) -> Iterator[list[SafeAction]]:
        """Make the bench safe; yields the actions performed, then those of a ramp as they complete."""
        actions = make_safe(self._station, outputs, only=only)
        results = {action.what: action for action in actions}
        ramp = finish_ramp(self._station, outputs, actions)
        results |= {action.what: action for action in next(ramp, [])}
        yield self._log_actions(list(results.values()))
        for ramp_actions in ramp:
            new = [action for action in ramp_actions if results.get(action.what) != action]
            results |= {action.what: action for action in new}
            if new:
                yield self._log_actions(new)
            self._clock.sleep(RAMP_PERIOD_S)

    def _log_actions(self, actions: list[SafeAction]) -> list[SafeAction]:
        for action in actions:
            self._log.add(f"{action.what}: {action.problem or 'done'}")
        return actions

    def _record(self, end: EngineEnd, actions: list[SafeAction]) -> None:
        def record() -> str:
            try:
                with Journal(self._folder.journal, self._clock) as journal:
                    safe_state = [asdict(action) for action in actions]
                    journal.record("guard_acted", reason=end.value, safe_state=safe_state)
            except GyrobenchError as error:
                return str(error)
            return ""

        if problem := self._log.access.do(record):
            self._log.add(f"not in the journal: {problem}")

    def _send_alarm(self, messenger: Messenger, end: EngineEnd, bench: str) -> None:
        """Send how the engine ended, and the state of the bench."""

        def read() -> list[dict[str, Any]]:
            entries: list[dict[str, Any]] = []
            with contextlib.suppress(GyrobenchError):  # entries up to a damaged line
                entries.extend(read_journal(self._folder.journal))
            return entries

        facts = facts_of(self._log.access.do(read) or [])
        message = Message(
            event="guard_acted",
            why=f"{capitalised(end.value)}, so the guard acted. {bench}\n"
            f"Once the cause is found: gyrobench resume {self._folder.argument}",
            station=self._station.file.station,
            time=self._clock.utc(),
            folder=self._folder.path,
            procedure=facts.procedure,
            unit=facts.unit,
        )
        messenger.send(message, about=bench)

    def _log_sending(self, event: str, **details: Any) -> None:
        text = ", ".join(f"{key} {value}" for key, value in details.items())
        self._log.add(f"{event.replace('_', ' ')}: {text}")
