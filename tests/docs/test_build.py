"""The pages build without a warning: no dead link, no key that the models do not have."""

import subprocess
import sys

import pytest

from tests.docs.pages import DOCS, ROOT, pages


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("html")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-n",
        "-b",
        "html",
        str(DOCS),
        str(out),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200, check=False)
    return out, done


@pytest.mark.long
def test_links_between_pages_and_to_files_lead_somewhere(built):
    _, done = built
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_the_reference_has_every_step_and_what_its_keys_mean(built):
    out, _ = built
    text = (out / "reference/procedure.html").read_text(encoding="utf-8")
    for word in ("go_to", "until_gyro_rate_below_c_per_h", "bias_sigma_below_dph", "max_repeats_total"):
        assert word in text
    assert "how often a failed exchange with an instrument is repeated" in text


@pytest.mark.long
def test_the_reference_of_stations_goes_down_to_the_last_key(built):
    out, _ = built
    text = (out / "reference/station.html").read_text(encoding="utf-8")
    for word in (
        "interlocks.chamber_air_rate",
        "limit_c_per_min",
        "ins.signals.attitude.euler",
        "yaw_positive",
    ):
        assert word in text


@pytest.mark.long
def test_every_command_has_a_section(built):
    out, _ = built
    text = (out / "reference/commands.html").read_text(encoding="utf-8")
    for word in ("gyrobench run", "gyrobench resume", "--separability", "gyrobench import"):
        assert word in text


@pytest.mark.long
def test_no_page_asks_another_host_for_anything(built):
    """Pages are read where there is no network."""
    out, _ = built
    for page in out.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert 'src="http' not in text, page
        assert 'rel="stylesheet" href="http' not in text, page


@pytest.mark.long
def test_equations_are_drawn_by_the_browser_itself(built):
    out, _ = built
    text = (out / "method.html").read_text(encoding="utf-8")
    assert text.count("<math ") > 20


def test_links_of_the_readme_lead_to_files():
    import re

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#]+)", text):
        if not link.startswith("http"):
            assert (ROOT / link).exists(), link


@pytest.mark.long
def test_every_page_is_reached_from_the_index(built):
    _, done = built
    assert "isn't included in any toctree" not in done.stderr
    assert len(pages()) > 20
