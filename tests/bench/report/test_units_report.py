from dataclasses import replace

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.report.units_report import write_units_report
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.bias.dwell_rows import dwell_row


def test_errors_that_all_dwells_of_a_position_share_do_not_average_out_over_them(tmp_path):
    rows = [
        replace(dwell_row(number, position, 20.0, 0.01, sigma_dph=0.005), common_sigma_dph=(0.004, 0.0, 0.0))
        for number, position in enumerate(("z_up", "z_down", "y_up", "y_down") * 100)
    ]
    unit = tmp_path / "units" / "A-1"
    unit.mkdir(parents=True)
    RunFolder(unit).journal.touch()
    write_dwells(RunFolder(unit).dwells, rows)
    [row] = write_units_report(RunFolder(tmp_path)).comparison.tables[0].rows
    assert row[3:] == ["10.00 ± 2.01", "10.00 ± 0.25", "10.00 ± 0.25"]
