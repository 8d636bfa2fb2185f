"""Passes of the temperature profile, told from a temperature alone."""

from __future__ import annotations

from collections.abc import Sequence


def legs(temperatures_c: Sequence[float], least_turn_c: float) -> list[int]:
    """Number the legs between turning points, from 1.

    Parameters
    ----------
    temperatures_c : sequence of float
        In the order of time.
    least_turn_c : float
        The temperature turned at its extreme once it came back by this much, K.
    """
    turns: list[int] = []
    direction = 0
    low = high = 0
    for index, value in enumerate(temperatures_c):
        if value > temperatures_c[high]:
            high = index
        if value < temperatures_c[low]:
            low = index
        if direction >= 0 and temperatures_c[high] - value >= least_turn_c:
            if direction > 0:
                turns.append(high)
            direction, low = -1, index
        elif direction <= 0 and value - temperatures_c[low] >= least_turn_c:
            if direction < 0:
                turns.append(low)
            direction, high = 1, index
    return [1 + sum(index > turn for turn in turns) for index in range(len(temperatures_c))]
