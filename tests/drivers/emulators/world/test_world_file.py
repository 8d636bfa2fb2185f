import re
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document, shipped_names
from gyrobench.drivers.emulators.world.undeclared_effects import UndeclaredEffect
from gyrobench.drivers.emulators.world.world_file import WorldFile, load_world

SHIPPED = {
    name: find_document("worlds", name).read_text()
    for name in (
        "gyro_a",
        "gyro_b",
        "ideal",
        "quick",
        "four_units",
        "heating_neighbour",
        "large_accelerometer_biases",
    )
}
WORLDS_PAGE = (Path(__file__).parents[4] / "docs" / "worlds.md").read_text()
WORLD = """\
world: small
latitude_deg: 36.4
height_m: 60
gyro:
  bias_dph: {x: 0.003, y: [0.001, 2.0e-5, -2.0e-7]}
accelerometer:
  bias_ug: {x: 4}
thermal:
  case_j_per_k: 3500
  sensor_noise_c: 0.0
  x: {heat_path: [0.0, -0.8, 0.6]}
  y: {heat_path: [0.6, 0.8, 0.0]}
  z: {heat_path: [0.8, 0.0, -0.6]}
ins:
  serial_number: 1000
table:
  position_error_arcsec: 0.0
undeclared_effects:
  - kind: attitude_thermal
    sensitivity_dph_per_w: [0.035, -0.030, 0.028]
    onset_c: 50
    onset_width_c: 2
"""


def load(text):
    return validate(parse_document(text, Path("w.yaml")), WorldFile)


def complaint(text):
    with pytest.raises(DocumentError) as caught:
        load(text)
    return str(caught.value)


def replaced(old, new):
    assert WORLD.count(old) == 1
    return WORLD.replace(old, new)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_worlds_load(name):
    assert load_world(find_document("worlds", name)).world == name


def test_a_number_may_be_a_polynomial_over_temperature():
    file = load(WORLD)
    assert file.gyro.bias_dph.x == 0.003
    assert file.gyro.bias_dph.y == [0.001, 2.0e-5, -2.0e-7]
    assert file.accelerometer.bias_ug.x == 4.0


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("height_m: 60", "hight_m: 60", "3:1", "unknown key 'hight_m' (did you mean 'height_m'?)"),
        ("height_m: 60", "height_ft: 60", "3:1", "unknown key 'height_ft'"),
        ("latitude_deg: 36.4", "latitude_deg: 95", "2:1", "at most 85"),
        ("latitude_deg: 36.4", "latitude_deg: '36.4'", "2:1", "must be a number"),
        ("latitude_deg: 36.4\n", "", "1:1", "the key 'latitude_deg' is missing"),
        ("bias_dph", "bias_dps", "5:3", "unknown key 'bias_dps' (did you mean 'bias_dph'?)"),
        ("{x: 0.003,", "{w: 0.003,", "5:14", "unknown key 'w'"),
        ("sensor_noise_c: 0.0", "sensor_noise_c: -0.1", "10:3", "at least 0"),
        ("sensor_noise_c: 0.0", "sensor_noise_c: .nan", "10:3", ""),
        ("[0.0, -0.8, 0.6]", "[0.0, -0.8]", "11:7", "at least 3 items"),
        ("[0.0, -0.8, 0.6]", "[0, 0.0, 0]", "11:7", "not zero"),
        ("position_error_arcsec: 0.0", "outer_axis: west", "17:3", "'east' or 'up'"),
        ("serial_number: 1000", "epoch_period_s: 0.03", "15:3", "must divide one second"),
        ("serial_number: 1000", "epoch_period_s: 0.015", "15:3", "multiple of 0.01"),
        ("serial_number: 1000", "serial_number: 1000.5", "15:3", "whole number"),
    ],
)
def test_a_mistake_is_reported_with_its_place(old, new, place, words):
    message = complaint(replaced(old, new))
    assert message.startswith(f"w.yaml:{place}: ")
    assert words in message


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("onset_c: 50\n", "onset_c: 0\n"),
        ("onset_width_c: 2", "onset_width_c: 0"),
        ("kind: attitude_thermal", "kind: phase_of_the_moon"),
        ("case_j_per_k: 3500", "case_j_per_k: 3.5"),
        ("case_j_per_k: 3500", "case_to_air_w_per_k: 5000"),
        ("[0.001, 2.0e-5, -2.0e-7]", "[]"),
        ("[0.001, 2.0e-5, -2.0e-7]", "[1, 2, 3, 4, 5, 6, 7]"),
        ("[0.001, 2.0e-5, -2.0e-7]", "[1, two]"),
    ],
)
def test_values_that_have_no_meaning_are_mistakes(old, new):
    assert re.match(r"w\.yaml:\d+:\d+: ", complaint(replaced(old, new)))


def test_all_mistakes_are_reported_at_once():
    text = replaced("height_m: 60", "hight_m: 60").replace("36.4", "95").replace("serial_number", "serial")
    places = [line.split(": ")[0] for line in complaint(text).splitlines()]
    assert places == ["w.yaml:2:1", "w.yaml:3:1", "w.yaml:15:3"]


def with_effects(*effects):
    head = WORLD[: WORLD.index("undeclared_effects")]
    return head + "undeclared_effects:\n" + "".join(f"  - {effect}\n" for effect in effects)


EFFECTS = {
    "temperature_rate": "sensitivity_dph_per_c_per_h: [1.0e-4, 0, 0]",
    "thermal_gradient": "sensitivity_dph_per_c: [0.001, 0, 0]",
    "attitude_thermal": "sensitivity_dph_per_w: [0.035, -0.030, 0.028]",
    "thermal_hysteresis": "half_width_c: 6, sensitivity_dph_per_c: [0.001, 0, 0]",
    "warm_up": "bias_dph: [0.02, 0, 0], time_constant_s: 3600",
    "time_drift": "drift_dph_per_day: [0.01, 0, 0]",
    "bias_jump": "bias_dph: [0.01, 0, 0], at_h: 20",
    "supply_ripple": "amplitude_dph: [0.01, 0, 0], period_h: 3",
    "g_sensitivity": "sensitivity_dph_per_g: [[0, 0.001, 0], [0, 0, 0], [0, 0, 0.002]]",
    "chamber_state": "bias_dph: [0.01, 0, 0]",
    "mode_hop": "bias_dph: [0.01, 0, 0], first_reset_c: -10, reset_every_c: 8",
    "loose_clamp": "sensitivity_dph_per_c: [0.001, 0, 0], free_above_c: 30",
    "dither_crossing": "gyros: [x, z], crossing_c: 30, half_width_c: 2, bias_dph: [0.01, 0.01]",
    "scale_factor_rate": "sensitivity_ppm_per_c_per_h: [0.1, 0, 0]",
    "scale_factor_drift": "drift_ppm_per_h: [0.1, 0, 0]",
    "accelerometer_gravity": "sensitivity_ug_per_g: [[1, 0, 0], [0, 0, 0], [0, 0, 0]]",
    "neighbouring_unit": "sensitivity_dph_per_k: [0.001, 0, 0]",
}


def test_the_examples_have_every_kind_of_effect():
    kinds = [each.model_fields["kind"].annotation for each in get_args(get_args(UndeclaredEffect)[0])]
    assert {*EFFECTS} == {kind for literal in kinds for kind in get_args(literal)}


@pytest.mark.parametrize("kind", EFFECTS)
def test_each_kind_of_effect_loads_with_its_keys_and_none_without(kind):
    [effect] = load(with_effects(f"{{kind: {kind}, {EFFECTS[kind]}}}")).undeclared_effects
    assert effect.kind == kind
    assert "is missing" in complaint(with_effects(f"kind: {kind}"))


@pytest.mark.parametrize("name", shipped_names("worlds"))
def test_each_shipped_world_is_in_the_table_of_the_page(name):
    table = WORLDS_PAGE[: WORLDS_PAGE.index("## Undeclared effects")]
    assert any(f"`{name}`" in line.split("|")[1] for line in table.splitlines() if line.startswith("|"))


@pytest.mark.parametrize("kind", EFFECTS)
def test_each_kind_of_effect_is_explained_with_all_its_keys(kind):
    [effect] = load(with_effects(f"{{kind: {kind}, {EFFECTS[kind]}}}")).undeclared_effects
    [row] = [line for line in WORLDS_PAGE.splitlines() if line.startswith(f"| `{kind}` |")]
    explained = re.findall("`([a-z_0-9]+)`", row.rsplit("|", 2)[1])
    assert ["kind", *explained] == [*type(effect).model_fields]


def test_several_effects_may_stand_in_a_file():
    text = with_effects(*(f"{{kind: {kind}, {keys}}}" for kind, keys in EFFECTS.items()))
    assert [effect.kind for effect in load(text).undeclared_effects] == [*EFFECTS]


@pytest.mark.parametrize(
    ("effect", "place", "words"),
    [
        ("{kind: warm_up, bias_dph: [1, 0, 0], time_constant_s: 0}", "19", "above 0"),
        ("{kind: warm_up, bias_dps: [1, 0, 0], time_constant_s: 9}", "19", "did you mean 'bias_dph'?"),
        ("{kind: warm_up, bias_dph: [1, 0], time_constant_s: 9}", "19", "at least 3 items"),
        ("{kind: g_sensitivity, sensitivity_dph_per_g: [[0, 1, 0], [0, 0, 0]]}", "19", "3 items"),
        ("{kind: phase_of_the_moon}", "19", "unknown kind 'phase_of_the_moon'"),
        ("{bias_dph: [1, 0, 0]}", "19", "kind"),
    ],
)
def test_a_mistake_in_an_effect_is_reported_with_its_place(effect, place, words):
    message = complaint(with_effects(effect))
    assert message.startswith(f"w.yaml:{place}:")
    assert words in message


@pytest.mark.parametrize("period_s", [0.01, 0.02, 0.04, 0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 1])
def test_every_period_that_goes_into_a_second_is_allowed(period_s):
    assert load(replaced("serial_number: 1000", f"epoch_period_s: {period_s}")).ins.epoch_period_s == period_s


@st.composite
def mutated(draw):
    """A shipped world with some pieces of its text cut, doubled, swapped or replaced."""
    text = draw(st.sampled_from(sorted(SHIPPED.values())))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        piece = draw(
            st.one_of(
                st.sampled_from(
                    ["", "\n", "  ", ": ", "- ", "[", "]", "{", "}", "&a ", "*a", "!!int ", "1e999"]
                ),
                st.just(text[start:end] * 2),
                st.text(max_size=4),
                st.floats().map(str),
                st.integers().map(str),
            )
        )
        text = text[:start] + piece + text[end:]
    return text


def outcome(text):
    try:
        return f"loads {load(text)}"
    except DocumentError as error:
        return str(error)


@pytest.mark.long
@given(text=mutated())
def test_a_mutated_world_either_loads_or_is_a_document_error(text):
    assert re.match(r"loads|w\.yaml:\d+:\d+: ", outcome(text))


# Several units.


def test_a_further_unit_is_as_the_first_but_for_its_own_keys():
    file = load(WORLD + "units:\n  - {gyro: {bias_dph: {x: 1}}, power_event: 7}\n  - {serial_number: 5}\n")
    second, third, fourth = (file.of_unit(number) for number in (2, 3, 4))
    assert [each.ins.serial_number for each in (file, second, third, fourth)] == [1000, 1001, 5, 1003]
    assert [each.gyro.bias_dph.x for each in (second, third, fourth)] == [1.0, 0.003, 0.003]
    assert second.undeclared_effects == fourth.undeclared_effects == file.undeclared_effects
    assert [file.power_event(number) for number in (1, 2, 3, 4)] == [2, 7, 4, 5]


def test_a_mounting_is_a_right_handed_rotation():
    wrong = WORLD.replace("table:\n", "table:\n  mounting: {x: east, y: north, z: down}\n")
    assert "right-handed" in complaint(wrong)


def test_heat_goes_from_one_unit_to_another():
    heating = "neighbour_heating:\n  - {from_unit: 2, to_unit: 2, coupling_k_per_w: 0.1}\n"
    assert "two different units" in complaint(WORLD + heating)
