import json

import pytest

from gyrobench.bench.engine.job import emulation_of
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation


def folder_with(options, path):
    folder = RunFolder(path)
    folder.provenance.write_text(json.dumps({"options": options}))
    return folder


def test_the_emulated_bench_of_a_run_is_read_with_defaults_for_what_its_options_lack(tmp_path):
    found = emulation_of(folder_with({"world": "gyro_b", "seed": 7}, tmp_path))
    assert found == Emulation("gyro_b", 7, "")
    assert emulation_of(folder_with({}, tmp_path)) == Emulation(faults="")


@pytest.mark.parametrize("seed", ["~", "", {}, None, 1.5, True])
def test_a_damaged_seed_of_the_emulated_bench_is_an_error_with_its_file(seed, tmp_path):
    with pytest.raises(RunFolderError, match=r"provenance\.json: damaged: the seed .* a whole number"):
        emulation_of(folder_with({"seed": seed}, tmp_path))
