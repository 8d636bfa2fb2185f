"""Figures of reports and pages, one module for each subject, without changes of matplotlib's global state."""

import importlib.util
import sys

if "gyrobench.bench.cli" in sys.modules:
    # The glyph names take 15 ms to import and are needed only for PDF.
    _glyphs = importlib.util.find_spec("fontTools.agl")
    if _glyphs and _glyphs.loader and _glyphs.name not in sys.modules:
        _glyphs.loader = importlib.util.LazyLoader(_glyphs.loader)
        sys.modules[_glyphs.name] = importlib.util.module_from_spec(_glyphs)
        _glyphs.loader.exec_module(sys.modules[_glyphs.name])

    import matplotlib.artist

    # Generating the documentation of all artist classes takes a third of the import time of matplotlib.
    matplotlib.artist.kwdoc = lambda artist: ""  # noqa: ARG005
    matplotlib.artist.Artist._update_set_signature_and_docstring = classmethod(lambda _: None)  # type: ignore[attr-defined]  # noqa: SLF001
