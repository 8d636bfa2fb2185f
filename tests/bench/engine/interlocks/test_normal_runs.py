"""What a run without faults does trips nothing: its telemetry through the watch."""

import math
from dataclasses import replace

import numpy as np

from gyrobench.bench.engine.bench_state import ExpectedState
from gyrobench.bench.runs.telemetry import read_telemetry
from gyrobench.drivers.ins.readout import InsMode
from tests.bench.engine.interlocks.watched_bench import FakeStatus, air, at


def trips_of(folder, bench):
    """Names of all interlocks that trip when the watch is shown a run again, and the rows shown."""
    telemetry = read_telemetry(folder.telemetry)
    tripped = set()
    for index, time_s in enumerate(telemetry["time_s"]):
        row = {name: float(values[index]) for name, values in telemetry.items()}
        is_on = row["ins_mode"] != InsMode.UNKNOWN
        set_c = None if math.isnan(row["chamber_set_c"]) else row["chamber_set_c"]
        bench.table = at((row["outer_deg"], row["inner_deg"]), (row["outer_rate_dps"], row["inner_rate_dps"]))
        bench.chamber = air(row["chamber_c"], set_c, set_c is not None)
        bench.ins = FakeStatus(
            age_s=0.5 if is_on else math.inf,
            mode=InsMode(int(row["ins_mode"])),
            optics_c=np.array([row[f"gyro_{axis}_c"] for axis in "xyz"]),
            electronics_c=np.array([row[f"board_{axis}_c"] for axis in "xyz"]),
            case_c=row["case_c"],
        )
        is_on_commanded = None if set_c is None else True
        bench.expected = replace(ExpectedState(set_c, is_on_commanded, ins_on=is_on), table_prepared=True)
        tripped |= bench.poll(time_s - bench.clock.now()).keys()
    return tripped, len(telemetry["time_s"])


PROCEDURE = """procedure: up_and_down
steps:
  - power_on: {settle_s: 60}
  - chamber: {temperature_c: 45, ramp_c_per_min: 10}
  - go_to: {position: z_up, rate_dps: 30, settle_s: 0}
  - align: {duration_s: 60}
  - navigate: {duration_s: 61}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 61}
  - power_off: {}
  - chamber: {temperature_c: -5, ramp_c_per_min: 10}
  - power_on: {settle_s: 300}
"""


def test_ramps_power_cycles_and_turns_as_fast_as_the_station_allows_trip_nothing(
    run_procedure, watched, tmp_path
):
    (tmp_path / "up_and_down.yaml").write_text(PROCEDURE)
    folder, outcome, _ = run_procedure(
        tmp_path / "up_and_down.yaml", tmp_path / "run", "quick", station="quick"
    )
    assert outcome.ended == "finished", outcome.reason
    tripped, rows = trips_of(folder, watched(name="quick"))
    assert tripped == set()
    assert rows > 50
