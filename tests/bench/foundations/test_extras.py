"""Optional packages are imported on demand; a missing one is named with its extra."""

from __future__ import annotations

import sys

import pytest

from gyrobench.bench.foundations.errors import MissingPackageError
from gyrobench.bench.foundations.extras import require


def test_module_of_an_installed_package_is_returned() -> None:
    assert require("fsspec.spec") is sys.modules["fsspec.spec"]


@pytest.mark.parametrize(
    ("module", "extra"),
    [("dask", "fleet"), ("duckdb", "index"), ("weasyprint", "pdf"), ("asammdf.blocks", "mf4")],
)
def test_missing_package_is_named_with_its_extra(
    module: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module.partition(".")[0], None)
    monkeypatch.delitem(sys.modules, module if "." in module else "", raising=False)
    with pytest.raises(MissingPackageError, match=rf"pip install 'gyrobench\[{extra}\]'"):
        require(module)
