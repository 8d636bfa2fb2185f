"""Types of values that several sections of the station file have."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Direction = Literal["east", "north", "up", "west", "south", "down"]

_USER_IN_ADDRESS = re.compile(r"://[^/?#]*@")


def _low_first(ends: list[float]) -> list[float]:
    if ends[0] >= ends[1]:
        raise ValueError("the lower end comes first, then the higher one")
    return ends


def without_password(address: str) -> str:
    """Refuse ``scheme://user:password@host``: the station file is copied into every run folder."""
    if _USER_IN_ADDRESS.search(address):
        raise ValueError(
            "an address can't hold a user or password: every run folder has a copy of this file. "
            "Reach the port by a tunnel or a device server without password",
        )
    return address


Range = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_low_first)]
Port = Annotated[
    str, Field(min_length=1, description="serial device or pyserial URL"), AfterValidator(without_password)
]
Identity = Annotated[
    str,
    Field(
        max_length=200,
        description="text that the instrument's own identification must contain, for instance its "
        "serial number",
    ),
]
