"""An effect of another package: the one of docs/extend/effect.md, in a whole search."""

import json
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect, Form, InsTerms
from gyrobench.bench.closure.loadable_model import model_with_effects
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.foundations import packages
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from tests.bench.closure.thermal_bench import STEP_S, measure
from tests.bench.command_line import output_of
from tests.docs.pages import DOCS, blocks

METADATA = "Metadata-Version: 2.1\nName: acme-effects\nVersion: 1.2\n"
ENTRY_POINTS = "[gyrobench.effects]\nrate_times_temperature = acme_effects.product:EFFECT\n"


def rate_times_temperature(course):
    return np.gradient(course.optics_c, axis=0) * 3600.0 / STEP_S * course.optics_c


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The package as if it had been installed before this process began."""
    site = tmp_path / "site"
    (site / "acme_effects").mkdir(parents=True)
    (site / "acme_effects-1.2.dist-info").mkdir()
    [block] = [block for block in blocks(DOCS / "extend/effect.md") if block.language == "python"]
    (site / "acme_effects" / "__init__.py").write_text("")
    (site / "acme_effects" / "product.py").write_text(block.text)
    (site / "acme_effects-1.2.dist-info" / "METADATA").write_text(METADATA)
    (site / "acme_effects-1.2.dist-info" / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(site)
    packages._all_entries.cache_clear()
    yield
    packages._all_entries.cache_clear()


@pytest.fixture
def offered(monkeypatch):
    """Offer one effect under a name: ``offered(name, effect)``."""

    def offer(name, effect):
        monkeypatch.setitem(globals(), "OFFERED", effect)
        entries = (EntryPoint(name, f"{__name__}:OFFERED", packages.EFFECTS),)
        monkeypatch.setattr(packages, "_entries", lambda group: entries)

    return offer


def effect_of(name, terms=np.zeros, **options):
    form = Form(("term",), lambda campaign, _: terms((len(campaign), 3, 1)))
    return Effect(name, "the bias follows a term", "vary the term", (form,), **options)


@pytest.mark.usefixtures("installed")
def test_a_search_finds_the_effect_of_another_package(tmp_path):
    write_dwells(tmp_path / "dwells.csv", measure({rate_times_temperature: 8.0}, cycles=2).rows)
    printed = output_of("close", "dwells.csv", cwd=tmp_path)
    found = json.loads((tmp_path / "closure" / "closure.json").read_text())
    assert found["verdict"] == "explained"
    assert [each["effect"] for each in found["effects"]] == ["rate_times_temperature"]
    assert found["effects"][0]["statement"].startswith("The bias follows the temperature rate, in proportion")
    assert "the best of those tried: rate times temperature (P" in " ".join(printed.split())
    assert "rate times temperature" in (tmp_path / "closure" / "closure.html").read_text()
    assert (tmp_path / "closure" / "figures" / "effect_rate_times_temperature.png").is_file()


@pytest.mark.usefixtures("installed")
def test_the_effect_of_another_package_states_why_it_is_not_compensated():
    [effect] = [each for each in all_effects() if each.name == "rate_times_temperature"]
    campaign = campaign_of(measure({rate_times_temperature: 8.0}, cycles=2).rows)
    loadable = model_with_effects(close_loop(campaign, effects=[effect]))
    assert loadable.effects == ()
    assert "rate times temperature is left out: the INS has no term for a product" in loadable.notes[1]


@pytest.mark.parametrize(
    ("name", "effect", "message"),
    [
        ("acme", "no effect", r"the effect 'acme' of .* is not of type Effect .*Report this to"),
        ("acme", effect_of("other"), "the entry point 'acme' .* differs from the name 'other' of its object"),
        ("warm_up", effect_of("warm_up"), "the entry point 'warm_up' .* has the name of another effect"),
        ("Acme!", effect_of("Acme!"), "the entry point 'Acme!' .* has characters other than a-z, 0-9 and _"),
    ],
)
def test_a_wrong_effect_is_refused(offered, name, effect, message):
    offered(name, effect)
    with pytest.raises(DocumentError, match=message):
        all_effects()


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        (lambda shape: np.zeros(shape[:2]), r"the terms of the effect 'acme' have shape \(\d+, 3\)"),
        (
            lambda shape: np.full(shape, np.nan),
            "the terms of the effect 'acme' have values that are not finite",
        ),
    ],
)
def test_wrong_terms_are_refused(offered, terms, message):
    offered("acme", effect_of("acme", terms))
    with pytest.raises(MeasurementError, match=f"{message}.*Report this to the package's author"):
        close_loop(campaign_of(measure(cycles=2).rows))


def test_a_compensation_that_no_ins_has_is_refused():
    effect = effect_of("acme", compensation=lambda fitted: InsTerms({"moon_dph": fitted.sizes_dph}))
    campaign = campaign_of(measure({"time_drift": 6.0}, cycles=2).rows)
    days = campaign.middle_s / 86_400.0
    form = Form(("days",), lambda campaign, _: np.repeat(days[:, None, None], 3, axis=1))
    closure = close_loop(campaign, effects=[Effect(**{**vars(effect), "forms": (form,)})])
    with pytest.raises(MeasurementError, match="'acme' is compensated by moon_dph, which no INS has"):
        model_with_effects(closure)
