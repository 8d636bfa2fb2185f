import json
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT
from gyrobench.bench.closure.files import closure_document, format_predictions, model_document
from gyrobench.bench.closure.inputs import coefficient_columns, read_campaign
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects, with_coefficients
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.quantity import QUANTITIES, quantity
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.report.closure_page import closure_sections, write_closure_page
from gyrobench.bench.report.closure_text import verdict_sentence
from gyrobench.drivers.ins.compensation import Correction
from tests.bench.closure.conftest import among
from tests.bench.closure.thermal_bench import UP, measure


def table_of(folder, name, effects=None, **options):
    """A dwell table with the coefficients in the place of biases that the simulated bench measured."""
    columns = coefficient_columns(quantity(name))
    measured = measure(effects, cycles=2, **options)
    rows = []
    for row in measured.rows:
        pairs = zip(columns, row.bias_dph, row.sigma_dph, strict=True)
        other = [pair for (value, sigma), a, b in pairs for pair in ((value, a), (sigma, b))]
        rows.append(replace(row, bias_dph=(0.0, 0.0, 0.0), other=(*row.other, *other)))
    path = folder / "dwells.csv"
    write_dwells(path, rows)
    return path, measured


def test_the_quantities_are_the_coefficients_three_by_three():
    names = [name for each in QUANTITIES for name in each.coefficients]
    assert sorted(names) == sorted(f"{each.name}_{each.axis}" for each in COEFFICIENTS)
    assert [each.axes for each in QUANTITIES if each.label == "misalignment"] == [
        ("xy", "yz", "zx"), ("xz", "yx", "zy"), ("yx", "zx", "zy"),
    ]  # fmt: skip


def test_a_quantity_is_found_by_its_name_or_that_of_a_coefficient():
    assert quantity("gyro_misalignment_yx") == quantity("gyro_misalignment_xz")
    assert quantity("accelerometer_bias").unit == "ug"
    with pytest.raises(DocumentError, match="did you mean 'gyro_scale_factor'"):
        quantity("gyro_scale_facto")


@pytest.fixture(scope="module")
def scale_factor(tmp_path_factory):
    path, measured = table_of(
        tmp_path_factory.mktemp("table"), "gyro_scale_factor", {"temperature_rate": 8.0}, sigma_dph=1.5
    )
    return close_loop(read_campaign(path, quantity=quantity("gyro_scale_factor"))), measured


def test_a_scale_factor_that_follows_temperature_rate_is_found(scale_factor):
    closure, measured = scale_factor
    assert closure.verdict == "explained"
    [effect] = closure.effects
    assert effect.effect.name == "temperature_rate"
    true = measured.undeclared_dph[closure.searched]
    assert effect.rms_dph == pytest.approx(np.sqrt(np.mean((true - true.mean(axis=0)) ** 2)), rel=0.1)
    assert closure.error_after_dph < 1.3 * closure.noise_dph < closure.error_before_dph


def test_its_files_and_sentences_name_the_coefficient_and_its_unit(scale_factor):
    closure, _ = scale_factor
    document = closure_document(closure)
    assert (document["quantity"], document["unit"]) == ("gyro_scale_factor", "ppm")
    assert document["error_after_ppm"] == closure.error_after_dph
    assert "_dph" not in json.dumps(document) + json.dumps(model_document(closure))
    assert document["effects"][0]["statement"].startswith("The scale factor follows the rate of change")
    assert " ppm rms on the x, y and z gyros" in document["effects"][0]["statement"]
    header = format_predictions(closure).splitlines()[0].split(",")
    assert header[:2] == ["dwell", "gyro_scale_factor_x_before_ppm"]
    assert header[-1] == "sigma_z_after_ppm"


@among(G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT)
def test_accelerometer_biases_of_dwells_leave_the_vertical_ones_out(tmp_path, candidates):
    rows = measure({"temperature_rate": 8.0}, cycles=2, sigma_dph=10.0).rows
    vertical = [POSITIONS[row.position].up_axis for row in rows]
    rows = [
        replace(
            row,
            bias_dph=(0.0, 0.0, 0.0),
            accelerometer_ug=tuple(1e4 if axis == up else value for axis, value in enumerate(row.bias_dph)),
            accelerometer_sigma_ug=row.sigma_dph,
        )
        for row, up in zip(rows, vertical, strict=True)
    ]
    write_dwells(tmp_path / "dwells.csv", rows)
    campaign = read_campaign(tmp_path / "dwells.csv", quantity=quantity("accelerometer_bias"))
    closure = close_loop(campaign, effects=candidates)
    measured = closure.campaign.is_measured
    assert not measured[np.arange(len(rows)), vertical].any()
    assert measured.sum() == 2 * len(rows)
    assert closure.verdict == "explained"
    assert [each.effect.name for each in closure.effects] == ["temperature_rate"]
    assert closure.error_after_dph < 1.3 * closure.noise_dph


def accelerometers_with_common_errors(effects=None, **options):
    """Campaign of accelerometers whose gyros are misaligned: 10 ug along Up, the same in all dwells."""
    misalignments_ug = 10.0 * np.random.default_rng(7002).standard_normal((3, 3))
    rows = []
    for row in measure(effects, seed=1, sigma_dph=3.0, **options).rows:
        position = POSITIONS[row.position]
        error_ug = misalignments_ug[:, position.up_axis] * position.up_sign
        rows.append(
            replace(
                row,
                bias_dph=(0.0, 0.0, 0.0),
                accelerometer_ug=tuple(row.bias_dph + error_ug),
                accelerometer_sigma_ug=(np.hypot(3.0, 10.0),) * 3,
                accelerometer_common_sigma_ug=(10.0,) * 3,
            )
        )
    return rows


@pytest.mark.parametrize("headings_deg", [(0.0,), (0.0, 90.0, 180.0, 270.0)])
def test_accelerometer_errors_that_dwells_share_are_no_effect_and_hide_none(tmp_path, headings_deg):
    verdicts = []
    for name, effects in (("clean", None), ("rate", {"temperature_rate": 3.0})):
        write_dwells(
            tmp_path / f"{name}.csv",
            accelerometers_with_common_errors(effects, cycles=3, headings_deg=headings_deg),
        )
        campaign = read_campaign(tmp_path / f"{name}.csv", quantity=quantity("accelerometer_bias"))
        closure = close_loop(campaign, effects=[G_SENSITIVITY, TEMPERATURE_RATE])
        verdicts.append((closure.verdict, closure.names))
    assert verdicts == [("clean", ()), ("explained", ("temperature_rate",))]


def test_a_bias_that_follows_the_square_of_gravity_is_not_taken_for_a_misalignment(tmp_path):
    path, _ = table_of(tmp_path, "accelerometer_bias", sigma_dph=4.0)
    rows = []
    for row in read_dwells(path):
        others = dict(row.other)
        others["accelerometer_bias_x_ug"] += {0: 10.0, 1: 20.0, 2: 0.0}[POSITIONS[row.position].up_axis]
        rows.append(replace(row, other=tuple(others.items())))
    write_dwells(path, rows)
    closure = close_loop(read_campaign(path, quantity=quantity("accelerometer_bias")))
    assert closure.verdict == "explained"
    [effect] = closure.effects
    assert effect.effect.name == "cross_axis_nonlinearity"
    assert effect.sizes_dph[0, 0] == pytest.approx(10.0, abs=4.0 * effect.sizes_sigma_dph[0, 0])
    assert "magnetic_sensitivity" not in [each.effect.name for each in closure.evidence]


@pytest.fixture(scope="module")
def biases():
    """A search in the gyros' biases, which the other coefficients are added to."""
    return close_loop(campaign_of(measure(cycles=2).rows))


def test_what_an_ins_takes_of_a_coefficient_is_its_model(scale_factor, biases):
    closure, measured = scale_factor
    declared, whole = (
        with_coefficients(model, [closure], effects=effects)
        for model, effects in ((declared_model(biases), False), (model_with_effects(biases), True))
    )
    assert declared.effects == ()
    assert whole.effects == ("temperature_rate in gyro_scale_factor",)
    loaded = whole.compensation.coefficients
    for axis, name in enumerate(closure.quantity.coefficients):
        campaign = closure.campaign
        powers = np.vander(campaign.gyro_c[:, axis], 4, increasing=True)
        taken = powers @ loaded[name].polynomial
        taken += campaign.rate_c_per_h[:, axis] * loaded[name].rate_per_c_per_h
        errors = (taken - measured.bias_dph[:, axis])[closure.searched]
        assert np.abs(errors).max() < 2.0
        assert declared.compensation.coefficients[name].rate_per_c_per_h == 0.0
    assert np.all(whole.compensation.rate_limit_c_per_h > 0.0)


def test_a_bias_that_follows_attitude_is_loaded_unless_the_matrix_has_it_already(biases, tmp_path):
    path, measured = table_of(tmp_path, "accelerometer_bias", {"g_sensitivity": 8.0}, sigma_dph=5.0)
    closure = close_loop(read_campaign(path, quantity=quantity("accelerometer_bias")))
    assert [each.effect.name for each in closure.effects] == ["g_sensitivity"]
    alone = with_coefficients(model_with_effects(biases), [closure], effects=True)
    gravity = alone.compensation.coefficients["accelerometer_bias_x"].gravity_per_g
    taken = np.array([UP[row.position] for row in measured.rows]) @ gravity
    true = measured.undeclared_dph[:, 0]
    assert np.abs((taken - taken.mean()) - (true - true.mean())).max() < 5.0
    model = model_with_effects(biases)
    matrix = {
        "accelerometer_misalignment_yx": Correction(np.array([12.0])),
        "accelerometer_bias_x": Correction(np.array([50.0])),
    }
    model = replace(model, compensation=replace(model.compensation, coefficients=matrix))
    both = with_coefficients(model, [closure], effects=True)
    assert both.effects == ()
    assert not both.compensation.coefficients["accelerometer_bias_x"].gravity_per_g.any()
    assert both.compensation.coefficients["accelerometer_bias_x"].polynomial.tolist() == [50.0]
    assert "accelerometer bias is left out: scale factors and misalignments" in both.notes[-1]


@pytest.mark.parametrize(
    ("other", "size", "effects"),
    [("daily_course", 5.0, ("temperature_rate in gyro_scale_factor",)), ("chamber_state", 8.0, ())],
)
def test_an_effect_without_a_term_leaves_its_mean_in_the_constant_of_a_coefficient(
    biases, tmp_path, other, size, effects
):
    found = {"temperature_rate": 10.0, other: size}
    sensors = ("set", "air", "board", "room")
    path, measured = table_of(tmp_path, "gyro_scale_factor", found, sigma_dph=1.0, sensors=sensors)
    known = [each for each in all_effects() if each.name in found]
    closure = close_loop(read_campaign(path, quantity=quantity("gyro_scale_factor")), effects=known)
    assert set(closure.names) == set(found)
    whole = with_coefficients(model_with_effects(biases), [closure], effects=True)
    assert whole.effects == effects
    # The declared model leaves less than a rate that the state of the chamber cancels in part.
    assert any("gyro scale factor: no effect is loaded" in note for note in whole.notes) == (not effects)
    campaign = closure.campaign
    for axis, name in enumerate(closure.quantity.coefficients):
        loaded = whole.compensation.coefficients[name]
        taken = np.vander(campaign.gyro_c[:, axis], 4, increasing=True) @ loaded.polynomial
        taken += campaign.rate_c_per_h[:, axis] * loaded.rate_per_c_per_h
        error = (taken - measured.bias_dph[:, axis])[closure.searched].mean()
        assert abs(error) < 0.5


def test_the_third_misalignments_of_accelerometers_follow_the_sensors_temperatures(tmp_path):
    path, measured = table_of(tmp_path, "accelerometer_misalignment")
    campaign = read_campaign(path, quantity=quantity("accelerometer_misalignment"))
    assert np.allclose(campaign.gyro_c[0], [measured.rows[0].gyro_c[sensor] for sensor in (1, 2, 2)])


def test_a_table_without_the_coefficient_says_which_columns_it_lacks(tmp_path):
    write_dwells(tmp_path / "dwells.csv", measure(cycles=2).rows)
    with pytest.raises(MeasurementError, match="has no columns gyro_scale_factor_x_ppm"):
        read_campaign(tmp_path / "dwells.csv", quantity=quantity("gyro_scale_factor"))


def of_plateaus(closure, chosen):
    """Some values of a campaign as those of plateaus."""
    rows = replace(closure.quantity, row="plateau")
    return replace(closure.campaign.whole, quantity=rows).part(chosen)


@pytest.mark.long
def test_one_cycle_of_plateaus_is_searched_whole_and_confirms_nothing(scale_factor, tmp_path):
    whole, _ = scale_factor
    closure = close_loop(of_plateaus(whole, whole.campaign.cycle == 1))
    assert closure.searched.all()
    assert closure.verdict == "ambiguous"
    [effect] = closure.effects
    assert effect.effect.name == "temperature_rate"
    assert effect.rms_dph == pytest.approx(whole.effects[0].rms_dph, rel=0.1)
    sentences = [each for section in closure_sections(closure) for each in section.paragraphs]
    said = " ".join([verdict_sentence(closure), *sentences])
    assert "no cycle is held out to confirm temperature rate" in said
    assert "Measure the profile a second time." in said
    assert f"in the {len(closure.campaign)} plateaus searched" in said
    assert "dwell" not in said
    assert closure_document(closure)["error_after_ppm"] is None
    page = write_closure_page(tmp_path, closure, "run").read_text()
    assert "No cycle is held out to test the model." in page
    assert not (tmp_path / "figures" / "errors.png").exists()


@pytest.mark.parametrize(("cycles", "without"), [([1], ""), ([1, 2], " without cycle 2")])
def test_too_few_plateaus_say_how_many_to_measure(scale_factor, cycles, without):
    cycle = scale_factor[0].campaign.cycle
    chosen = [place for each in cycles for place in np.flatnonzero(cycle == each)[:4]]
    campaign = of_plateaus(scale_factor[0], np.isin(np.arange(len(cycle)), chosen))
    with pytest.raises(
        MeasurementError, match=f"leaves 0 degrees of freedom in 4 plateaus{without},.* 10 plateaus"
    ):
        close_loop(campaign)
