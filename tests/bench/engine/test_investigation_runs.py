"""Blocks of an investigation as runs on the emulated bench."""

import shutil
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.inputs import joined_rows, read_campaign
from gyrobench.bench.engine.investigation_runs import StationBench, measure_campaign, start_with_runs
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.investigation.blocks import Block, Timeline, catalogue
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation
from tests.bench.engine.intervention import short_dwell

CAMPAIGN = """procedure: two_temperatures
steps:
  - power_on: {settle_s: 60}
  - repeat:
      over: {cycle: [1, 2], temperature_c: [40, 10]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 5.0}
        - soak: {for_s: 120}
        - repeat:
            over: {position: [z_up, y_down, x_up]}
            steps:
""" + short_dwell("$position", align_s=16, navigate_s=60, indent=14)


def observe(job):
    return nullcontext((RunObserver(), ConsentingOperator()))


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Folder of an investigation with a campaign, its job, and the clock of its bench."""
    folder = tmp_path_factory.mktemp("investigation")
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    job = prepare_job(str(folder / "campaign.yaml"), "quick", Emulation("quick_warm_up", 3))
    clock = measure_campaign(job, RunFolder(folder / "campaign"), observe)
    return job, folder, clock


@pytest.fixture(scope="module")
def measured(campaign):
    """A power cycle that was proposed, and its dwells; the bench, its rows before it."""
    job, folder, clock = campaign
    bench = StationBench(job, [folder / "campaign"], folder, observe, clock)
    block = named("power cycle", bench)
    rows = bench.measure(written(block, folder / "block-1"), folder / "block-1")
    return bench, block, rows


def named(name, bench, rows=None):
    rows = rows or bench.rows
    blocks = catalogue(rows, start=bench.start(rows))
    return bench.timed(next(block for block in blocks if block.name == name))


def written(block, folder):
    folder.mkdir()
    (folder / "plan.json").write_text(block.plan.text())
    return block.plan


def test_a_block_continues_numbers_clock_and_power_ons_of_its_campaign(measured):
    bench, block, rows = measured
    last = bench.rows[-1]
    assert [row.dwell for row in rows] == [step.dwell for step in block.plan.dwells]
    assert {row.cycle for row in rows} == {last.cycle + 1}
    assert {(row.run, row.unit) for row in rows} == {(last.run[:-1] + "2", last.unit)}
    assert rows[0].start_s > last.end_s


def test_the_dwells_of_a_block_come_when_the_planner_says(measured):
    _, block, rows = measured
    late_s = [row.start_s - step.start_s for row, step in zip(rows, block.plan.dwells, strict=True)]
    assert max(np.abs(late_s)) < 0.1 * (rows[-1].end_s - block.plan.start_s)


def test_the_emulated_bench_continues_with_its_temperatures(measured):
    bench, block, rows = measured
    forecast = Forecast(bench.rows).rows(block.plan)
    off_k = [np.array(row.gyro_c) - each.gyro_c for row, each in zip(rows, forecast, strict=True)]
    assert np.abs(off_k).max() < 3.0
    assert block.plan.state.chamber_c == pytest.approx(10.0, abs=1.0)  # not that of a room


def test_the_procedure_of_a_block_is_in_its_folder_and_measures_as_the_campaign_does(campaign, measured):
    job, folder, _ = campaign
    document, procedure = load_procedure(folder / "block-1" / "procedure.yaml")
    plan = job.station.plan(document, procedure)
    kinds = [each.step.name for each in plan.steps[-5:]]
    assert kinds == ["go_to", "align", "navigate", "turn", "navigate"]
    first = next(each.step for each in plan.steps if each.step.name == "align")
    assert first.duration_s == 16.0


def test_the_temperatures_between_the_dwells_of_blocks_are_searched_too(measured):
    bench, _, rows = measured
    together = bench.campaign([*bench.rows, *rows])
    assert len(together.record.parts) == 2
    assert together.record.time_s[-1] >= rows[-1].end_s - 60.0
    assert (together.last_cycle, bench.campaign(bench.rows).last_cycle) == (3, 2)


def test_a_block_that_the_station_cannot_run_is_not_proposed(measured):
    bench, _, rows = measured
    start = bench.start([*bench.rows, *rows])
    hot, less = (Timeline([*bench.rows, *rows], start=start) for _ in range(2))
    hot.ramp(500.0)
    hot.measure_dwells(["z_up"])
    less.set_dissipation(0.7)
    less.measure_dwells(["z_up"])
    assert bench.timed(Block(("hot",), "", hot.plan())) is None
    assert bench.timed(Block(("less power",), "", less.plan())) is None


def test_longer_dwells_navigate_longer(measured):
    bench, _, rows = measured
    block = named("longer dwells", bench, [*bench.rows, *rows])
    usual_s = np.median([row.end_s - row.start_s for row in rows])
    assert all(2.5 < (step.end_s - step.start_s) / usual_s < 3.5 for step in block.plan.dwells)


def test_the_next_block_is_planned_from_the_files_as_from_the_process(campaign, measured):
    bench, _, rows = measured
    job, folder, _ = campaign
    again = StationBench(job, [folder / "campaign"], folder, observe)
    together = [*bench.rows, *rows]
    assert again.start(together) == bench.start(together)
    assert again.start(together).power_ons == 2


def test_a_measured_block_is_taken_from_its_folder(measured):
    bench, block, rows = measured

    def refuse(job):
        raise AssertionError

    folder = bench._folder / "block-1"
    again = StationBench(bench._job, [bench._folder / "campaign"], bench._folder, refuse)
    assert again.measure(block.plan, folder) == rows


def test_the_campaign_of_another_procedure_is_refused(campaign, tmp_path):
    job, folder, _ = campaign
    other = replace(job, emulation=Emulation("quick", 3))
    with pytest.raises(RunFolderError, match="another procedure"):
        measure_campaign(other, RunFolder(folder / "campaign"), observe)


def test_rows_of_joined_tables_have_unique_numbers_on_one_time_axis(campaign, measured):
    _, folder, _ = campaign
    together = read_campaign(folder / "campaign", folder / "block-1" / "run")
    rows = joined_rows(together)
    assert [row.dwell for row in rows] == together.dwell.tolist()
    assert [row.start_s for row in rows] == pytest.approx(together.start_s.tolist())
    assert [row.cycle for row in rows] == together.cycle.tolist()


@pytest.mark.parametrize(
    ("measured_on", "station", "given", "world"),
    [
        ("quick", None, None, "quick_warm_up"),
        ("quick", "quick", None, "quick_warm_up"),
        ("mine", "quick", None, "quick"),
        ("mine", "quick", "ideal", "ideal"),
    ],
)
def test_another_station_is_emulated_with_its_own_world(
    campaign, tmp_path, measured_on, station, given, world
):
    run = RunFolder(shutil.copytree(campaign[1] / "campaign", tmp_path / "run"))
    text = run.station.read_text()
    run.station.write_text(text.replace("station: quick\n", f"station: {measured_on}\n", 1))
    start = start_with_runs([run.path], station, given, None, None)
    assert start.job.emulation == Emulation(world, 3)
