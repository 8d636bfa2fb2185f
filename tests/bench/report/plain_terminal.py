"""Views as a plain terminal shows them: lines that fit, without colours, and nothing cut off."""

import io

from rich.console import Console


def printed_lines(view, width=80):
    """Lines of a view."""
    stream = io.StringIO()
    Console(width=width, file=stream, force_terminal=False, color_system=None).print(view)
    lines = [line.rstrip() for line in stream.getvalue().splitlines()]
    assert max(map(len, lines)) <= width
    assert not any("…" in line or "\x1b" in line for line in lines)
    return lines


def printed(view):
    """Text of a view."""
    return "\n".join(printed_lines(view))
