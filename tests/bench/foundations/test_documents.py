import json
import string
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from gyrobench.bench.foundations.documents import (
    MAX_DOCUMENT_BYTES,
    Document,
    DocumentProblem,
    StrictModel,
    parse_document,
    read_document,
    validate,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document

PATH = Path("folder/test.yaml")


class Inner(StrictModel):
    temperature_c: float = Field(gt=-273.15, description="of the chamber")
    name: str = ""


class Outer(StrictModel):
    title: str
    count: int = 1
    share: float = 0.0
    on: bool = False
    inner: list[Inner] = Field(default=[])
    named: dict[str, Inner] = Field(default={})


def parse(text: str) -> Document:
    return parse_document(text, PATH)


def error_of(text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        validate(parse(text), Outer)
    return str(caught.value)


def test_a_document_becomes_its_model() -> None:
    text = (
        "title: a\ncount: 3\nshare: 1e-5\non: true\n"
        "inner:\n  - {temperature_c: 20}\nnamed: {x: {temperature_c: -5.5}}"
    )
    model = validate(parse(text), Outer)
    assert model == Outer(
        title="a", count=3, share=1e-5, on=True,
        inner=[Inner(temperature_c=20.0)], named={"x": Inner(temperature_c=-5.5)},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1), ("-7", -7), ("+7", 7), ("010", 10), ("1.5", 1.5), ("1.", 1.0), (".5", 0.5), ("1e3", 1000.0),
        ("1E-5", 1e-5), ("true", True), ("False", False), ("~", None), ("", None), ("null", None),
        ("on", "on"), ("yes", "yes"), ("no", "no"), ("1_000", "1_000"), ("12:30", "12:30"),
        ("0x1F", 31), ("0o17", 15), ("-0x1F", "-0x1F"), ("0x", "0x"),
        ("2026-01-01", "2026-01-01"), ("$name", "$name"), ("'1'", "1"), ("!!str 1", "1"), ("!!float 2", 2.0),
        ("1.2.3", "1.2.3"), ("<<", "<<"), ("=", "="),
    ],
)  # fmt: skip
def test_plain_scalars_are_those_of_yaml_1_2(text: str, value: object) -> None:
    data = parse(f"key: {text}").data
    assert data == {"key": value}
    assert type(data["key"]) is type(value)


@pytest.mark.parametrize("text", ["[60,5]", "[60,5,-30]", "[60, 5]", "[a,5, b]", "[0.5,1, 2]", "[60,\n5, 6]"])
def test_a_list_without_a_likely_decimal_comma_is_read(text: str) -> None:
    assert len(parse(f"key: {text}").data["key"]) == text.count(",") + 1


def test_every_key_and_item_knows_its_place() -> None:
    document = parse("a: 1\nb:\n  - x\n  - c: 2\n    d: [5, 6]\n")
    assert document.places[("b", 1, "d", 1)] == (5, 12)
    assert document.place(("b", 1, "c")) == f"{PATH}:4:5"
    assert document.place(("b", 0)) == f"{PATH}:3:5"


def test_the_place_of_something_missing_is_that_of_what_it_is_missing_from() -> None:
    document = parse("a:\n  b: 1\n")
    assert document.place(("a", "nothing", "deeper")) == f"{PATH}:1:1"
    assert document.place(("a", "tag", "b")) == f"{PATH}:2:3"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("title: a\ncuont: 2", "2:1: unknown key 'cuont' (did you mean 'count'?); allowed here: title"),
        ("{title: a, count: 48,1}", "1:22: unknown key '1'. A number has a decimal point, not a comma"),
        ("title: a\ncount: 48,1", 'found "48,1". A number has a decimal point, not a comma'),
        ("title: a\nshare: 4,8e1", 'found "4,8e1". A number has a decimal point, not a comma'),
        ("title: a\nzzz: 2", "2:1: unknown key 'zzz'; allowed here: title, count"),
        ("count: 2", "1:1: the key 'title' is missing"),
        ("title: a\ncount: 2.5", "2:1: 'count' must be a whole number; found 2.5"),
        ("title: a\ncount: '2'", '2:1: \'count\' must be a whole number; found "2"'),
        ("title: a\nshare: '-2.5'", 'found "-2.5". Write the number without quotes'),
        ("title: a\nshare: \u221230", 'found "\u221230". Write the minus sign as a hyphen: -30'),
        ("title: a\nnamed: {q: {temperature_c: 5, name:n}}", "2:31: unknown key 'name:n'. Put a blank after"),
        ("title: a: b", "1:9: not valid YAML: a second colon. Put a text that contains ': ' in quotes"),
        ("title: a\ninner:\n  -{name: n}", '"n}"}. Write \'- \', with a blank, before an item'),
        ("inner:\n  -{name: n, temperature_c: 5}", "2:27: not valid YAML: no blank after '-'. Write '- '"),
        ("inner: [60,5, -30]", "1:9: 60,5 is two numbers. A number has a decimal point, not a comma; put a "),
        ("title: a\ncount: 3 C/min", 'found "3 C/min". Write the number alone, in the unit of the key'),
        ("title: a\nshare: 52.1N", 'found "52.1N". Write the number alone, in the unit of the key'),
        ("title: a\nshare: share", 'found "share". A variable of a loop is written $share'),
        ("title: a\ninner: 40", "2:1: 'inner' must be a list; found 40. Put it in brackets: [40, ...]"),
        ("title: a\ninner: hot", "must be a list; found \"hot\". Put it in brackets: [hot, ...]"),
        ('title: a\ninner: "\\n"', r'must be a list; found "\n". Put it in brackets: ["\n", ...]'),
        ("title: a\ninner:", "2:1: 'inner' must be a list; found null. The items of a list are in brackets"),
        ("title: a\ncount 2\nshare: 1", "2:1: not valid YAML: no colon after the key 'count 2', or an"),
        ("title: a\ncount: true", "2:1: 'count' must be a whole number; found true"),
        ("title: a\nshare: true", "2:1: 'share' must be a number; found true"),
        ("title: a\nshare: 1e999", "2:1: 'share' must be a finite number; found Infinity"),
        ("title: 5", "1:1: 'title' must be text; found 5"),
        ("title: a\non: 1", "2:1: 'on' must be true or false; found 1"),
        ("title: a\ninner:\n - temperature_c: -300", "3:4: 'temperature_c' must be above -273.15;"),
        ("title: a\ninner:\n - name: n", "3:4: the key 'temperature_c' is missing: of the chamber"),
        ("title: a\ninner: [5]", "2:9: the value must have keys and values; found 5"),
        ("title: a\nnamed:\n  q: {temperature: 5, temperature_c: 5}", "3:7: unknown key 'temperature'"),
        ("title: a\nt{x}: 2", "2:1: unknown key 't{x}'"),
        ('title: a\n"t\\nx": 2', '2:1: unknown key "t\\nx"'),
        ("title: a\ncount: 온도", '2:1: \'count\' must be a whole number; found "온도"'),
        ("title: a\ntitle: b", "2:1: the key 'title' is given twice"),
        ("title: a\n? [1, 2]\n: 5", "a key has to be plain text"),
        ("title: .nan", '1:1: the value must be a finite number; found ".nan"'),
        ("title: -.inf", '1:1: the value must be a finite number; found "-.inf"'),
        ("count: !!int two", "1:1: expected text, a number or true/false"),
        ("share: !!float E", "1:1: expected text, a number or true/false"),
        ("on: !!bool maybe", "1:1: expected text, a number or true/false"),
        ("title: !!python/name:os.system x", "1:1: expected text, a number or true/false"),
        ("title: !!binary aGk=", "1:1: expected text, a number or true/false"),
        ("[1, 2]", "1:1: expected keys and values; found [1, 2]"),
        ("just text", "1:1: expected keys and values"),
        ("", "1:1: the file is empty"),
        ("# only a comment", "1:1: the file is empty"),
        ("title: [a", "not valid YAML"),
        ("title: [", "not valid YAML: the file ends where a value is expected. Is each bracket closed?"),
        ("title: a\n  count: 2", "2:8: not valid YAML: no colon is expected here. Check the indentation,"),
        ("a:\n\tb: 1", "2:1: not valid YAML: found a tab. Indent with spaces"),
        ("a:\n  - b\n   - c: 1", "3:7: not valid YAML: no colon is expected here. Check the"),
        ("a:\n  - b: 1\n   - c", "3:4: not valid YAML: the indentation differs from that of line 2, where"),
        ("a: {b: 1\nc: 2", "2:2: not valid YAML: expected ',' or '}', but got ':'. Is the bracket of line"),
        ("a: [1, 2", "but got '<stream end>'. Is the bracket of line 1, column 4 closed?"),
        ("a: 1\n---\nb: 2", "2:1: not valid YAML: but found another document"),
        ("title: *nowhere", "1:8: not valid YAML: found undefined alias"),
        ("title: \x07", "1:1: not valid YAML"),
        ('"\\UFFFFFFFF": 1', "1:1: not valid YAML"),
        (f"%YAML {'9' * 5000}.1\n---\na: 1", "1:1: not valid YAML"),
        ("[" * 5000, "not valid YAML: more than 50000 values or deeper than 50 levels"),
        ("title: [" + "1," * 120_000 + "]", "not valid YAML: more than 50000 values"),
        ("title: &a [*a, *a]", "1:1: more than 50000 values or deeper than 50 levels"),
        ("title: !!python/object/apply:os.system [ls]", "a value can't have the tag"),
        ("inner: !!set {a, b}", "a value can't have the tag"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_place(text: str, expected: str) -> None:
    message = error_of(text)
    assert message.startswith(f"{PATH}:")
    assert expected in message
    assert "\n" not in message


def test_all_mistakes_are_listed_in_the_order_of_the_file() -> None:
    message = error_of("inner:\n  - {temperature_c: x}\n  - {nmae: 5}\ncount: 1.5\n")
    assert [line.split(":")[1] for line in message.splitlines()] == ["1", "2", "3", "3", "4"]


def test_long_values_are_cut() -> None:
    assert len(error_of(f"title: a\ncount: {'x' * 10_000}")) < 200


@pytest.mark.parametrize("text", ["&a [*a]", "a: &b {c: *b}", "&a {x: [*a, *a, *a, *a]}"])
def test_a_document_that_contains_itself_is_refused(text: str) -> None:
    with pytest.raises(DocumentError, match="levels"):
        parse(text)


def test_aliases_that_grow_are_refused() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12)]
    with pytest.raises(DocumentError, match="more than 50000 values"):
        parse("\n".join(lines))


def test_an_alias_stands_for_the_value_at_its_anchor() -> None:
    document = parse("a: &x {b: [1]}\nc: *x\n")
    assert document.data == {"a": {"b": [1]}, "c": {"b": [1]}}
    assert document.place(("c", "b", 0)) == f"{PATH}:1:12"


def test_problems_that_are_equal_are_listed_once() -> None:
    document = parse("a: 1")
    assert str(document.error([DocumentProblem(("a",), "wrong")] * 3)) == f"{PATH}:1:1: wrong"


FRAGMENTS = ["!!int ", "!!float ", "!!null ", "!!map ", "a", ": ", "- ", "\n", "1e", "&x ", "*x", "[", "]"]


@given(
    st.one_of(
        st.text(max_size=200),
        st.text(st.sampled_from("ab1.-:?,[]{}&*!|>'\"%@`#~<= \n\t\\Ux0e"), max_size=80),
        st.lists(st.sampled_from(FRAGMENTS)).map("".join),
    )
)
def test_any_text_gives_a_document_or_a_document_error(text: str) -> None:
    message = f"{PATH}:"
    try:
        validate(parse(text), Outer)
    except DocumentError as error:
        message = str(error)
    assert message.startswith(f"{PATH}:")


SCALARS = st.one_of(
    st.booleans(), st.integers(-(10**9), 10**9), st.floats(allow_nan=False, allow_infinity=False),
    st.text(string.ascii_letters + " :#", max_size=5),
)  # fmt: skip


@given(
    st.recursive(
        SCALARS,
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.text(string.ascii_letters, min_size=1), inner, max_size=3)
        ),
        max_leaves=10,
    )
)
def test_plain_data_written_as_json_is_read_back(data: object) -> None:
    assert parse(json.dumps({"key": data})).data == {"key": data}


def test_a_file_is_read_as_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("title: 자이로\n", encoding="utf-8")
    assert read_document(path).data == {"title": "자이로"}


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    broken = tmp_path / "broken.yaml"
    broken.write_bytes(b"title: \xff\xfe")
    large = tmp_path / "large.yaml"
    large.write_text("#" * (MAX_DOCUMENT_BYTES + 1))
    for path, message in [
        (tmp_path / "missing.yaml", "No such file"),
        (tmp_path, "folder"),
        (broken, "not UTF-8 text: invalid start byte in line 1. Save it with the encoding UTF-8"),
        (large, "at most 1000000"),
    ]:
        with pytest.raises(DocumentError, match=message) as caught:
            read_document(path)
        assert str(path) in str(caught.value)


def test_a_shipped_file_is_found_by_its_name_and_any_file_by_its_path(tmp_path: Path) -> None:
    assert find_document("procedures", "ten_minute_check").name == "ten_minute_check.yaml"
    own = tmp_path / "own.yaml"
    own.touch()
    assert find_document("procedures", str(own)) == own


@pytest.mark.parametrize("name", ["nothing", "nothing.yaml", "folder/nothing"])
def test_a_file_that_does_not_exist_is_answered_with_the_shipped_names(name: str) -> None:
    with pytest.raises(DocumentError, match=r"Shipped procedures: .*six_position_fig7, ten_minute_check"):
        find_document("procedures", name)


@pytest.mark.parametrize("name", ["six_position_fig", "six_position_fig.yaml"])
def test_the_nearest_shipped_name_is_suggested(name: str) -> None:
    with pytest.raises(DocumentError, match=r"did you mean 'six_position_fig7'\?"):
        find_document("procedures", name)


class WithOldValues(StrictModel):
    renamed_values: ClassVar = {"resume": {"nobody": "automatic"}, "on": {"goes_on": "resumes"}}
    resume: str = "operator"
    on: list[str] = Field(default=[])


class WithOldNames(StrictModel):
    renamed_keys: ClassVar = {"most_times": "max_times"}
    max_times: int = Field(default=1, le=5)
    inner: WithOldValues = WithOldValues()


def test_old_names_of_keys_and_values_are_accepted_and_say_what_replaces_them(caplog) -> None:
    text = "most_times: 3\ninner:\n  resume: nobody\n  on: [goes_on, other]\n"
    made = validate(parse_document(text, Path("a.yaml")), WithOldNames)
    assert made == WithOldNames(max_times=3, inner=WithOldValues(resume="automatic", on=["resumes", "other"]))
    assert [record.getMessage() for record in caplog.records] == [
        "a.yaml:1:1: 'most_times' is an old name. Write 'max_times'.",
        "a.yaml:4:3: 'on: goes_on' is an old name. Write 'on: resumes'.",
        "a.yaml:3:3: 'resume: nobody' is an old name. Write 'resume: automatic'.",
    ]


def test_present_names_cause_no_note(caplog) -> None:
    validate(parse_document("max_times: 3\ninner: {resume: automatic}", Path("b.yaml")), WithOldNames)
    assert not caplog.records


def test_mistakes_under_an_old_name_are_reported_where_it_stands() -> None:
    for text, message in (
        ("inner: {}\nmost_times: 9", r"a.yaml:2:1: .*at most 5; found 9"),
        ("inner: {}\nmax_times: 1\nmost_times: 2", r"a.yaml:3:1: unknown key 'most_times'.*'max_times'"),
    ):
        with pytest.raises(DocumentError, match=message):
            validate(parse_document(text, Path("a.yaml")), WithOldNames)


def test_the_note_of_an_old_name_goes_to_standard_error(tmp_path: Path) -> None:
    path = tmp_path / "old.yaml"
    path.write_text("procedure: a\nmost_repeats: 1\nsteps: [power_off]\n")
    done = subprocess.run(
        [sys.executable, "-c", "from gyrobench.bench.cli import main; main()", "validate", str(path)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0
    assert done.stderr == f"{path}:2:1: 'most_repeats' is an old name. Write 'max_repeats'.\n"
    assert "old.yaml" in done.stdout
