"""Optional packages: the commands that need one import it here and name the extra that installs it."""

from __future__ import annotations

import importlib
from typing import Any

from gyrobench.bench.foundations.errors import MissingPackageError

#: Extra of pyproject.toml that installs each optional package.
_EXTRAS = {
    "dask": "fleet",
    "distributed": "fleet",
    "duckdb": "index",
    "fsspec": "index",
    "weasyprint": "pdf",
    "asammdf": "mf4",
    "pandas": "pandas",
}


def require(module: str) -> Any:
    """Import a module of an optional package, as ``require("asammdf")``.

    Type checkers see the module's types with ``if TYPE_CHECKING: import asammdf``. Raises MissingPackageError
    if the package or one of its own dependencies is not installed; the message names the extra.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = error.name or package
        raise MissingPackageError(
            f"the Python package {missing} is not installed. Install it with "
            f"pip install 'gyrobench[{_EXTRAS[package]}]'"
        ) from error
