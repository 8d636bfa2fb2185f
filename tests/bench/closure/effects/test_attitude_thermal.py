import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.attitude_thermal import EFFECT
from tests.bench.closure.thermal_bench import measure

WITH_FLOW, WITHOUT_FLOW = EFFECT.forms[:2], EFFECT.forms[2:]


def along_gravity(form, campaign, values):
    """The terms that follow gravity: the last three."""
    return form.columns(campaign, values)[:, :, -3:]


@pytest.mark.parametrize("form", EFFECT.forms, ids=lambda form: form.name)
def test_the_dependence_on_gravity_vanishes_above_the_onset(clean, form):
    hot = clean.gyro_c.min(axis=1) > 55.0
    cold = clean.gyro_c.max(axis=1) < 0.0
    along = np.abs(along_gravity(form, clean, (30.0, 2.0)))
    assert along[hot].max() < 1e-4 * along[cold].max()


@pytest.mark.parametrize("form", EFFECT.forms, ids=lambda form: form.name)
def test_its_sign_follows_gravity_along_each_axis(clean, form):
    along = along_gravity(form, clean, (30.0, 2.0))
    cold = clean.gyro_c.max(axis=1) < 20.0
    for name, up in (
        ("x_up", [1, 0, 0]),
        ("x_down", [-1, 0, 0]),
        ("y_up", [0, 1, 0]),
        ("z_down", [0, 0, -1]),
    ):
        dwells = cold & (np.array(clean.position) == name)
        np.testing.assert_array_equal(
            np.sign(np.round(along[dwells], 9)), np.broadcast_to(up, (dwells.sum(), 3, 3))
        )


@pytest.mark.parametrize("has_flow", [True, False], ids=["flow known", "flow unknown"])
def test_one_form_is_constant_in_the_cold_and_the_other_grows(clean, has_flow):
    forms = WITH_FLOW if has_flow else WITHOUT_FLOW
    saturating, growing = (along_gravity(form, clean, (50.0, 2.0)) for form in forms)
    flow = (clean.board_c - clean.gyro_c)[:, :, None] if has_flow else 1.0
    cold = clean.gyro_c.max(axis=1) < 20.0
    followed = (
        np.broadcast_to(np.abs(clean.up_body[:, None, :]) > 0.5, saturating.shape) & cold[:, None, None]
    )
    np.testing.assert_allclose(np.abs(saturating / flow)[followed], 1.0, atol=1e-6)
    below = np.broadcast_to(((50.0 - clean.gyro_c) / 2.0)[:, :, None], growing.shape)
    np.testing.assert_allclose(np.abs(growing / flow)[followed], below[followed], rtol=1e-6)


def test_the_first_term_is_the_flow_in_all_positions(clean):
    for form in WITH_FLOW:
        np.testing.assert_allclose(form.columns(clean, (30.0, 2.0))[:, :, 0], clean.board_c - clean.gyro_c)


def test_with_an_unknown_flow_the_forms_without_it_are_fitted(clean):
    blind = campaign_of(measure(cycles=2, sensors=()).rows)
    assert all("temperature sensors" in form.missing_input(blind) for form in WITH_FLOW)
    for form in WITHOUT_FLOW:
        assert form.missing_input(blind) is None
        assert form.columns(blind, (30.0, 2.0)).shape == (len(blind), 3, len(form.terms))


def test_where_the_flow_is_known_it_is_not_taken_for_constant(clean):
    assert all(form.missing_input(clean) is None for form in WITH_FLOW)
    assert all("the heat flow is known" in form.missing_input(clean) for form in WITHOUT_FLOW)


@pytest.mark.parametrize("form", EFFECT.forms, ids=lambda form: form.name)
@pytest.mark.parametrize("onset", [(30.0, 2.0), (30.0, 0.5)], ids=str)
def test_divided_by_its_weights_no_term_exceeds_the_flow_at_the_coldest_gyro(clean, form, onset):
    flow = (clean.board_c - clean.gyro_c)[:, :, None] if form in WITH_FLOW else 1.0
    along = along_gravity(form, clean, onset) / form.weights(clean, onset)[-3:] / flow
    length = np.linalg.norm(along, axis=2)
    assert length.max() <= 1.0 + 1e-9
    np.testing.assert_allclose(length.flat[clean.gyro_c.argmin()], 1.0, rtol=1e-6)
