"""Made-up logs with a known bias over temperature, written as a logger writes them."""

from functools import lru_cache
from pathlib import Path

import numpy as np

MAP = """\
unit: A7
text: {}
time: {column: time}
gyro: {unit: deg/s, x: gx, y: gy, z: gz}
temperatures: {gyros: temp}
position: z_up
window_s: 60
"""
COLUMNS = ("time", "gx", "gy", "gz", "temp")
RATE_HZ = 5.0
NOISE_DPH = 20.0


def bias_dph(temperature_c):
    """Biases of the three gyros, shape (n, 3)."""
    return np.column_stack([2.0 * temperature_c, -0.5 * temperature_c, np.full_like(temperature_c, 30.0)])


@lru_cache(maxsize=16)
def texts(values):
    """A column, as bytes of float64, as a logger writes it."""
    return [f"{value:.9g}" for value in np.frombuffer(values)]


class SampleLog:
    """A unit that is heated from 10 to 40 degC and cooled again, 40 min, 5 Hz."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        random = np.random.default_rng(1)
        self.time_s = np.arange(int(2400 * RATE_HZ)) / RATE_HZ
        self.temperature_c = 40.0 - 30.0 * np.abs(self.time_s / 1200.0 - 1.0)
        rates = bias_dph(self.temperature_c) + NOISE_DPH * random.standard_normal((len(self.time_s), 3))
        read_c = self.temperature_c + 0.01 * random.standard_normal(len(self.time_s))
        self.columns = dict(zip(COLUMNS, (self.time_s.copy(), *rates.T / 3600.0, read_c), strict=True))

    def lines(self, separator=",", header=True):
        columns = (texts(np.asarray(column, dtype=float).tobytes()) for column in self.columns.values())
        rows = zip(*columns, strict=True)
        head = [separator.join(self.columns)] if header else []
        return [*head, *(separator.join(row) for row in rows)]

    def write(self, lines=None, name="log.csv"):
        path = self.folder / name
        path.write_text("\n".join(self.lines() if lines is None else lines) + "\n", encoding="utf-8")
        return path

    def mapping(self, **changes):
        """Write the mapping, with lines that begin with a key replaced or added."""
        lines = {line.split(":")[0]: line for line in MAP.splitlines()}
        lines |= {key: f"{key}: {value}" for key, value in changes.items()}
        path = self.folder / "map.yaml"
        path.write_text("\n".join(line for line in lines.values() if not line.endswith(": absent")) + "\n")
        return str(path)
