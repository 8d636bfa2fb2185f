"""Laws composed where no known effect explains the residual."""

import json
import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.closure import evidence
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.compose import _all_laws
from gyrobench.bench.closure.effects.laws import TEMPERATURE_RATE, TIME_DRIFT
from gyrobench.bench.closure.loop import close_loop, composed
from tests.bench.closure.thermal_bench import measure
from tests.bench.command_line import gyrobench, output_of

SENSORS = ("set", "air", "case", "board", "supply", "room")


def striction(course):
    """Electronics that act through a narrow range of their temperature."""
    return 1.0 / (1.0 + ((course.board_c - 42.0) / 5.0) ** 2)


def onset_of_case(course):
    return np.maximum(course.case_c - 24.0, 0.0)[:, None]


def supply_limit(course):
    return np.tanh((course.supply_w - 41.0) / 1.0)[:, None]


def table(law, size=15.0, seed=0, **options):
    return measure({law: size}, seed=seed, **({"cycles": 3, "sensors": SENSORS} | options)).rows


@cache
def searched(law):
    return close_loop(campaign_of(table(law)))


@pytest.mark.long
@pytest.mark.parametrize(("law", "driver"), [(striction, "board_c"), (supply_limit, "supply_w")])
def test_the_driver_of_an_unknown_effect_is_the_most_probable(law, driver):
    closure = composed(searched(law))
    assert closure.verdict == "unexplained"
    assert next(iter(closure.composed.driver_probabilities)) == driver
    best = closure.composed.laws[0]
    assert best.file.driver == driver
    assert best.probability > 0.5
    assert best.error_after_dph < 0.5 * closure.error_before_dph


def test_a_residual_that_is_explained_is_not_composed():
    campaign = campaign_of(measure({"temperature_rate": 6.0}, cycles=2).rows)
    closure = close_loop(campaign, effects=[TEMPERATURE_RATE, TIME_DRIFT])
    assert closure.verdict == "explained"
    assert composed(closure).composed is None


@pytest.mark.long
def test_noise_on_no_law_of_the_grammar_stays_other():
    steps = np.random.default_rng(3).standard_normal(400)

    def random_walk(course):
        return np.interp(course.time_h, np.arange(400) * 0.5, np.cumsum(steps))[:, None]

    closure = composed(close_loop(campaign_of(table(random_walk))))
    assert closure.composed.other > 0.5
    assert max(closure.composed.driver_probabilities.values()) < 0.5


@pytest.mark.long
def test_a_law_beside_something_else_is_no_law_alone(monkeypatch):
    """With a remainder nearly certain before, what is left to the laws alone is small."""
    closure = searched(onset_of_case)
    monkeypatch.setattr(evidence, "REMAINDER_PRIOR", 1.0 - 1e-9)
    found = composed(closure).composed
    assert found.law_and_remainder > 0.99
    assert found.law_and_remainder <= found.other <= 1.0 + 1e-9
    assert sum(found.driver_probabilities.values()) == pytest.approx(1.0 - found.other)
    assert found.laws == ()


def test_laws_of_columns_with_any_name_have_valid_unique_names():
    start = "Anode current at the supply of the optical source and its cooler (mA) "
    rows = [
        replace(row, other=tuple((f"{start}{name}", value) for name, value in row.other))
        for row in table(supply_limit)
    ]
    campaign = campaign_of(rows)
    laws = list(_all_laws(campaign, {"composed_gyro_c"}))
    assert {each.driver for each in laws} >= set(campaign.columns)
    used = [each.effect for each in laws]
    assert len(set(used)) == len(used)
    assert "composed_gyro_c" not in used


def composed_on_the_command_line(folder, rows):
    """Path of the law that is composed for a table, and its document."""
    write_dwells(folder / "dwells.csv", rows)
    assert "empirical" in output_of("close", "dwells.csv", "--compose", cwd=folder)
    return folder / "closure" / "composed_law.yaml", json.loads(
        (folder / "closure" / "closure.json").read_text()
    )


def test_the_command_writes_a_composed_law_that_can_be_searched_for(tmp_path):
    rows = table(onset_of_case, cycles=2, sensors=("case", "board"))
    law, document = composed_on_the_command_line(tmp_path, rows)
    assert "empirical" in (tmp_path / "closure" / "closure.html").read_text()
    assert document["verdict"] == "unexplained"
    composed = document["composed"]
    assert composed["status"].startswith("empirical")
    assert next(iter(composed["drivers"])) == "case_c"
    best = composed["laws"][0]
    assert best["driver"] == "case_c"
    assert best["probability"] > 0.5
    assert best["error_after_dph"] < 0.5 * document["error_before_dph"]
    assert gyrobench("validate", str(law), cwd=tmp_path).returncode == 0


@pytest.mark.long
def test_a_composed_law_is_confirmed_only_by_another_run(tmp_path):
    law, _ = composed_on_the_command_line(tmp_path, table(striction, power_on_each_cycle=True))
    (tmp_path / "effects").mkdir()
    shutil.copy(law, tmp_path / "effects")
    again = json.loads(gyrobench("close", "dwells.csv", "--json", cwd=tmp_path).stdout)["closure"]
    assert [each["effect"] for each in again["effects"]] == ["composed_board_c_resonance"]
    assert again["verdict"] != "explained"

    old = read_dwells(tmp_path / "dwells.csv")
    write_dwells(tmp_path / "dwells.csv", [replace(row, run=f"{row.run} renamed") for row in old])
    renamed = gyrobench("close", "dwells.csv", cwd=tmp_path).stdout
    assert "was composed from the held-out dwells" in " ".join(renamed.split())

    # New dwells under the names of the runs that the law was composed from.
    write_dwells(tmp_path / "dwells.csv", table(striction, power_on_each_cycle=True, seed=1))
    confirmed = json.loads(gyrobench("close", "dwells.csv", "--json", cwd=tmp_path).stdout)["closure"]
    assert [each["effect"] for each in confirmed["effects"]] == ["composed_board_c_resonance"]
    assert confirmed["verdict"] == "explained"
