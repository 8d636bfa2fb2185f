"""Every output of the bench at its safe value, and the table ready to move again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.station.safe_state import SafeAction, make_safe


class SafeOutputs:
    """Brings the outputs to their safe values, and remembers it for the interlocks.

    Parameters
    ----------
    bench : LiveBench
        Whose outputs they are.
    meanwhile : callable
        Called now and then while something is waited for.
    """

    def __init__(self, bench: LiveBench, meanwhile: Callable[[], object]) -> None:
        self._bench = bench
        self._meanwhile = meanwhile

    def apply(self, release_table: bool = True) -> list[SafeAction]:
        """Apply the safe values; tells how each went.

        Parameters
        ----------
        release_table : bool
            Whether the servos are opened as well.
        """
        bench = self._bench
        actions = make_safe(bench.station, bench.instruments, release_table, meanwhile=self._meanwhile)
        safe, expected = bench.station.safe_state, bench.expected
        is_off = safe.chamber_c is None
        bench.expected = replace(
            expected,
            chamber_set_c=expected.chamber_set_c if is_off else safe.chamber_c,
            chamber_on=False if is_off else expected.chamber_on,
            chamber_reached=False,
            ins_on=expected.ins_on and safe.unit == "keep",
            table_prepared=False,
        )
        return actions

    def prepare_table(self) -> None:
        """Bound its motions, clear latched faults and close the servos, unless that is done already.

        Raises
        ------
        InstrumentError
            The table does not answer, or a servo does not close.
        """
        if self._bench.expected.table_prepared:
            return
        table, limits = self._bench.instruments.table, self._bench.station.file.rate_table.limits
        table.set_limits(limits.rate_dps, limits.acceleration_dps2, limits.jerk_dps3)
        table.prepare()
        self._bench.expected = replace(self._bench.expected, table_prepared=True)
