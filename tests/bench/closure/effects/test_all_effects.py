"""What holds for every effect, and for the package that finds them."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure import effects as package
from gyrobench.bench.closure.candidates import starts
from gyrobench.bench.closure.effects import all_effects
from tests.bench.closure.conftest import EQUIPPED
from tests.bench.closure.thermal_bench import (
    AGEING_H,
    HALF_WIDTH_C,
    INCLINATION_DEG,
    LAG_H,
    NEIGHBOUR_LAG_H,
    ONSET_C,
    ONSET_WIDTH_C,
    WARM_UP_H,
)

ALL = [(effect, form) for effect in all_effects() for form in effect.forms]
NAMES = {
    "temperature_rate", "thermal_gradient", "attitude_thermal", "thermal_hysteresis", "warm_up",
    "time_drift", "g_sensitivity", "chamber_state", "bias_jump",
}  # fmt: skip
#: Of the simulated effects, where they have parameters.
TRUE = {
    "attitude_thermal": (ONSET_C, ONSET_WIDTH_C),
    "thermal_hysteresis": (HALF_WIDTH_C,),
    "thermal_lag": (LAG_H * 3600.0,),
    "warm_up": (WARM_UP_H * 3600.0,),
    "chamber_state": (5.0,),
    "neighbouring_unit": (NEIGHBOUR_LAG_H * 3600.0,),
    "bias_jump": (0.4 * 3 * 67_200.0,),
    "ageing": (AGEING_H * 3600.0,),
    "magnetic_sensitivity": (INCLINATION_DEG,),
}
#: Forms that no effect is simulated by here.
OTHER_FORMS = {"heat to remove", "lagging", "logarithmic", "many widths"}
NEED_EQUIPMENT = {"magnetic_sensitivity", "supply_power", "daily_course", "ageing", "neighbouring_unit"}
#: What the columns may miss of a simulated effect: its course between the dwells has to be guessed.
MISSED = {"thermal_hysteresis": 0.02, "chamber_state": 0.01, "neighbouring_unit": 0.005}


def label(value):
    return getattr(value, "name", None)


def test_all_names_of_the_format_are_there_each_once():
    names = [each.name for each in all_effects()]
    assert set(names) >= NAMES
    assert names == sorted(set(names))


def test_a_new_module_with_an_effect_is_found(tmp_path, monkeypatch):
    (tmp_path / "moon_phase.py").write_text(
        "from gyrobench.bench.closure.effects.effect import Effect\n"
        'EFFECT = Effect("moon_phase", "the bias follows the moon", "wait two weeks", ())\n'
    )
    (tmp_path / "no_effect.py").write_text("EFFECT = 3\n")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    try:
        names = {each.name for each in all_effects()}
    finally:
        for name in ("moon_phase", "no_effect"):
            sys.modules.pop(f"{package.__name__}.{name}", None)
            vars(package).pop(name, None)
    assert names >= NAMES | {"moon_phase"}
    assert not any("no_effect" in name for name in names)


@pytest.mark.parametrize("effect", all_effects(), ids=label)
def test_an_effect_has_a_statement_and_an_experiment(effect):
    for sentence in (effect.statement, effect.experiment):
        assert len(sentence.split()) > 5
        assert not sentence.endswith(".")
    assert effect.forms
    assert len({form.name for form in effect.forms}) == len(effect.forms)


@pytest.mark.parametrize(("effect", "form"), ALL, ids=label)
def test_columns_have_a_term_for_each_gyro_and_no_gap_at_any_start(equipped, effect, form):
    for values in starts(form, equipped):
        columns = form.columns(equipped, values)
        assert columns.shape == (len(equipped), 3, len(form.terms))
        assert np.isfinite(columns).all()


@pytest.mark.parametrize(("effect", "form"), [each for each in ALL if each[1].parameters], ids=label)
def test_starts_lie_between_the_bounds(equipped, effect, form):
    [bounded] = [each for each in effect.bounded(equipped).forms if each.name == form.name]
    for parameter in bounded.parameters:
        values = parameter.starts(equipped)
        assert len(values)
        assert parameter.low <= values.min() <= values.max() <= parameter.high


@pytest.mark.parametrize("effect", all_effects(), ids=label)
def test_an_effect_has_a_form_for_a_table_with_all_sensors(equipped, effect):
    assert any(form.missing_input(equipped) is None for form in effect.forms)


@pytest.mark.parametrize("effect", all_effects(), ids=label)
def test_columns_at_the_true_parameters_make_up_the_simulated_effect(problem, effect):
    one = problem({effect.name: 10.0}, noise=0.0, **(EQUIPPED if effect.name in NEED_EQUIPMENT else {}))
    misses = [
        1.0 - one.chi2_reduction(form.columns(one.campaign, TRUE.get(effect.name, ())))[0] / one.chi2
        for form in effect.forms
        if form.missing_input(one.campaign) is None and form.name not in OTHER_FORMS
    ]
    assert min(misses) < MISSED.get(effect.name, 0.002)


@pytest.mark.parametrize(("effect", "form"), ALL, ids=label)
def test_columns_do_not_see_the_biases(equipped, effect, form):
    values = starts(form, equipped)[0]
    without = replace(equipped, bias_dph=np.full_like(equipped.bias_dph, np.nan))
    np.testing.assert_array_equal(form.columns(without, values), form.columns(equipped, values))


@pytest.mark.parametrize("name", ["attitude_thermal", "thermal_hysteresis"])
def test_a_statement_explains_the_names_of_its_forms(name):
    (effect,) = (each for each in all_effects() if each.name == name)
    for form in effect.forms:
        assert f"({form.name.partition(',')[0]})" in effect.statement
