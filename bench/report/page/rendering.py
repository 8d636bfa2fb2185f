"""HTML pages that need nothing beside them: pictures and style are inside."""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from gyrobench.bench.navigation.positions import position_label


def render_page(template: str, **content: object) -> str:
    """Fill a template of this package.

    Parameters
    ----------
    template : str
        Name of its file.
    **content
        What the template asks for.
    """
    environment = Environment(
        loader=PackageLoader("gyrobench.bench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.filters["position"] = position_label
    return environment.get_template(template).render(**content)


def _data_uri(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
