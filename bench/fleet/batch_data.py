"""What the runs of an index tell of the units of a batch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gyrobench.bench.fleet.batch_model import EffectSize, Trait
from gyrobench.bench.runs.index import RunIndex
from gyrobench.bench.runs.index_run_biases import RunBias, read_run_biases

#: Verdicts of searches that tell also what is not there.
_TELLING = ("clean", "explained")


def read_batch(index: RunIndex, runs: Sequence[Mapping[str, Any]]) -> dict[Trait, Sequence[RunBias]]:
    """Read what can be compared between units: biases, and sizes of the effects that searches found.

    Parameters
    ----------
    index : RunIndex
        Where to read.
    runs : sequence of mapping
        Rows of its table of runs.
    """
    biases = read_run_biases(index, [run["path"] for run in runs])
    values: dict[Trait, Sequence[RunBias]] = dict(biases.items())
    values.update(_effect_sizes(index, runs).items())
    return values


def _effect_sizes(index: RunIndex, runs: Sequence[Mapping[str, Any]]) -> dict[EffectSize, list[RunBias]]:
    """Size of each effect that was found in any run, in every run whose search tells it.

    A search tells the rms of an effect over its dwells as well as their noise allows.
    """
    searched = [
        run
        for run in runs
        if run["verdict"] in _TELLING
        and run["noise_dph"]
        and run["dwells_searched"]
        and not run["compensated"]
    ]
    sql = "SELECT path, effect, rms_dph FROM effects WHERE path IN (SELECT unnest(?))"
    found = {
        (row["path"], row["effect"]): row["rms_dph"]
        for row in index.query(sql, [[run["path"] for run in searched]]).records()
    }
    return {
        EffectSize(effect): [
            RunBias(
                run["path"],
                run["unit"],
                run["started_utc"],
                found.get((run["path"], effect), 0.0),
                run["noise_dph"] / math.sqrt(run["dwells_searched"]),
            )
            for run in searched
        ]
        for effect in sorted({effect for _, effect in found})
    }
