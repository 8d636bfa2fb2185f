"""Promises of docs/security.md that hold for the code as a whole."""

import ast
import re
import subprocess
import tomllib
from importlib.metadata import distributions
from pathlib import Path

import pytest

from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.served_ports import TcpPort

ROOT = Path(__file__).parents[1]
SOURCES = sorted(path for package in ("bench", "drivers") for path in (ROOT / package).rglob("*.py"))
#: exec, pickle and the like, eval, and all ways to start a shell.
RULES = ("S102", "S301", "S302", "S307", "S506", "S602", "S604", "S605")


def test_rules_against_eval_unsafe_yaml_and_shells_are_on_and_have_no_exception():
    ruff = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["lint"]
    assert "S" in ruff["select"]
    assert not [rule for rule in ruff["ignore"] if rule.startswith("S")]
    excepted = {
        path: rules for path, rules in ruff["per-file-ignores"].items() if not path.startswith("tests")
    }
    assert not [rule for rules in excepted.values() for rule in rules if rule in RULES or rule == "S"]
    for path in SOURCES:
        assert not re.search(rf"noqa(?!:)|noqa:.*\b({'|'.join(RULES)})\b", path.read_text()), path


def dotted(function: ast.expr) -> str:
    """A function's name with that of its module; it begins with a dot where the module has no name."""
    if isinstance(function, ast.Attribute):
        return f"{dotted(function.value)}.{function.attr}"
    return function.id if isinstance(function, ast.Name) else ""


def test_no_source_calls_eval_exec_or_a_shell():
    words = re.compile(r"\b(eval|exec|compile|system|popen|load|pickle|marshal|shelve|shell)\b")
    for path in SOURCES:
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if words.search(text) else ():
            if isinstance(node, ast.Call):
                name = dotted(node.func)
                assert name not in ("eval", "exec", "compile", "os.system", "os.popen", "yaml.load"), path
                assert not name.startswith(("pickle.", "marshal.", "shelve.")), path
                assert not any(each.arg == "shell" for each in node.keywords), path


@pytest.mark.parametrize(
    "value",
    [
        '!!python/object/apply:os.system ["touch {}"]',
        "!!python/object/new:os.system ['touch {}']",
        "!!python/name:os.system ''",
        "!!python/module:os ''",
        "!!python/tuple [1, 2]",
    ],
)
def test_yaml_runs_no_code(tmp_path, value):
    made = tmp_path / "made"
    with pytest.raises(DocumentError, match=r"test\.yaml:1:1: "):
        parse_document(f"key: {value.format(made)}", Path("test.yaml"))
    assert not made.exists()


def test_emulators_listen_on_the_loopback_alone():
    port = TcpPort()
    with port._listener as listener:
        assert listener.getsockname()[0] == "127.0.0.1"
        assert port.url == f"socket://127.0.0.1:{listener.getsockname()[1]}"
    served = (ROOT / "drivers/served_ports.py").read_text()
    assert "0.0.0.0" not in served  # noqa: S104 - looked for, not bound


def test_provenance_takes_nothing_from_the_environment():
    assert "environ" not in (ROOT / "bench/runs/provenance.py").read_text()


def test_everything_installed_is_pinned():
    """What a user gets is what was tested: pip and the project itself apart."""
    pinned = dict(
        line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line
    )
    versions = {_plain(name): version for name, version in pinned.items()}
    for each in distributions():
        name = _plain(each.metadata["Name"])
        if name not in ("pip", "setuptools", "wheel", "gyrobench"):
            assert versions.get(name) == each.version, f"{name}=={each.version} is not in constraints.txt"


def test_the_audit_is_there():
    printed = subprocess.run(
        ["make", "-n", "audit"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert "pip_audit" in printed
    assert "constraints.txt" in printed


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
