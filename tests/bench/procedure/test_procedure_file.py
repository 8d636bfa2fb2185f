import copy
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure import procedure_file
from gyrobench.bench.procedure.checks import StationLimits, check_plan
from gyrobench.bench.procedure.plan import Plan, expand
from gyrobench.bench.procedure.procedure_file import Repeat, checked_procedure, load_procedure
from gyrobench.bench.procedure.steps import GoTo, Wait
from gyrobench.bench.procedure.timeline import position_spans, timeline_rows

PROCEDURES = Path(__file__).parents[3] / "procedures"

# (steps from line 3 on, place, parts of the message)
WRONG_FILES = {
    "unknown step": (
        "- algin: {duration_s: 5}",
        "3:3",
        ['unknown step "algin"', "'align'", "power_on", "repeat"],
    ),
    "step without colon": (
        "- align {duration_s: 5}",
        "3:3",
        ["no colon after 'align'. Write 'align: {key: value, ...}'"],
    ),
    "unknown step without likeness": ("- 7: {}", "3:3", ['unknown step "7"', "allowed here: power_on"]),
    "unknown key": (
        "- align: {duration_min: 5}",
        "3:11",
        ["unknown key 'duration_min'", "'duration_s'", "until_fine"],
    ),
    "missing key": (
        "- power_off\n- chamber: {temperature_c: 5}",
        "4:3",
        ["the key 'ramp_c_per_min' is missing"],
    ),
    "text for a number": ("- wait: {duration_s: ten}", "3:10", ["must be a number", '"ten"']),
    "number for text": ("- ask_operator: {question: 5}", "3:18", ["must be text", "found 5"]),
    "negative duration": ("- wait:\n    duration_s: -5", "4:5", ["above 0", "found -5"]),
    "two steps in one item": ("- power_on:\n  power_off:", "3:3", ["expected one step", "name: {key: value"]),
    "step is a number": ("- 5", "3:3", ["expected one step", "found 5"]),
    "step is a list": ("- [power_on]", "3:3", ["expected one step"]),
    "keys are a number": ("- wait: 5", "3:3", ["expected the keys of 'wait'", "found"]),
    "keys are a variable": ("- wait: $x", "3:3", ["expected the keys of 'wait'"]),
    "no steps": ("  []", "2:1", ["at least 1 item"]),
    "given twice": ("- wait: {duration_s: 5, duration_s: 6}", "3:25", ["given twice"]),
    "loop without steps": ("- repeat: {over: {cycle: [1]}}", "3:3", ["the key 'steps' is missing"]),
    "loop over nothing": ("- repeat: {over: {}, steps: [power_off]}", "3:12", ["at least 1 item"]),
    "empty list": ("- repeat: {over: {n: []}, steps: [power_off]}", "3:19", ["at least 1 item"]),
    "no list": ("- repeat: {over: {n: 5}, steps: [power_off]}", "3:19", ["must be a list"]),
    "list of lists": ("- repeat: {over: {n: [[1]]}, steps: [power_off]}", "3:23", ["a number or text"]),
    "list of booleans": ("- repeat: {over: {n: [true]}, steps: [power_off]}", "3:23", ["a number or text"]),
    "variable in a list": (
        "- repeat: {over: {n: [$m]}, steps: [power_off]}",
        "3:23",
        ["not other variables"],
    ),
    "odd name": (
        "- repeat: {over: {N 1: [1]}, steps: [power_off]}",
        "3:19",
        ["lower-case letters, digits and underscores"],
    ),
    "wrong within a loop": (
        "- repeat:\n    over: {n: [1]}\n    steps:\n      - turn: {angle_deg: 5, rate: 1}",
        "6:30",
        ["'rate_dps'"],
    ),
    "undefined variable": (
        "- wait: {duration_s: $time_s}",
        "3:10",
        ["no variable $time_s", "defined here: none"],
    ),
    "misspelt variable": (
        "- repeat: {over: {time_s: [1]}, steps: [{wait: {duration_s: $tim_s}}]}",
        "3:49",
        ["no variable $tim_s", "did you mean 'time_s'", "$time_s"],
    ),
    "undefined variable below a key": (
        "- navigate: {until: {bias_sigma_below_dph: $sigma}, at_most_s: 900}",
        "3:22",
        ["no variable $sigma", "defined here: none"],
    ),
    "variable of a key below another that no step uses": (
        "- repeat: {over: {bias_sigma_below_dph: [1]}, steps: [power_off]}",
        "3:19",
        ["no step in the loop uses its variable $bias_sigma_below_dph"],
    ),
    "unknown key below another": (
        "- navigate: {until: {bias_sigma_below_dph: 1, sigma: 1}, at_most_s: 900}",
        "3:47",
        ["unknown key 'sigma'", "allowed here: bias_sigma_below_dph"],
    ),
    "missing key below another": (
        "- navigate: {until: {}, at_most_s: 900}",
        "3:14",
        ["the key 'bias_sigma_below_dph' is missing"],
    ),
    "number for keys": ("- navigate: {until: 0.002, at_most_s: 900}", "3:14", ["found 0.002"]),
    "variable after its loop": (
        "- repeat: {over: {a: [1]}, steps: [power_off]}\n- wait: {duration_s: $a}",
        "4:10",
        ["no variable $a"],
    ),
    "shadowed variable": (
        "- repeat:\n    over: {a: [1]}\n    steps:\n      - repeat: {over: {a: [2]}, steps: [power_off]}",
        "6:25",
        ["a is a variable of an enclosing repeat already"],
    ),
    "unused temperature": (
        "- repeat: {over: {temperature_c: [1, 2]}, steps: [power_off]}",
        "3:19",
        ["no step in the loop uses its variable $temperature_c"],
    ),
    "unused set points under another name": (
        "- repeat: {over: {set_points: [60, -30]}, steps: [power_off]}",
        "3:19",
        ["no step in the loop uses its variable $set_points", "repetition: [1, 2, 3]"],
    ),
    "mistyped cycle, whose values count": (
        "- repeat: {over: {cycles: [1, 2]}, steps: [power_off]}",
        "3:19",
        ["no step in the loop uses its variable $cycles (did you mean 'cycle'?)"],
    ),
    "unused single set point": (
        "- repeat: {over: {n: [1, 2], hot_c: [60]}, steps: [power_off]}",
        "3:30",
        ["no step in the loop uses its variable $hot_c"],
    ),
    "mistyped variable, which leaves that of the loop unused": (
        "- repeat: {over: {temperature_c: [1, 2]}, "
        "steps: [{repeat: {over: {n: [1, 2]}, "
        "steps: [{chamber: {temperature_c: $temprature_c, ramp_c_per_min: 1}}]}}]}",
        "3:99",
        ["no variable $temprature_c", "did you mean 'temperature_c'"],
    ),
    "cycle 0": (
        "- repeat: {over: {cycle: [1, 0]}, steps: [power_off]}",
        "3:30",
        ["whole number from 1", "found 0"],
    ),
    "cycle twice": (
        "- repeat: {over: {cycle: [1, 2, 1]}, steps: [power_off]}",
        "3:33",
        ["the cycle 1 is given twice", "both passes would count as one", "cycle: [1, 2, 3]"],
    ),
    "cycle 1.5": (
        "- repeat: {over: {cycle: [1.5]}, steps: [power_off]}",
        "3:27",
        ["whole number", "found 1.5"],
    ),
    "position twice": (
        "- repeat: {over: {position: [z_up, z_up]}, steps: [{go_to: {position: $position}}]}",
        "3:36",
        ["z_up is given twice"],
    ),
    "loop value out of range": (
        "- repeat: {over: {t: [20, -500]}, steps: [{chamber: {temperature_c: $t, ramp_c_per_min: 1}}]}",
        "3:27",
        ["above -273.15", "found -500", "for temperature_c of chamber"],
    ),
    "loop value out of range below a key": (
        "- repeat: {over: {s: [1, 20]}, "
        "steps: [{navigate: {until: {bias_sigma_below_dph: $s}, at_most_s: 900}}]}",
        "3:26",
        ["at most 10", "found 20", "for bias_sigma_below_dph of navigate"],
    ),
    "loop value of wrong kind": (
        "- repeat: {over: {t: [20, warm]}, steps: [{chamber: {temperature_c: $t, ramp_c_per_min: 1}}]}",
        "3:27",
        ["must be a number", '"warm"'],
    ),
    "loop value that contradicts": (
        "- repeat: {over: {t: [9, 5]}, steps: [{align: {duration_s: 6, until_fine: true, at_most_s: $t}}]}",
        "3:40",
        ["at_most_s (5) is below duration_s (6)"],
    ),
    "too many steps": (
        "- power_off\n- repeat: {over: {a: [%s], b: [%s]}, steps: [power_off]}" % (("1, " * 400,) * 2),
        "4:3",
        ["160001 steps", "at most 100000"],
    ),
}

ALL_KINDS = """
procedure: every_kind
description: text
assumptions: [one, two]
bin_width_c: 5
steps:
  - power_on: {settle_s: 60}
  - ask_operator: {question: "Closed?", answers: [yes, no], timeout_s: 600}
  - repeat:
      over: {cycle: [1, 2], temperature_c: [20, -5.5]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 1.5, within_c: 0.5}
        - soak: {until_gyro_rate_below_c_per_h: 2, at_least_s: 10, at_most_s: 5000}
        - repeat:
            over: {position: [z_up, y_down]}
            steps:
              - go_to: {position: $position, azimuth_deg: 0, rate_dps: 10}
              - align: {duration_s: 100, until_fine: true, at_most_s: 900, euler_sequence: pry_231}
              - navigate: {duration_s: 600}
              - turn: {angle_deg: 90, rate_dps: 5, settle_s: 5}
              - wait: {duration_s: 1}
              - navigate: {until: {bias_sigma_below_dph: 0.002}, at_least_s: 120, at_most_s: 900}
              - repeat:
                  over: {azimuth_deg: [0, 180]}
                  steps:
                    - go_to: {position: $position, azimuth_deg: $azimuth_deg}
                    - align: {duration_s: 600}
                    - navigate: {duration_s: 600, purpose: calibration_check}
  - soak: {for_s: 100}
  - power_off
  - chamber_off:
"""


@pytest.mark.parametrize(("steps", "place", "parts"), WRONG_FILES.values(), ids=WRONG_FILES)
def test_a_mistake_is_named_with_its_place_and_what_is_allowed(planned, steps, place, parts):
    with pytest.raises(DocumentError) as caught:
        planned(steps)
    message = str(caught.value)
    assert message.startswith(f"test.yaml:{place}: ")
    assert "\n" not in message
    assert [part for part in parts if part not in message] == []


def test_values_that_a_step_cant_take_are_reported_with_a_misspelt_variable(planned):
    with pytest.raises(DocumentError) as caught:
        planned(
            "- repeat:\n    over: {cycle: [a], position: [z_upp], time_s: [1]}\n    steps:\n"
            "      - {go_to: {position: $position}}\n      - {wait: {duration_s: $tim_s}}"
        )
    cycle, position, variable = str(caught.value).splitlines()
    assert "a cycle is a whole number" in cycle
    assert "no such position (did you mean 'z_up'?)" in position
    assert "no variable $tim_s" in variable


@pytest.mark.parametrize(
    ("text", "place", "part"),
    [
        ("steps: [power_off]", "1:1", "the key 'procedure' is missing"),
        ("procedure: a b\nsteps: [power_off]", "1:1", "may have letters, digits, _ and - only"),
        ("procedure: a\nsteps: power_off", "2:1", "must be a list"),
        ("procedure: a\nbin_width: 5\nsteps: [power_off]", "2:1", "did you mean 'bin_width_c'"),
        ("procedure: a\nbin_width_c: 0\nsteps: [power_off]", "2:1", "at least 0.1"),
        ("procedure: a\nassumptions: text\nsteps: [power_off]", "2:1", "must be a list"),
        ("procedure: a\nsteps: [power_off", "2:18", "not valid YAML"),
        ("- power_off", "1:1", "expected keys and values"),
    ],
)
def test_a_mistake_at_the_top_is_named_with_its_place(text, place, part):
    with pytest.raises(DocumentError, match=part) as caught:
        checked_procedure(parse_document(text, Path("test.yaml")))
    assert str(caught.value).startswith(f"test.yaml:{place}: ")


def test_all_mistakes_are_listed_at_once_in_the_order_of_the_file(planned):
    steps = "- wait: {duration_s: -1}\n- nothing\n- repeat: {over: {a: [1]}, steps: [{turn: {angle: 5}}]}"
    with pytest.raises(DocumentError) as caught:
        planned(steps)
    places = [line.split(" ")[0] for line in str(caught.value).splitlines()]
    assert places == ["test.yaml:3:10:", "test.yaml:4:3:", "test.yaml:5:37:", "test.yaml:5:44:"]


def test_a_station_in_place_of_a_procedure_is_named_with_what_to_write():
    path = find_document("stations", "quick")
    with pytest.raises(DocumentError) as caught:
        load_procedure(path)
    assert str(caught.value) == (
        f"{path}:2:1: this is a station file, not a procedure file. Give it with --station, as in: gyrobench "
        f"run PROCEDURE --station {path}"
    )


def test_a_value_wrong_in_every_pass_is_reported_once(planned):
    steps = (
        "- repeat: {over: {n: [1, 2, 3], t: [-500]}, "
        "steps: [{chamber: {temperature_c: $t, ramp_c_per_min: 1}}]}"
    )
    with pytest.raises(DocumentError) as caught:
        planned(steps)
    assert len(str(caught.value).splitlines()) == 1


def test_a_variable_stands_for_the_value_of_any_key(planned):
    over = "{rate: [5], angle: [-90], sequence: [rpy_321], time: [7.5], text: ['Ready?'], "
    over += "sigma: [0.002], purpose: [calibration]}"
    steps = (
        f"- repeat:\n    over: {over}\n    steps:\n"
        "      - align: {duration_s: $time, euler_sequence: $sequence}\n"
        "      - turn: {angle_deg: $angle, rate_dps: $rate}\n"
        "      - navigate: {until: {bias_sigma_below_dph: $sigma}, at_most_s: 900, purpose: $purpose}\n"
        "      - ask_operator: {question: $text}\n"
    )
    _, plan = planned(steps)
    values = [planned_step.step.model_dump(exclude_unset=True) for planned_step in plan.steps]
    assert values == [
        {"duration_s": 7.5, "euler_sequence": "rpy_321"},
        {"angle_deg": -90, "rate_dps": 5},
        {"until": {"bias_sigma_below_dph": 0.002}, "at_most_s": 900, "purpose": "calibration"},
        {"question": "Ready?"},
    ]


def test_a_step_may_stand_without_keys_in_three_ways(planned):
    _, plan = planned("- power_off\n- power_off:\n- power_off: {}")
    assert [planned_step.step.name for planned_step in plan.steps] == ["power_off"] * 3


def test_a_file_with_every_kind_of_step_is_read(tmp_path):
    path = tmp_path / "every.yaml"
    path.write_text(ALL_KINDS, encoding="utf-8")
    document, procedure = load_procedure(path)
    assert document.path == path
    assert (procedure.procedure, procedure.bin_width_c, len(procedure.steps)) == ("every_kind", 5.0, 6)
    assert isinstance(procedure.steps[2], Repeat)


LIMITS = StationLimits(-40.0, 70.0, 5.0, 60.0, lambda position, azimuth_deg, turns_deg: None)

JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**30), 10**30), st.floats(), st.text(max_size=8),
    st.sampled_from([
        "$temperature_c", "$position", "$cycle", "$nothing", "z_up", "power_on", "repeat", [], {}, [[]],
        {"wait": None}, {"wait": {"duration_s": 5}},
        {"repeat": {"over": {"cycle": [3]}, "steps": ["power_off"]}},
        1e308, 5e-324, 0, -1, 60, [1, 1], ["z_up", "x_up"], {"position": ["z_up"]}, "a\nb", "{}", "\x85",
    ]),
)  # fmt: skip


def mutate(data, chance, junk):
    """Change one place of nested data: a value, a key, or the number of items."""
    containers = [data]
    for container in containers:
        values = container.values() if isinstance(container, dict) else container
        containers += [value for value in values if isinstance(value, dict | list) and value]
    container = chance.choice(containers)
    if isinstance(container, list):
        index = chance.randrange(len(container))
        change = chance.choice(["replace", "delete", "double"])
        if change == "replace":
            container[index] = junk
        elif change == "delete":
            del container[index]
        else:
            container.append(copy.deepcopy(container[index]))
        return
    key = chance.choice(list(container))
    change = chance.choice(["replace", "replace", "delete", "rename"])
    if change == "replace":
        container[key] = junk
        return
    value = container.pop(key)
    if change == "rename":
        container[str(junk)] = value


def outcome(text):
    try:
        document = parse_document(text, Path("test.yaml"))
        plan = expand(document, checked_procedure(document))
        check_plan(document, plan, LIMITS)
    except DocumentError as error:
        return error
    return plan


def assert_plan_or_located_errors(text):
    result = outcome(text)
    if isinstance(result, DocumentError):
        assert all(line.startswith("test.yaml:") for line in str(result).split("\n"))
    else:
        assert 0.0 <= result.duration_s < float("inf")
        assert sum(row.dwells for row in timeline_rows(result)) == result.dwell_count
        assert position_spans(result) is not None


def test_a_variable_with_a_backslash_is_named_as_it_is_written():
    error = outcome("procedure: a\nsteps:\n  - repeat: {over: {'\\q': }, steps: [wait: {duration_s: 1}]}\n")
    assert r"'\q' must be a list; found null" in str(error)


def test_the_procedure_that_the_mutations_start_from_is_valid():
    assert isinstance(outcome(ALL_KINDS), Plan)


@pytest.mark.long
@given(st.randoms(use_true_random=False), st.lists(JUNK, min_size=1, max_size=3))
def test_a_procedure_with_changed_values_gives_a_plan_or_located_errors(chance, junk):
    data = copy.deepcopy(parse_document(ALL_KINDS, Path("test.yaml")).data)
    for value in junk:
        if data:
            mutate(data, chance, copy.deepcopy(value))
    assert_plan_or_located_errors(yaml.safe_dump(data, sort_keys=False))


@pytest.mark.long
@given(st.data(), st.sampled_from(sorted(PROCEDURES.glob("*.yaml"))))
def test_a_procedure_with_changed_characters_gives_a_plan_or_located_errors(data, path):
    text = path.read_text(encoding="utf-8")
    start = data.draw(st.integers(0, len(text)))
    end = start + data.draw(st.integers(0, 12))
    inserted = data.draw(st.text(st.sampled_from("${}[]:,-&*!|>'\"\n\t #%@0e.az\\_é"), max_size=6))
    assert_plan_or_located_errors(text[:start] + inserted + text[end:])


def test_marked_temperatures_are_none_or_those_of_the_file():
    _, paper = load_procedure(PROCEDURES / "six_position_fig7.yaml")
    _, short = load_procedure(PROCEDURES / "ten_minute_check.yaml")
    assert paper.marked_temperatures_c == [50]
    assert short.marked_temperatures_c == []


def test_the_first_variable_of_a_loop_is_the_outermost(planned):
    _, plan = planned(
        "- repeat: {over: {a: [1, 2], b: [10, 20]}, "
        "steps: [{wait: {duration_s: $a}}, {wait: {duration_s: $b}}]}"
    )
    waits = [one.step.duration_s for one in plan.steps if isinstance(one.step, Wait)]
    assert waits == [1, 10, 1, 20, 2, 10, 2, 20]


def test_an_inner_loop_sees_the_variables_of_the_outer_one(planned):
    _, plan = planned(
        "- repeat:\n    over: {azimuth: [0, 90]}\n    steps:\n"
        "      - repeat:\n          over: {position: [z_up, x_up]}\n          steps:\n"
        "            - go_to: {position: $position, azimuth_deg: $azimuth}\n"
    )
    moves = [(one.step.position, one.step.azimuth_deg) for one in plan.steps if isinstance(one.step, GoTo)]
    assert moves == [("z_up", 0), ("x_up", 0), ("z_up", 90), ("x_up", 90)]


def test_a_loop_variable_that_no_step_uses_counts_repetitions(planned):
    _, plan = planned("- repeat: {over: {again: [1, 2, 3]}, steps: [power_off]}")
    assert len(plan.steps) == 3


def test_a_step_knows_where_it_and_the_values_of_its_loop_stand(planned):
    document, plan = planned(
        "- wait: {duration_s: 5}\n"
        "- repeat:\n    over: {t: [7, 8]}\n    steps:\n      - wait: {duration_s: $t, timeout_s: 90}\n"
    )
    first, _, last = plan.steps
    assert document.place(first.location) == "test.yaml:3:3"
    assert document.place(first.place_of("duration_s")) == "test.yaml:3:10"
    assert document.place(last.location) == "test.yaml:7:9"
    assert document.place(last.place_of("duration_s")) == "test.yaml:5:19"
    assert document.place(last.place_of("timeout_s")) == "test.yaml:7:32"


def test_steps_of_an_anchor_stand_where_the_anchor_is(planned):
    document, plan = planned(
        "- repeat: {over: {n: [1]}, steps: &two [power_off, {wait: {duration_s: 5}}]}\n"
        "- repeat: {over: {n: [1]}, steps: *two}\n"
    )
    assert (
        document.place(plan.steps[1].location) == document.place(plan.steps[3].location) == "test.yaml:3:53"
    )


def test_as_many_steps_as_allowed_are_planned_and_one_more_is_refused(planned, monkeypatch):
    def loop(steps):
        return f"- repeat: {{over: {{a: {[1] * 100}, b: {[1] * (steps // 100)}}}, steps: [power_off]}}"

    with pytest.raises(DocumentError, match="100001 steps"):
        planned(loop(procedure_file.MAX_STEPS) + "\n- power_off")
    monkeypatch.setattr(procedure_file, "MAX_STEPS", 2000)
    _, plan = planned(loop(2000))
    assert len(plan.steps) == 2000
    with pytest.raises(DocumentError, match="2001 steps"):
        planned(loop(2000) + "\n- power_off")
