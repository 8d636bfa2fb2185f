"""Files to start from: right as they are, and with all that is commented out."""

import re
from pathlib import Path

import pytest

from gyrobench.bench.authoring.file_kinds import PROCEDURE, STATION, check_file, schema_of
from gyrobench.bench.authoring.new_files import new_procedure, new_station
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.packages import CHAMBERS, RATE_TABLES, installed
from gyrobench.bench.foundations.shipped import TEMPLATES, shipped_names
from gyrobench.bench.station.station_file import StationFile
from tests.bench.authoring.filled_in import NUMBERS, filled_in

LIKE = [*TEMPLATES, *shipped_names("procedures")]
#: A line that is commented out, not one that explains.
LEFT_OUT = re.compile(r"^( *)#((?:  )*)(?=\S)", re.MULTILINE)
CHAMBER_DIALECTS = installed(CHAMBERS)
#: The example's table has two axes.
TABLE_DIALECTS = [name for name in installed(RATE_TABLES) if name != "ideal_aerosmith"]


def written(text, path):
    path.write_text(text)
    return path


def uncommented(text):
    head, _, rest = text.partition("\n\n")
    return f"{head}\n\n" + LEFT_OUT.sub(r"\1\2", rest.partition("\n# Kinds of step")[0])


@pytest.mark.parametrize("like", LIKE)
def test_a_new_procedure_is_right_as_it_is_and_with_every_optional_key(like, tmp_path):
    path = tmp_path / "mine.yaml"
    text = new_procedure("mine", like, path)
    for each in (text, uncommented(text)):
        assert check_file(written(each, path)).text == ""
    assert read_document(path).data.keys() == schema_of(PROCEDURE)["properties"].keys()


def test_a_new_procedure_has_the_steps_of_what_it_is_like(tmp_path):
    path = written(new_procedure("mine", "check", tmp_path / "a.yaml"), tmp_path / "a.yaml")
    shipped = read_document(Path(__file__).parents[3] / "procedures" / "ten_minute_check.yaml")
    assert read_document(path).data["steps"] == shipped.data["steps"]


def test_a_new_procedure_explains_every_step_and_key(tmp_path):
    text = new_procedure("mine", "check", tmp_path / "a.yaml")
    for name, section in schema_of(PROCEDURE)["$defs"].items():
        if name not in ("entry", "variable"):
            assert all(re.search(rf"\b{key}\b", text) for key in section.get("properties", {})), name


@pytest.mark.parametrize("chamber", CHAMBER_DIALECTS)
@pytest.mark.parametrize("table", TABLE_DIALECTS)
def test_a_new_station_is_right_once_filled_in_and_with_every_optional_key(table, chamber, tmp_path):
    path = tmp_path / "mine.yaml"
    text = filled_in(new_station("mine", path, table, chamber))
    for each in (text, uncommented(text)):
        assert check_file(written(each, path)).text == ""
    data = read_document(path).data
    assert data.keys() == StationFile.model_fields.keys()
    assert data["interlocks"].keys() == schema_of(STATION)["$defs"]["Interlocks"]["properties"].keys()
    assert data["chamber"]["dialect"] == chamber
    assert data["rate_table"]["dialect"] == table


def test_a_new_station_is_wrong_until_each_number_of_the_bench_is_filled_in(tmp_path):
    path = tmp_path / "mine.yaml"
    problems = check_file(written(new_station("mine", path), path), STATION).problems()
    assert len(problems) == len(NUMBERS)
    for key, problem in zip(NUMBERS, problems, strict=True):
        assert re.fullmatch(rf"'{key}' must be a (number|list \(.*\)); found \"fill_in\"", problem.message)


def test_optional_keys_of_a_station_show_their_defaults(tmp_path):
    text = new_station("mine", tmp_path / "mine.yaml")
    assert re.search(
        r"^#  tolerance_c: 5.0 +# allowed difference of the air", text.replace("\n  #", "\n#"), re.M
    )


def test_a_bound_that_only_keeps_computations_finite_is_left_out(tmp_path):
    text = new_station("mine", tmp_path / "mine.yaml")
    assert "1e+09" not in text
    assert re.search(r"jerk_dps3: fill_in +# largest jerk, deg/s3; above 0\n", text)


def test_lines_are_not_longer_than_a_screen(tmp_path):
    texts = new_station("mine", tmp_path / "a.yaml"), new_procedure("mine", "check", tmp_path / "a.yaml")
    lines = "\n".join(texts).splitlines()
    assert max(len(line) for line in lines if "yaml-language-server" not in line) <= 110


def test_a_dialect_that_is_not_installed_is_reported_with_those_that_are(tmp_path):
    with pytest.raises(DocumentError, match=r"watlow_f5.*watlow_f4"):
        new_station("mine", tmp_path / "a.yaml", chamber="watlow_f5")
    # No file has a place that could be named.
    with pytest.raises(
        DocumentError, match=r"^no dialect 'acl' of a rate table is installed; installed: acu"
    ):
        new_station("mine", tmp_path / "a.yaml", table="acl")


def test_a_name_that_can_not_be_one_is_refused(tmp_path):
    with pytest.raises(DocumentError, match="procedure"):
        new_procedure("my procedure", "check", tmp_path / "a.yaml")
