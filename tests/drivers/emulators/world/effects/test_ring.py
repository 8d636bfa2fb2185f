import re
from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.emulators.world.effects.ring import DitherCrossing, ModeHop

HOP = ModeHop(kind="mode_hop", bias_dph=[0.01, -0.02, 0.0], first_reset_c=-10.0, reset_every_c=8.0)
CROSSING = DitherCrossing(
    kind="dither_crossing", gyros=["x", "z"], crossing_c=30.0, half_width_c=2.0, bias_dph=[0.01, -0.02]
)


@pytest.mark.parametrize(
    ("optics_c", "share"), [(-18.5, 1), (-10.1, 0), (-9.9, 1), (-2.1, 1), (-1.9, 0), (5.9, 0), (6.1, 1)]
)
def test_every_second_mode_has_the_bias(conditions, optics_c, share):
    added_dph = HOP.added_dph(conditions(optics_c=optics_c))
    np.testing.assert_allclose(added_dph, share * np.array([0.01, -0.02, 0.0]))


def test_each_gyro_hops_at_its_own_temperature(conditions):
    added_dph = HOP.added_dph(conditions(optics_c=[-9.0, -1.0, 0.0]))
    np.testing.assert_allclose(added_dph, [0.01, 0.0, 0.0])


def test_at_the_crossing_both_gyros_have_all_of_the_bias_and_the_third_has_nothing(conditions):
    np.testing.assert_allclose(CROSSING.added_dph(conditions(optics_c=30.0)), [0.01, 0.0, -0.02])


@pytest.mark.parametrize(("away_c", "share"), [(2.0, 0.5), (-2.0, 0.5), (20.0, 1.0 / 101.0)])
def test_it_falls_off_on_both_sides_as_a_resonance_does(conditions, away_c, share):
    added_dph = CROSSING.added_dph(conditions(optics_c=30.0 + away_c))
    np.testing.assert_allclose(added_dph, share * np.array([0.01, 0.0, -0.02]))


def test_the_mean_temperature_of_the_two_gyros_decides(conditions):
    np.testing.assert_allclose(
        CROSSING.added_dph(conditions(optics_c=[25.0, 80.0, 35.0])), [0.01, 0.0, -0.02]
    )


@pytest.mark.parametrize("gyros", ["[x, x]", "[x]", "[x, y, z]", "[x, w]"])
def test_a_crossing_needs_two_different_gyros(gyros):
    text = f"kind: dither_crossing\ngyros: {gyros}\ncrossing_c: 30\nhalf_width_c: 2\nbias_dph: [0.01, 0.02]\n"
    with pytest.raises(DocumentError) as caught:
        validate(parse_document(text, Path("w.yaml")), DitherCrossing)
    assert re.match(r"w\.yaml:2:\d+: ", str(caught.value))
