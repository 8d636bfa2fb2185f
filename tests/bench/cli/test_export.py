import pytest

from tests.bench.command_line import gyrobench, output_of, refusal_of


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory, short_run):
    return short_run[0].path


def test_files_and_their_sizes_are_listed(run_folder, tmp_path):
    printed = output_of(
        "export", run_folder, "--what", "dwells,bins", "--format", "csv", "--out", "x", cwd=tmp_path
    )
    assert [line.split()[-1] for line in printed.splitlines()] == [
        "x/dwells.csv",
        "x/bias_bins.csv",
        "x/export.json",
    ]
    assert (tmp_path / "x" / "dwells.csv").read_bytes() == (run_folder / "dwells.csv").read_bytes()


def test_files_that_are_there_are_kept_and_that_is_reported(run_folder, tmp_path):
    arguments = ("export", run_folder, "--what", "dwells", "--out", "x")
    assert gyrobench(*arguments, cwd=tmp_path).returncode == 0
    assert "--force" in refusal_of(*arguments, cwd=tmp_path)
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
    problem = refusal_of("export", run_folder, *options, cwd=tmp_path)
    assert message in " ".join(problem.replace("│", " ").split())
