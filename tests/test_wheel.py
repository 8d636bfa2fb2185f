"""The wheel holds one package, and works beside other people's packages called bench and drivers."""

import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder of installed packages: the wheel's content, and a package bench and one drivers."""
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, text=True)
    [wheel] = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    for name in ("bench", "drivers"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(f"raise ImportError('this is another package {name}')\n")
    return folder


def test_the_build_sees_the_packages_that_pip_installs_for_it(monkeypatch, tmp_path):
    """As in `pip install .`, which names their folder in PYTHONPATH."""
    spec = importlib.util.spec_from_file_location("build_backend", ROOT / "build_backend.py")
    backend = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(backend)
    environments = []
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(backend.subprocess, "run", lambda _, env, check: environments.append(env))
    monkeypatch.setattr(backend._hatchling, "build_wheel", lambda *_: "a.whl")
    assert backend.build_wheel(str(tmp_path)) == "a.whl"
    assert environments[0]["PYTHONPATH"].split(os.pathsep) == [str(ROOT / "src"), str(tmp_path)]


def test_the_wheel_holds_one_package(site):
    [wheel] = site.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name.partition("/")[0] for name in archive.namelist()}
        files = set(archive.namelist())
    assert {name for name in names if not name.endswith(".dist-info")} == {"gyrobench"}
    for file in (
        "py.typed",
        "drivers/ins/gyrobench_ins.dbc",
        "bench/report/templates/page.html.j2",
        "procedures/six_position_fig7.yaml",
        "stations/emulated.yaml",
        "worlds/gyro_a.yaml",
        "faults/every_kind.yaml",
        "imports/ln100.yaml",
        "rotations/eighteen_rotations.yaml",
    ):
        assert f"gyrobench/{file}" in files


def test_it_ships_the_schemas_that_its_files_name(site):
    shipped = [
        path
        for kind in ("procedures", "stations", "worlds", "faults", "imports", "rotations")
        for path in (site / "gyrobench" / kind).glob("*.yaml")
    ]
    assert len(shipped) > 20
    for path in shipped:
        mark, _, schema = path.read_text().splitlines()[0].partition("=")
        assert mark == "# yaml-language-server: $schema"
        assert '"$defs"' in (path.parent / schema).read_text()
    made = subprocess.run(
        [sys.executable, "-m", "gyrobench", "new", "procedure", "mine", "--out", "-"],
        cwd=site.parent,
        env=os.environ | {"PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=True,
    )
    path = Path(made.stdout.splitlines()[0].partition("=")[2])
    assert path == site.resolve() / "gyrobench" / "schemas" / "procedure.schema.json"
    assert path.is_file()


def test_it_runs_beside_packages_called_bench_and_drivers(site, tmp_path):
    for name in ("bench", "drivers"):  # in the folder of a notebook, too
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('this is not gyrobench')\n")
    environment = os.environ | {"PYTHONPATH": str(site)}
    for arguments in (
        ["plan", "six_position_fig7"],
        ["run", "ten_minute_check", "--world", "ideal", "--out", "run"],
        ["report", "run"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "gyrobench", *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    where = "import gyrobench.bench; print(gyrobench.bench.__file__)"
    found = subprocess.run(
        [sys.executable, "-c", where],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(found.stdout.strip()).is_relative_to(site)
