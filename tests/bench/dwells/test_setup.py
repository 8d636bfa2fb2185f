import numpy as np
import pytest

from gyrobench.bench.dwells.setup import measurement_setup
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station import Station

SHIPPED = find_document("stations", "emulated")


def test_the_setup_has_place_noise_resolution_and_what_is_known_of_the_station():
    station = Station(SHIPPED)
    setup = measurement_setup(station)
    assert (setup.site, setup.prior, setup.table) == (station.site, station.prior(), station.table)
    assert setup.velocity_lsb_mps == pytest.approx(1e-4)
    assert np.degrees(setup.heading_lsb_rad) == pytest.approx(1e-6)
    assert setup.noise == station.noise(setup.velocity_lsb_mps, setup.heading_lsb_rad)
    assert all(limit.sufficient for limit in setup.resolution)


def test_noise_that_is_left_to_the_dwells_is_none(tmp_path):
    text = SHIPPED.read_text()
    begin, end = text.index("  noise:\n"), text.index("unit:\n")
    path = tmp_path / "station.yaml"
    path.write_text(f"{text[:begin]}  noise: estimated\n\n{text[end:]}")
    assert measurement_setup(Station(path)).noise is None


def test_a_signal_that_the_dbc_lacks_is_an_error(tmp_path):
    path = tmp_path / "station.yaml"
    path.write_text(SHIPPED.read_text().replace("VELOCITY_NE.VELOCITY_EAST", "VELOCITY_NE.VELOCITY_WEST"))
    with pytest.raises(DocumentError, match="VELOCITY_WEST"):
        measurement_setup(Station(path))
