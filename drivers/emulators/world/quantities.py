"""Kinds of value in a world file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
#: One value for each body axis.
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
#: Three rows of three values, in body axes.
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
