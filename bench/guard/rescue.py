"""Making the bench safe in place of the engine."""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import asdict
from pathlib import Path

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import BenchInUseError, GyrobenchError
from gyrobench.bench.guard.alarm import AlarmSender
from gyrobench.bench.guard.engine_process import EngineProcess
from gyrobench.bench.guard.log import GuardLog
from gyrobench.bench.guard.orders import Orders
from gyrobench.bench.guard.watch import Ending
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.locks import GUARD_COMMAND, BenchLock, Holder, bench_holders
from gyrobench.bench.station.safe_state import SafeAction, make_safe
from gyrobench.bench.station.station import Station

#: Pauses between attempts, s: a quarter of an hour in all.
PAUSES_S = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, *[60.0] * 14)

_KILL_TIME_S = 10.0
_LOCK_LOOK_S = 0.2


class Rescue:
    """Makes table and chamber of a bench safe over their ports, for as long as it takes.

    Parameters
    ----------
    orders : Orders
        The engine's.
    engine : EngineProcess
        Its process.
    clock : Clock
        The run's clock, going on.
    log : GuardLog
        What is done, in words.

    Raises
    ------
    DocumentError
        The station file is wrong.
    """

    def __init__(self, orders: Orders, engine: EngineProcess, clock: Clock, log: GuardLog) -> None:
        self._station = Station(Path(orders.station))
        self._folder = RunFolder(Path(orders.folder))
        self._silence_s = orders.silence_s
        self._engine = engine
        self._clock = clock
        self._log = log
        self._killed = False
        self._engines_lock = [each for each in bench_holders(self._station) if each.pid == orders.engine_pid]

    def act(self, ending: Ending) -> None:
        """Make the bench safe, unless another run has it by now."""
        self._log.add(ending.value)
        if ending is Ending.SILENT:
            self._kill()
        with AlarmSender(self._station, self._folder, self._clock, self._log) as alarm:
            self._act(ending, alarm)

    def _act(self, ending: Ending, alarm: AlarmSender) -> None:
        left: list[str] | None = None
        for pause_s in PAUSES_S:
            self._clock.sleep(pause_s)
            try:
                with self._lock():
                    actions = self._make_safe(left)
                    if left is None or not all(action.problem for action in actions):
                        self._record(ending, actions)
            except BenchInUseError as error:
                self._log.add(f"leaves without acting: {error}")
                return
            is_first = left is None
            left = [action.what for action in actions if action.problem]
            if not left:
                self._log.add("the bench is in its safe state")
                alarm.raise_for(ending, "The bench is in its safe state.")
                return
            if is_first:
                problems = "; ".join(
                    f"{action.what}: {action.problem}" for action in actions if action.problem
                )
                alarm.raise_for(ending, f"The bench is NOT in its safe state yet: {problems}")
        self._log.add("gives up: the bench is NOT in its safe state. See to table and chamber.")
        alarm.raise_for(
            ending, "The guard gives up: the bench is NOT in its safe state. See to table and chamber."
        )

    def _kill(self) -> None:
        self._engine.kill()
        self._killed = True
        ended = self._engine.ended(_KILL_TIME_S)
        self._log.add("killed the engine" if ended else "the killed engine still hangs in the kernel")

    def _lock(self) -> AbstractContextManager[object]:
        """Take the bench's lock as soon as the engine has let go of it.

        Raises
        ------
        BenchInUseError
            Another run has it.
        """
        deadline = Deadline(self._clock, self._silence_s)
        while True:
            lock = BenchLock(self._station, self._folder.path, self._clock, GUARD_COMMAND)
            with ExitStack() as taken:
                try:
                    taken.enter_context(lock)
                    return taken.pop_all()
                except BenchInUseError:
                    if not self._engine_holds():
                        raise
                    if self._killed:  # it will do nothing any more, so its lock protects nobody
                        return nullcontext()
                except GyrobenchError as error:
                    self._log.add(f"acts without the lock: {error}")
                    return nullcontext()
            if deadline.expired():
                self._log.add("the engine does not let go of the bench")
                self._kill()
            self._clock.sleep(_LOCK_LOOK_S)

    def _engine_holds(self) -> bool:
        holders: list[Holder] = bench_holders(self._station)
        return not holders or any(holder in self._engines_lock for holder in holders)

    def _make_safe(self, only: list[str] | None) -> list[SafeAction]:
        with Outputs(self._station, self._clock) as outputs:
            actions = make_safe(self._station, outputs, only=only)
        for action in actions:
            self._log.add(f"{action.what}: {action.problem or 'done'}")
        return actions

    def _record(self, ending: Ending, actions: list[SafeAction]) -> None:
        with contextlib.ExitStack() as opened:
            try:
                journal = opened.enter_context(Journal(self._folder.journal, self._clock))
                journal.record(
                    "guard_acted",
                    reason=ending.value,
                    safe_state=[asdict(action) for action in actions],
                )
            except GyrobenchError as error:
                self._log.add(f"not in the journal: {error}")
