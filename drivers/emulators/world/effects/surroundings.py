"""Effects of gravity and of the chamber around the unit."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.effects.effect import Conditions, Effect
from gyrobench.drivers.emulators.world.quantities import Matrix, Vector


def _shape(value: Any) -> str:
    return "matrix" if isinstance(value, list) and any(isinstance(row, list) for row in value) else "vector"


#: Told apart first, so that a mistake in one is not reported for the other as well.
_VectorOrMatrix = Annotated[
    Annotated[Vector, Tag("vector")] | Annotated[Matrix, Tag("matrix")], Discriminator(_shape)
]


class GSensitivity(Effect):
    """Block and dither springs bend under the unit's own weight: biases linear in gravity's direction.

    Three values are the sensitivity of each gyro to Up along its own axis; of a matrix, row i
    column j is that of gyro i to Up along axis j.
    """

    kind: Literal["g_sensitivity"] = Field(description="name of the effect")
    sensitivity_dph_per_g: _VectorOrMatrix = Field(
        description="bias per g along the gyro's own axis, three values, or three rows of three, deg/h/g"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        sensitivity = np.array(self.sensitivity_dph_per_g)
        return np.asarray((np.diag(sensitivity) if sensitivity.ndim == 1 else sensitivity) @ now.up_body)


class ChamberState(Effect):
    """The chamber's compressor shakes the unit: all of the bias while it runs, its share while it cycles."""

    kind: Literal["chamber_state"] = Field(description="name of the effect")
    bias_dph: Vector = Field(description="bias of each gyro while the compressor runs, deg/h")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.bias_dph) * now.compressor_duty
