"""What runs show of the units of a batch: biases, and effects that searches could see."""

from gyrobench.bench.fleet.batch import EffectSize, read_batch
from gyrobench.bench.runs.index.run_index import RunIndex, Selection, find_runs
from gyrobench.bench.runs.index.store import open_store
from tests.bench.runs.index.sample_runs import copy_run, write_verdict


def test_effects_count_as_absent_only_where_a_search_could_show(sample, tmp_path):
    verdicts = {
        "a": ("explained", [("thermal_lag", 0.004)]),
        "b": ("clean", []),
        "c": ("unexplained", [("thermal_lag", 0.002)]),
    }
    for name, (verdict, effects) in verdicts.items():
        write_verdict(copy_run(sample, tmp_path / name, unit=name), verdict, effects)
    compensated = copy_run(sample, tmp_path / "d", unit="d")
    compensated.compensation.write_text("{}")
    index = RunIndex(open_store(str(tmp_path)))
    index.update()
    values = read_batch(index, find_runs(index, Selection()))
    sizes = {run.unit: run.bias_dph for run in values.pop(EffectSize("thermal_lag"))}
    assert sizes == {"a": 0.004, "b": 0.0}
    assert all({run.unit for run in runs} == {"a", "b", "c"} for runs in values.values())
