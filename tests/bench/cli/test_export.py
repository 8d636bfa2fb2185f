import pytest

from tests.bench.command_line import gyrobench


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory, short_run):
    return short_run[0].path


def test_files_and_their_sizes_are_listed(run_folder, tmp_path):
    ended = gyrobench(
        "export", run_folder, "--what", "dwells,bins", "--format", "csv", "--out", "x", cwd=tmp_path
    )
    assert ended.returncode == 0, ended.stderr
    assert [line.split()[-1] for line in ended.stdout.splitlines()] == [
        "x/dwells.csv",
        "x/bias_bins.csv",
        "x/export.json",
    ]
    assert (tmp_path / "x" / "dwells.csv").read_bytes() == (run_folder / "dwells.csv").read_bytes()


def test_files_that_are_there_are_kept_and_that_is_reported(run_folder, tmp_path):
    arguments = ("export", run_folder, "--what", "dwells", "--out", "x")
    assert gyrobench(*arguments, cwd=tmp_path).returncode == 0
    refused = gyrobench(*arguments, cwd=tmp_path)
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert gyrobench(*arguments, "--force", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--what", "dwels"), "'dwels' is not one of dwells, bins"),
        (("--format", "xlsx"), "'xlsx' is not one of parquet, csv, blf, mf4. Excel opens csv"),
        (("--what", "can", "--format", "csv"), "does not fit can"),
        (("--dwell", "1"), "--what navigation"),
    ],
)
def test_a_wrong_option_is_reported(run_folder, tmp_path, options, message):
    ended = gyrobench("export", run_folder, *options, cwd=tmp_path)
    assert ended.returncode == 2
    assert message in " ".join(ended.stderr.replace("│", " ").split())
