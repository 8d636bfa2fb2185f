"""A user's effect in YAML, on the emulated bench: found, and loaded into the INS as far as it has terms."""

import json

import numpy as np
import pytest

from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.runs.compensation_file import read_compensation
from tests.bench.closure.campaigns import EFFECTS, run_campaign
from tests.bench.command_line import output_of
from tests.docs.pages import DOCS, blocks

pytestmark = pytest.mark.long


def test_it_is_found_by_its_file_alone_and_verified(tmp_path):
    run = run_campaign(tmp_path, [EFFECTS["loose_clamp"]], cycles=3)
    assert close_loop(read_campaign(run.path)).verdict == "unexplained"
    [block] = [each for each in blocks(DOCS / "howto/own_effect.md") if each.language == "yaml"]
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "loose_clamp.yaml").write_text(block.text)

    output_of("close", str(run.path), cwd=tmp_path)
    [written] = json.loads((run.path / "closure" / "closure.json").read_text())["effects"]
    assert written["effect"] == "loose_clamp"
    closure = close_loop(read_campaign(run.path))
    [found] = closure.effects
    assert found.effect.name == "loose_clamp"
    onset_c = found.candidate.values[0]
    assert onset_c == pytest.approx(EFFECTS["loose_clamp"]["free_above_c"], abs=1.5)
    assert closure.error_after_dph < 0.85 * closure.error_before_dph
    compensations = [model(closure) for model in (declared_model, model_with_effects)]
    assert compensations[1].effects == ("loose_clamp",)
    assert compensations[1].compensation.polynomial_dph.shape[1] == 6

    output_of("verify", str(run.path), "--procedure", "quick_verification", "--view", "lines", cwd=tmp_path)
    table = np.genfromtxt(
        run.path / "verify" / "comparison.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    over_all = {row["compensation"]: row["bias_rms_dph"] for row in table if row["stop"] == 0}
    loaded = read_compensation(run.path / "verify" / "effect" / "compensation.yaml")
    assert loaded.sigma["polynomial_dph"].shape == (3, 6)
    assert over_all["effect"] < over_all["declared"] < over_all["none"]
