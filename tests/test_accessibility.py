"""No finding of axe on any page, in a narrow and a wide window."""

import html
import json
import re
import shutil
import subprocess
import tarfile
from importlib import resources
from pathlib import Path

import pytest

from gyrobench.bench.monitor.website import Website
from tests.bench.command_line import gyrobench
from tests.bench.monitor.sample_snapshots import made_up_snapshot, waiting_snapshot
from tests.bench.monitor.served_run import now, run_under_way
from tests.bench.monitor.test_browser import CHROMIUM, OPTIONS

CAMPAIGN = Path(__file__).parent / "data/run_folders/campaign.tar.xz"
WIDTHS_PX = (360, 1280)
AXE = (resources.files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
RUN_AXE = """
axe.run(document, {resultTypes: ["violations"]}).then(results => {
  const found = results.violations.map(rule => [rule.id, rule.nodes.map(node => node.target.join(" "))]);
  const shown = document.createElement("pre");
  shown.id = "findings";
  shown.textContent = JSON.stringify(found);
  document.body.appendChild(shown);
});
"""


@pytest.fixture(scope="module")
def monitored(tmp_path_factory):
    """Each kind of page that the monitor serves of a run under way, by name."""
    place, found = tmp_path_factory.mktemp("monitor"), {}
    for name, snapshot in (("monitor", made_up_snapshot()), ("question", waiting_snapshot())):
        (place / name).mkdir()
        with run_under_way(place / name / "run", snapshot):
            found[name] = Website(place / name / "run", now).answer("/").body.decode()
            found["list of runs"] = Website(place / name, now).answer("/").body.decode()
    return found


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Each kind of page of a finished run, by name."""
    place = tmp_path_factory.mktemp("pages")
    with tarfile.open(CAMPAIGN) as archive:
        archive.extractall(place, filter="data")
    [run] = [path.parent for path in place.rglob("journal.jsonl")]
    for command in ("close", "report"):
        done = gyrobench(command, run, cwd=place)
        assert done.returncode == 0, done.stderr
    return {
        "report": (run / "report.html").read_text(encoding="utf-8"),
        "search for effects": (run / "closure/closure.html").read_text(encoding="utf-8"),
        "record in the monitor": Website(run, now).answer("/").body.decode(),
    }


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width_px", WIDTHS_PX)
@pytest.mark.parametrize("name", ["report", "search for effects", "record in the monitor"])
def test_a_page_of_a_finished_run_has_no_finding(written, name, width_px, tmp_path):
    assert findings(written[name], width_px, tmp_path) == {}


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width_px", [WIDTHS_PX[0], pytest.param(WIDTHS_PX[1], marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "name",
    ["monitor", *(pytest.param(name, marks=pytest.mark.long) for name in ("question", "list of runs"))],
)
def test_a_page_of_the_monitor_has_no_finding(monitored, name, width_px, tmp_path):
    assert findings(monitored[name], width_px, tmp_path) == {}


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_a_page_with_low_contrast_has_a_finding(monitored, tmp_path):
    pale = monitored["monitor"].replace("</style>", "p { color: #cccccc !important; }</style>")
    assert "color-contrast" in findings(pale, WIDTHS_PX[0], tmp_path)


def findings(page, width_px, folder):
    """Elements in breach of each rule."""
    policy = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
    script = f"<script>{AXE}</script><script>{RUN_AXE}</script></body>"
    file = folder / "page.html"
    without_own_script = re.sub(r"<script nonce.*?</script>", "", policy.sub("", page), flags=re.DOTALL)
    file.write_text(without_own_script.replace("</body>", script), encoding="utf-8")
    options = [f"--window-size={width_px},900", f"--user-data-dir={folder / 'profile'}", "--dump-dom"]
    command = [shutil.which(CHROMIUM), *OPTIONS, *options, "--virtual-time-budget=60000", file.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    [text] = re.findall(r'<pre id="findings">(.*?)</pre>', done.stdout, re.DOTALL)
    return dict(json.loads(html.unescape(text)))
