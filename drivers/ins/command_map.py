"""Which frame carries which command: the station file's ``ins.commands``.

A command is a message of the DBC and the values of its signals. A value that is not known before
the command is given stands as ``$sequence``, ``$axis``, ``$index`` or ``$value``.
"""

from __future__ import annotations

from collections.abc import Mapping

import can

from bench.documents import Location, Problem, StrictModel
from bench.errors import DocumentError
from drivers.ins.attitude import EulerSequence
from drivers.ins.dbc_codec import DbcCodec
from drivers.ins.frames import EXTENDED_ID


class Command(StrictModel):
    """A message and the values of its signals, in the DBC's units."""

    message: str
    values: dict[str, float | str]

    def frame(self, codec: DbcCodec, given: Mapping[str, float]) -> can.Message:
        """Build the frame, with the ``given`` values in place of their names."""
        values = {
            name: given[value] if isinstance(value, str) else value for name, value in self.values.items()
        }
        identifier = codec.arbitration_id(self.message)
        return can.Message(
            arbitration_id=identifier & ~EXTENDED_ID,
            is_extended_id=bool(identifier & EXTENDED_ID),
            data=codec.encode(self.message, values)[0].tobytes(),
        )


class SequenceCommand(Command):
    """Sets the Euler sequence; ``$sequence`` is one of the two numbers."""

    rpy_321: int = 0
    pry_231: int = 1

    def number(self, sequence: EulerSequence) -> int:
        """Look up the INS's number for a sequence."""
        return self.rpy_321 if sequence is EulerSequence.RPY_321 else self.pry_231


class CoefficientCommand(Command):
    """Loads one number of the compensation: ``$value`` at ``$index`` for the gyro ``$axis``.

    The coefficient of degree k in the temperature of the gyro's optics has the index k.
    """

    #: How many coefficients the INS takes for a gyro.
    coefficients: int
    #: Indices of the lowest and highest temperature of validity.
    lowest_index: int | None = None
    highest_index: int | None = None

    def limits(self, lowest_c: float, highest_c: float) -> dict[int, float]:
        """Temperatures of validity by index, as far as the INS takes them."""
        limits = {self.lowest_index: lowest_c, self.highest_index: highest_c}
        return {index: value for index, value in limits.items() if index is not None}


class CommandMap(StrictModel):
    """Commands that the INS knows."""

    standby: Command | None = None
    align: Command | None = None
    navigate: Command | None = None
    set_euler_sequence: SequenceCommand | None = None
    clear_compensation: Command | None = None
    load_compensation: CoefficientCommand | None = None
    apply_compensation: Command | None = None


_GIVEN = {"set_euler_sequence": {"$sequence"}, "load_compensation": {"$axis", "$index", "$value"}}


def check_commands(commands: CommandMap, codec: DbcCodec, at: Location = ()) -> list[Problem]:
    """List what does not fit the DBC, with the map standing at ``at`` in its file."""
    problems = []
    for name in CommandMap.model_fields:
        command: Command | None = getattr(commands, name)
        if command is None:
            continue
        given = _GIVEN.get(name, set())
        for signal, value in command.values.items():
            here = (*at, name, "values", signal)
            if isinstance(value, str) and value not in given:
                known = f"a number or {', '.join(sorted(given))}" if given else "a number"
                problems.append(Problem(here, f"expected {known}; found '{value}'"))
            try:
                codec.signal(command.message, signal)
            except DocumentError as error:
                problems.append(Problem(here, str(error)))
    return problems
