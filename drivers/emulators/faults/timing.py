"""When a fault comes, how long it lasts and how often it comes."""

from __future__ import annotations

import math
from enum import Enum
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.drivers.emulators.world.undeclared_effects import NotNegative, Positive

Count = Annotated[int, Field(ge=1)]
#: Mean spacing in s: many faults a second would take the bench for ever to bring about.
Spacing = Annotated[float, Field(ge=1.0)]
#: What the emulated bench is doing, told from the world's own state.
Phase = Literal["power_on", "align", "navigate", "turn", "ramp"]


class Lasting(Enum):
    """How long a kind of fault lasts without ``for_s``."""

    MOMENT = "happens at one moment; for_s is not allowed"
    UNTIL_USED = "touches the next replies or frames, as many as its own key says"
    FOR_GOOD = "lasts for good"


class Timing(StrictModel):
    """Keys that every entry has: exactly one of ``at_s``, ``every_s`` and ``during``, and how long."""

    lasting: ClassVar[Lasting] = Lasting.FOR_GOOD

    at_s: NotNegative | None = Field(None, description="time on the bench's clock")
    every_s: Spacing | None = Field(None, description="mean spacing; the times are random, by the seed")
    from_s: NotNegative = Field(0.0, description="with every_s: not before this time")
    during: Phase | None = Field(None, description="while the bench does this")
    after_s: NotNegative = Field(0.0, description="with during: so long after the phase began")
    nth: Count = Field(1, description="with during: the first such phase that counts")
    times: Count | None = Field(
        None, description="how often at most; without it, at_s and during once, every_s without end"
    )
    for_s: Positive | None = Field(None, description="how long it lasts")

    @property
    def duration_s(self) -> float:
        """Time from begin to end; zero if it ends by itself, infinite if never."""
        if self.for_s is not None:
            return self.for_s
        return math.inf if self.lasting is Lasting.FOR_GOOD else 0.0

    @property
    def most(self) -> float:
        """How often it comes at most."""
        if self.times is not None:
            return self.times
        return math.inf if self.every_s is not None else 1

    @model_validator(mode="after")
    def _says_when_in_one_way(self) -> Timing:
        given = [key for key in ("at_s", "every_s", "during") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError("an entry has exactly one of the keys at_s, every_s and during")
        for key, needs in {"from_s": "every_s", "after_s": "during", "nth": "during"}.items():
            if key in self.model_fields_set and needs not in given:
                raise ValueError(f"{key} goes with {needs} alone")
        if self.at_s is not None and self.most > 1:
            raise ValueError("at_s is one moment; for more times use every_s or another entry")
        if self.lasting is Lasting.MOMENT and self.for_s is not None:
            raise ValueError("for_s is not allowed here: this fault happens at one moment")
        if self.most > 1 and math.isinf(self.duration_s):
            raise ValueError("a fault that comes again has to end: for_s is missing")
        return self
