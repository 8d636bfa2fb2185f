"""``gyrobench import`` as an engineer types it."""

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, EXIT_WRONG_INPUT
from tests.bench.command_line import gyrobench


def test_import_writes_table_and_record_and_says_what_it_did(log, tmp_path):
    result = gyrobench("import", log.write(), "--map", log.mapping(), "--out", "dwells.csv", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "40 dwells of 60 s" in result.stdout
    assert "Record   dwells.import.json" in result.stdout
    assert len(read_dwells(tmp_path / "dwells.csv")) == 40


def test_a_wrong_mapping_and_a_useless_log_have_their_exit_codes(log, tmp_path):
    path = log.write()
    wrong = gyrobench(
        "import", path, "--map", log.mapping(gyro="{unit: deg/s, x: a, y: gy, z: gz}"), cwd=tmp_path
    )
    assert wrong.returncode == EXIT_WRONG_INPUT
    assert "there is no column 'a'. It has 5: time, gx, gy, gz, temp" in wrong.stderr
    useless = gyrobench("import", path, "--map", log.mapping(window_s=7200), cwd=tmp_path)
    assert useless.returncode == EXIT_NOT_FINISHED
    assert "no window of 7200 s is valid" in useless.stderr
    assert not (tmp_path / "dwells.csv").exists()


def test_the_mapping_may_be_a_shipped_one_by_name(log, tmp_path):
    result = gyrobench("import", log.write(), "--map", "nothing", cwd=tmp_path)
    assert result.returncode == EXIT_WRONG_INPUT
    assert "Shipped imports: emulated_ins, example_log, ln100, tofupilot_imu" in result.stderr
