"""Runs taken together: verdicts and biases of units, batches, benches, versions of procedures, months."""

from __future__ import annotations

from typing import Any, Literal

from gyrobench.bench.runs.index import RunIndex
from gyrobench.bench.runs.index_selection import Selection

Grouping = Literal["unit", "batch", "bench", "procedure", "month"]

#: What a group is called, in SQL; a version of a procedure is told by the beginning of its SHA-256.
_NAMES: dict[Grouping, str] = {
    "unit": "unit",
    "batch": "batch",
    "bench": "station",
    "procedure": "concat(procedure, ' ', left(procedure_sha256, 7))",
    "month": "strftime(started_utc, '%Y-%m')",
}

_SQL = """
WITH chosen AS (SELECT *, {name} AS name FROM runs WHERE {condition}),
levels AS (
    SELECT path, gyro, sum(bias_dph / sigma_dph ** 2) / sum(1 / sigma_dph ** 2) AS bias_dph
    FROM bins WHERE count > 0 GROUP BY path, gyro
),
biases AS (
    SELECT name, {columns}
    FROM chosen JOIN levels USING (path) WHERE NOT compensated GROUP BY name
),
counts AS (
    SELECT name, count(*) AS runs, count(DISTINCT unit) AS units,
        count(*) FILTER (verdict = 'clean') AS clean,
        count(*) FILTER (verdict = 'explained') AS explained,
        count(*) FILTER (verdict IN ('ambiguous', 'unexplained')) AS other,
        count(*) FILTER (acceptance = 'accepted') AS accepted,
        count(*) FILTER (acceptance = 'marginal') AS marginal,
        count(*) FILTER (acceptance = 'rejected') AS rejected,
        median(error_before_dph) AS error_before_dph, median(error_after_dph) AS error_after_dph
    FROM chosen GROUP BY name
)
SELECT * FROM counts LEFT JOIN biases USING (name) ORDER BY name
"""


def group_runs(index: RunIndex, by: Grouping, selection: Selection) -> list[dict[str, Any]]:
    """Count verdicts and average biases by group, over the runs that are meant.

    A run's bias is the weighted mean over its bins and positions; its spread is over the runs. Runs
    in which the INS subtracted biases have none.
    """
    condition, parameters = selection.condition()
    columns = ", ".join(
        f"{function}(bias_dph) FILTER (gyro = '{gyro}') AS {kind}_{gyro}_dph"
        for gyro in "xyz"
        for kind, function in (("bias", "avg"), ("spread", "stddev_samp"))
    )
    sql = _SQL.format(name=_NAMES[by], condition=condition, columns=columns)
    return index.query(sql, parameters).records()
