"""Means over windows of a log, with what is needed to judge them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.sensor_log.samples import FORCES, RATES, Samples

#: Into how many blocks a window may be cut, whose means show the noise; each half of the one before.
BLOCKS = (40, 20, 10, 5)
#: Samples that a window needs.
MIN_SAMPLES = 10
#: Smallest step that is no rounding error, relative to the largest value.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Window:
    """Means of one window.

    Attributes
    ----------
    start_s, end_s : float
        Since the first sample of the log.
    samples, dropped : int
        Samples with all three rates, and those without.
    widest_step_s : float
        Longest time between two samples, also to the last one before the window.
    covered_s : float
        From the first to the last sample.
    rate_dph : ndarray, shape (3,)
        Mean rates.
    scatter_dph : ndarray, shape (3,)
        Standard deviation of the samples.
    blocks_dph : ndarray, shape (blocks, 3)
        Mean rates of as many equal parts as :data:`BLOCKS` allows, in the order of time.
    rate_step_dph : ndarray, shape (3,)
        Smallest change from one sample to the next; infinite where there is none.
    extreme_dph, longest_at_extreme : ndarray, shape (3,)
        Largest rate without its sign, and how many samples in a row it stayed.
    longest_unchanged : ndarray, shape (3,)
        How many samples in a row a rate was the same.
    means, slopes_per_h, steps, spans : dict of str to float
        Of temperatures, and of position and cycle: mean, slope, smallest change, and largest less
        smallest value. NaN where not measured.
    force : ndarray, shape (3,)
        Mean of the accelerometers; NaN where the mapping names none.
    """

    start_s: float
    end_s: float
    samples: int
    dropped: int
    widest_step_s: float
    covered_s: float
    rate_dph: FloatArray
    scatter_dph: FloatArray
    blocks_dph: FloatArray
    rate_step_dph: FloatArray
    extreme_dph: FloatArray
    longest_at_extreme: NDArray[np.intp]
    longest_unchanged: NDArray[np.intp]
    means: dict[str, float]
    slopes_per_h: dict[str, float]
    steps: dict[str, float]
    spans: dict[str, float]
    force: FloatArray


def cut_windows(batches: Iterable[Samples], window_s: float, skip_s: float) -> Iterator[Window]:
    """Cut a log into windows; those with fewer than :data:`MIN_SAMPLES` good samples have NaN for all means.

    No more than a batch and a window are held at a time.
    """
    rest: Samples = {}
    before_s = np.nan
    for batch in batches:
        late = batch["time_s"] >= skip_s
        kept = {name: values[late] for name, values in batch.items()}
        rest = {name: np.concatenate([rest[name], kept[name]]) for name in kept} if rest else kept
        index = _window_index(rest["time_s"], window_s, skip_s)
        if index.size == 0 or index[0] == index[-1]:
            continue
        begin_of_last = int(np.searchsorted(index, index[-1]))
        for part in _parts(rest, index, 0, begin_of_last):
            yield _window(part, window_s, skip_s, before_s)
            before_s = float(part["time_s"][-1])
        rest = {name: values[begin_of_last:] for name, values in rest.items()}
    if rest and rest["time_s"].size:
        yield _window(rest, window_s, skip_s, before_s)


def longest_run(same: BoolArray) -> int:
    """How many true values stand in a row at most."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _window_index(time_s: FloatArray, window_s: float, skip_s: float) -> NDArray[np.intp]:
    return np.asarray((time_s - skip_s) // window_s, dtype=np.intp)


def _parts(samples: Samples, index: NDArray[np.intp], begin: int, end: int) -> Iterator[Samples]:
    borders = np.flatnonzero(np.diff(index[begin:end])) + 1 + begin
    for first, last in zip([begin, *borders], [*borders, end], strict=True):
        yield {name: values[first:last] for name, values in samples.items()}


def _window(samples: Samples, window_s: float, skip_s: float, before_s: float) -> Window:
    time_s = samples["time_s"]
    number = int(_window_index(time_s[:1], window_s, skip_s)[0])
    rates = np.column_stack([samples[name] for name in RATES])
    good = np.isfinite(rates).all(axis=1)
    rates = rates[good]
    steps = np.diff(time_s, prepend=time_s[0] if np.isnan(before_s) else before_s)
    means, slopes, smallest, spans = {}, {}, {}, {}
    for name, values in samples.items():
        if name.endswith("_c") or name in ("position", "cycle"):
            means[name], slopes[name], smallest[name], spans[name] = _trend(time_s, values)
    enough = len(rates) >= MIN_SAMPLES
    nothing = np.full(3, np.nan)
    return Window(
        start_s=skip_s + number * window_s,
        end_s=skip_s + (number + 1) * window_s,
        samples=len(rates),
        dropped=int(good.size - len(rates)),
        widest_step_s=float(steps.max()),
        covered_s=float(time_s[-1] - time_s[0]),
        rate_dph=rates.mean(axis=0) if enough else nothing,
        scatter_dph=rates.std(axis=0, ddof=1) if enough else nothing,
        blocks_dph=_blocks(rates) if enough else np.empty((0, 3)),
        rate_step_dph=np.array([_smallest_step(rate) for rate in rates.T]),
        extreme_dph=np.abs(rates).max(axis=0, initial=0.0),
        longest_at_extreme=np.array([_longest_at_extreme(rate) for rate in rates.T]),
        longest_unchanged=np.array([1 + longest_run(np.diff(rate) == 0.0) for rate in rates.T]),
        means=means,
        slopes_per_h=slopes,
        steps=smallest,
        spans=spans,
        force=np.array([_mean(samples[name]) if name in samples else np.nan for name in FORCES]),
    )


def _blocks(rates: FloatArray) -> FloatArray:
    count = next(count for count in BLOCKS if 2 * count <= len(rates))
    return np.array([block.mean(axis=0) for block in np.array_split(rates, count)])


def _trend(time_s: FloatArray, values: FloatArray) -> tuple[float, float, float, float]:
    """Mean, slope per hour, smallest step and span; NaN, NaN, infinite and NaN without values."""
    known = np.isfinite(values)
    if not known.any():
        return np.nan, np.nan, np.inf, np.nan
    time_h, known_values = (time_s[known] - time_s[known].mean()) / 3600.0, values[known]
    mean = float(known_values.mean())
    square = float(time_h @ time_h)
    slope = float(time_h @ (known_values - mean)) / square if square > 0.0 else np.nan
    return mean, slope, _smallest_step(known_values), float(np.ptp(known_values))


def _smallest_step(values: FloatArray) -> float:
    steps = np.abs(np.diff(values))
    steps = steps[steps > _ROUNDING * np.abs(values).max(initial=0.0)]
    return float(steps.min(initial=np.inf))


def _longest_at_extreme(rate: FloatArray) -> int:
    sizes = np.abs(rate)
    return longest_run(sizes == sizes.max(initial=0.0))


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan
