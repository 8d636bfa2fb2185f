"""Bias and Earth rate from two logs of raw rates."""

import re

import numpy as np
import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.test_raw_rate import BIAS_DPH, recorded
from tests.bench.command_line import gyrobench


@pytest.fixture
def logs(tmp_path):
    """Logs in the layout of the shipped map ``ln100``, x axis up and down."""
    random = np.random.default_rng(3)
    paths = []
    for name in ("x_up", "x_down"):
        recording, _ = recorded(random, POSITIONS[name].C_nb())
        columns = [recording.time_s, np.degrees(recording.rate_radps), recording.specific_force_mps2]
        paths.append(tmp_path / f"{name}.ins")
        np.column_stack(columns).astype("<f8").tofile(paths[-1])
    return paths


def test_two_logs_give_the_bias_of_the_vertical_gyro_and_the_earth_rate(logs, tmp_path):
    text = gyrobench("raw-rate", *logs, "--map", "ln100", "--axis", "x", cwd=tmp_path).stdout
    pattern = r"Bias of the x gyro +([-\d.]+) ± ([\d.]+) deg/h\s+Earth rate, vertical +([\d.]+) ±"
    found = re.search(pattern, text)
    assert found is not None, text
    bias_dph, sigma_dph, earth_dph = map(float, found.groups())
    assert abs(bias_dph - BIAS_DPH[0]) < 4.0 * sigma_dph
    assert abs(earth_dph - 11.702) < 4.0 * sigma_dph
    assert "11.7020 deg/h at latitude 51.0784 deg" in " ".join(text.split())


def test_logs_in_the_wrong_order_are_refused(logs, tmp_path):
    result = gyrobench("raw-rate", *reversed(logs), "--map", "ln100", cwd=tmp_path)
    assert result.returncode != 0
    assert "Check the order of the recordings" in " ".join(result.stderr.split())


def test_without_a_latitude_in_the_map_the_earth_rate_gives_one(logs, tmp_path):
    shipped = find_document("imports", "ln100").read_text()
    own = tmp_path / "own.yaml"
    own.write_text("".join(line for line in shipped.splitlines(True) if not line.startswith("earth_rate")))
    text = gyrobench("raw-rate", *logs, "--map", "own.yaml", cwd=tmp_path).stdout
    latitude_deg, sigma_deg = map(float, re.findall(r"that of latitude ([\d.]+) ± ([\d.]+) deg", text)[0])
    assert abs(latitude_deg - 51.0784) < 4.0 * sigma_deg
