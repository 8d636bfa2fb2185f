"""Effects of the user: files that are checked, found beside a table, and searched for."""

import json

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import FittedForm
from gyrobench.bench.closure.effects.effect_file import EffectFile
from gyrobench.bench.closure.loadable_model import model_with_effects
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.foundations.errors import DocumentError
from tests.bench.closure.thermal_bench import measure
from tests.bench.command_line import gyrobench, output_of

ONSET_C = 38.0
HOT_SIDE = """\
effect: hot_side
statement: the bias follows the optics temperature above an onset
experiment: soak at three temperatures above the onset and three below it
driver: gyro_c
shape: onset
bounds: {onset: [0, 70], width: [1, 10]}
"""


def hot_side(course):
    return 3.0 * np.log1p(np.exp((course.optics_c - ONSET_C) / 3.0))


def effect(**keys):
    words = {"statement": "the bias follows it", "experiment": "vary it"}
    return EffectFile(effect="mine", **(words | keys))


def write_effect(folder, text=HOT_SIDE):
    (folder / "effects").mkdir(exist_ok=True)
    path = folder / "effects" / "hot_side.yaml"
    path.write_text(text)
    return path


def test_an_effect_beside_the_table_is_found_and_compensated(tmp_path):
    write_effect(tmp_path)
    write_dwells(tmp_path / "dwells.csv", measure({hot_side: 40.0}, cycles=2).rows)
    printed = output_of(
        "close", str(tmp_path / "dwells.csv"), "--json", "--out", "other", cwd=tmp_path.parent
    )
    found = json.loads(printed)["closure"]
    assert [each["effect"] for each in found["effects"]] == ["hot_side"]
    assert found["error_after_dph"] < 0.5 * found["error_before_dph"]


def test_without_its_file_the_effect_is_not_known(tmp_path):
    path = write_effect(tmp_path)
    assert "hot_side" in {each.name for each in all_effects(tmp_path / "dwells.csv")}
    path.unlink()
    assert "hot_side" not in {each.name for each in all_effects(tmp_path / "dwells.csv")}


def test_a_function_of_temperature_is_compensated_by_a_polynomial():
    mine = effect(driver="gyro_c", shape="onset", bounds={"onset": [0.0, 70.0], "width": [1.0, 10.0]}).build()
    campaign = campaign_of(measure({hot_side: 40.0}, cycles=2).rows)
    closure = close_loop(campaign, effects=[mine])
    loadable = model_with_effects(closure)
    assert loadable.effects == ("mine",)
    assert any(
        "mine is compensated by a polynomial of degree 5, which leaves" in each for each in loadable.notes
    )
    coefficients = loadable.compensation.polynomial_dph
    polynomial = np.stack(
        [np.polyval(row[::-1], gyro_c) for row, gyro_c in zip(coefficients, campaign.gyro_c.T, strict=True)],
        axis=1,
    )
    rest = campaign.bias_dph - polynomial
    assert np.std(rest - rest.mean(axis=0)) < 2.5 * campaign.sigma_dph.mean()
    [found] = closure.effects
    form, values = found.candidate.form, found.candidate.values
    terms = mine.compensation(FittedForm(campaign, closure.searched, form, values, found.sizes_dph))
    np.testing.assert_allclose(closure.model.bias_dph - polynomial, terms.residual_dph, atol=1e-7)


@pytest.mark.parametrize(
    ("driver", "shape", "memory", "factor", "bounds", "terms"),
    [
        ("board_c", "linear", "lag", "none", {"tau_s": [300.0, 9000.0]}, 1),
        ("case_c", "polynomial", "none", "up", {}, 6),
        ("above_optics_k", "saturation", "none", "up_z", {"centre": [2.0, 9.0], "width": [0.5, 3.0]}, 1),
        ("gyro_c", "resonance", "play", "none",
         {"centre": [-5.0, 5.0], "half_width": [0.5, 3.0], "play": [1.0, 9.0]}, 2),
        ("power_on", "linear", "decay", "up", {"tau_s": [300.0, 9000.0]}, 3),
        ("current_{axis}_ma", "linear", "decay", "none", {"tau_s": [300.0, 9000.0]}, 1),
    ],
)  # fmt: skip
def test_every_part_of_the_grammar_gives_terms(driver, shape, memory, factor, bounds, terms):
    sensors = ("set", "air", "case", "board")
    rows = measure(cycles=2, sensors=sensors).rows
    currents = np.random.default_rng(0).normal(5.0, 1.0, (len(rows), 3))
    campaign = campaign_of(rows)
    columns = {f"current_{axis}_ma": column for axis, column in zip("xyz", currents.T, strict=True)}
    campaign = type(campaign)(**{**vars(campaign), "columns": columns})
    mine = effect(driver=driver, shape=shape, memory=memory, factor=factor, bounds=bounds).build()
    for form in mine.forms:
        assert form.missing_input(campaign) is None
        values = tuple(parameter.starts(campaign)[0] for parameter in form.parameters)
        found = form.columns(campaign, values)
        assert found.shape == (len(rows), 3, terms)
        assert len(form.terms) == terms
        assert np.isfinite(found).all()
        assert np.ptp(found, axis=0).min() > 0.0


def test_a_column_that_the_table_lacks_is_named():
    [form] = effect(driver="current_ma").build().forms
    assert form.missing_input(campaign_of(measure(cycles=2).rows)) == "a column current_ma in the dwell table"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("shape: onset", "shape: sigmoid"),
        ("width: [1, 10]", "width: [0, 10]"),
        (", width: [1, 10]", ""),
        ("driver: gyro_c", "driver: power_on"),
        ("effect: hot_side", "effect: warm_up"),
    ],
)
def test_a_wrong_file_is_refused_with_its_place(tmp_path, change, message):
    path = write_effect(tmp_path, HOT_SIDE.replace(change, message))
    with pytest.raises(DocumentError, match=str(path)):
        all_effects(tmp_path / "dwells.csv")


def test_validate_and_new_know_effects(tmp_path):
    assert gyrobench("new", "effect", "mine", cwd=tmp_path).returncode == 0
    valid = gyrobench("validate", "mine.yaml", cwd=tmp_path)
    assert valid.stdout.strip() == "mine.yaml: valid effect file"
    (tmp_path / "mine.yaml").write_text(HOT_SIDE.replace("gyro_c", "power_on"))
    wrong = gyrobench("validate", "mine.yaml", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "is an event" in wrong.stdout + wrong.stderr


def test_an_effect_of_the_user_takes_part_in_separability(tmp_path):
    write_effect(tmp_path)
    campaign = campaign_of(measure(cycles=2).rows)
    result = separability(searched_dwells(campaign), all_effects(tmp_path / "dwells.csv"))
    assert "hot_side" in {each.effect.name for each in result.detections}
