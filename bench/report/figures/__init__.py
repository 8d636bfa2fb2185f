"""Figures as matplotlib figures; none touches the state of matplotlib that other code uses."""

import sys

import matplotlib.artist

if "gyrobench.bench.cli" in sys.modules:
    # To write documentation for all classes of artists takes a third of the time to import matplotlib.
    matplotlib.artist.kwdoc = lambda artist: ""  # noqa: ARG005
    matplotlib.artist.Artist._update_set_signature_and_docstring = classmethod(lambda _: None)  # type: ignore[attr-defined]  # noqa: SLF001
