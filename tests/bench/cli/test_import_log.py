"""``gyrobench import`` as an engineer types it."""

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED
from tests.bench.command_line import output_of, refusal_of


def test_import_writes_table_and_record_and_says_what_it_did(log, tmp_path):
    printed = output_of("import", log.write(), "--map", log.mapping(), "--out", "dwells.csv", cwd=tmp_path)
    assert "40 dwells of 60 s" in printed
    assert "Record   dwells.import.json" in printed
    assert len(read_dwells(tmp_path / "dwells.csv")) == 40


def test_a_wrong_mapping_and_a_useless_log_have_their_exit_codes(log, tmp_path):
    path = log.write()
    problem = refusal_of(
        "import", path, "--map", log.mapping(gyro="{unit: deg/s, x: a, y: gy, z: gz}"), cwd=tmp_path
    )
    assert "there is no column 'a'. It has 5: 'time', 'gx', 'gy', 'gz', 'temp'" in problem
    refusal = refusal_of(
        "import", path, "--map", log.mapping(window_s=7200), cwd=tmp_path, code=EXIT_NOT_FINISHED
    )
    assert "no window of 7200 s is valid" in refusal
    assert not (tmp_path / "dwells.csv").exists()


def test_the_mapping_may_be_a_shipped_one_by_name(log, tmp_path):
    problem = refusal_of("import", log.write(), "--map", "nothing", cwd=tmp_path)
    assert "Shipped imports: emulated_ins, example_log, ln100, tofupilot_imu" in problem
