"""Run folders are found wherever they lie, but not inside each other."""

from gyrobench.bench.runs.index.store import open_store


def make_run(path):
    path.mkdir(parents=True)
    (path / "journal.jsonl").write_text("{}\n")
    return path


def test_runs_are_found_at_any_depth_in_the_order_of_their_paths(tmp_path):
    for name in ("b", "a/2", "a/1"):
        make_run(tmp_path / name)
    (tmp_path / "other").mkdir()
    assert [run.path for run in open_store(str(tmp_path)).runs()] == ["a/1", "a/2", "b"]


def test_a_run_inside_a_run_is_part_of_it(tmp_path):
    make_run(make_run(tmp_path / "run") / "verify" / "none")
    assert [run.path for run in open_store(str(tmp_path)).runs()] == ["run"]


def test_the_runs_of_an_investigation_are_found(tmp_path):
    investigation = make_run(tmp_path / "investigation")
    (investigation / "start.csv").touch()
    for name in ("campaign", "block-1/run"):
        make_run(investigation / name)
    found = [run.path for run in open_store(str(tmp_path)).runs()]
    assert found == ["investigation/block-1/run", "investigation/campaign"]


def test_the_root_may_be_the_run(tmp_path):
    run = make_run(tmp_path / "run")
    assert [each.path for each in open_store(str(run)).runs()] == ["."]


def test_a_link_that_leads_back_does_not_keep_the_search_going(tmp_path):
    make_run(tmp_path / "run")
    (tmp_path / "loop").symlink_to(tmp_path)
    assert "run" in {each.path for each in open_store(str(tmp_path)).runs()}


def test_the_fingerprint_follows_the_files_that_the_index_reads(tmp_path):
    run = make_run(tmp_path / "run")

    def fingerprint():
        return next(open_store(str(tmp_path)).runs()).fingerprint

    before = fingerprint()
    (run / "report.html").write_text("not read")
    assert fingerprint() == before
    (run / "closure").mkdir()
    (run / "closure" / "closure.json").write_text("{}")
    assert fingerprint() != before
