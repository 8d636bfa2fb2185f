import re
from pathlib import Path
from typing import get_args

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.faults.fault import Persistence, Timing
from gyrobench.drivers.emulators.faults.injector import AnyFault, load_faults

KINDS = {get_args(kind.model_fields["fault"].annotation)[0]: kind for kind in get_args(get_args(AnyFault)[0])}
PAGE = (Path(__file__).parents[4] / "docs" / "faults.md").read_text()


def mistake(tmp_path, entry):
    path = tmp_path / "faults.yaml"
    path.write_text(f"faults:\n  - {entry}\n")
    with pytest.raises(DocumentError) as caught:
        load_faults(path)
    return str(caught.value).removeprefix(f"{path}:")


@pytest.mark.parametrize(
    ("entry", "place", "message"),
    [
        ("{fault: lost_replies, target: table, at_s: 1}", "2:6", "lost_replies"),
        ("{fault: lost_reply, at_s: 1}", "2:5", "the key 'target' is missing"),
        ("{fault: lost_reply, target: table, at_s: 1, reply: 2}", "2:49", "did you mean 'replies'"),
        ("{fault: lost_reply, target: table}", "2:5", "exactly one of the keys at_s, every_s and during"),
        ("{fault: bus_off, at_s: 1, every_s: 5, for_s: 1}", "2:5", "exactly one of the keys"),
        ("{fault: bus_off, every_s: 5}", "2:5", "a fault that repeats must end: add for_s"),
        ("{fault: table_trips, at_s: 5, for_s: 3}", "2:5", "this fault happens at one moment"),
        ("{fault: table_trips, at_s: 5, times: 3}", "2:5", "at_s is one moment"),
        ("{fault: table_trips, at_s: 5, nth: 3}", "2:5", "nth is allowed only with during"),
        ("{fault: table_trips, during: lunch}", "2:26", "during"),
        ("{fault: table_trips, at_s: -5}", "2:26", "at least 0"),
        ("{fault: bus_off, every_s: 0, for_s: 1}", "2:22", "at least 1"),
        ("{fault: lost_reply, target: table, every_s: 0.999}", "2:40", "at least 1"),
        ("{fault: wrong_crc, target: table, at_s: 5}", "2:24", "chamber"),
        ("{fault: frames_lost, at_s: 5, ids: ['0x7']}", "2:41", "whole number"),
        ("{fault: frames_lost, at_s: 5, ids: [4096]}", "2:41", "at most 2047"),
    ],
)
def test_a_mistake_is_reported_with_its_place(tmp_path, entry, place, message):
    reported = mistake(tmp_path, entry)
    assert reported.startswith(f"{place}: ")
    assert message in reported


@pytest.mark.parametrize("name", ["../injected.jsonl", "/tmp/injected.jsonl", ".hidden", ""])  # noqa: S108
def test_the_log_is_a_file_beside_the_list(tmp_path, name):
    path = tmp_path / "faults.yaml"
    path.write_text(f"log: '{name}'\nfaults: []\n")
    with pytest.raises(DocumentError, match=r":1:1: .*pattern"):
        load_faults(path)


@pytest.mark.parametrize("name", ["every_kind", "now_and_then"])
def test_the_shipped_lists_are_right(name):
    assert load_faults(find_document("faults", name)).faults


def test_a_shipped_list_has_every_kind_once():
    faults = load_faults(find_document("faults", "every_kind")).faults
    assert sorted(fault.kind for fault in faults) == sorted(KINDS)


def test_the_page_names_every_kind_with_its_keys_and_how_it_ends():
    rows = {
        match[1]: (set(re.findall(r"`(\w+)`", match[2])), match[3].strip())
        for match in re.finditer(r"^\| `(\w+)` \|[^|]*\|([^|]*)\|([^|]*)\|$", PAGE, re.MULTILINE)
    }
    assert sorted(rows) == sorted(KINDS)
    words = {
        Persistence.MOMENTARY: "moment",
        Persistence.UNTIL_USED: "when used",
        Persistence.PERMANENT: "never",
    }
    for name, kind in KINDS.items():
        own = kind.model_fields.keys() - Timing.model_fields.keys() - {"fault"}
        assert rows[name][0] == own, name
        default_s = kind.model_fields["for_s"].default
        assert rows[name][1] == (f"after {default_s:g} s" if default_s else words[kind.persistence]), name


def test_the_page_names_every_key_of_the_timing():
    for key in Timing.model_fields:
        assert f"| `{key}` |" in PAGE


def test_the_examples_of_the_page_are_right(tmp_path):
    examples = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert examples
    for example in examples:
        path = tmp_path / "example.yaml"
        path.write_text(example)
        assert load_faults(path).faults
