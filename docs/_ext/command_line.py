"""The directive ``commands``: what every command's own help says, made from the command line itself."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer.main
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from yaml_keys import table

from gyrobench.bench.cli import app as command_line


def commands() -> Iterator[tuple[str, Any]]:
    """Every command by the words that call it, groups opened."""
    yield from _below("gyrobench", typer.main.get_command(command_line))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    if hasattr(command, "commands"):
        for word, below in command.commands.items():
            yield from _below(f"{name} {word}", below)
    else:
        yield name, command


class Commands(SphinxDirective):
    """A section for each command: help, arguments and options."""

    def run(self) -> list[nodes.Node]:
        """Make the sections."""
        return [self._section(name, command) for name, command in commands()]

    def _section(self, name: str, command: Any) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(name)], names=[name])
        section += nodes.title("", name)
        for text in inspect.cleandoc(command.help or "").split("\n\n"):
            joined = " ".join(text.split())
            head, example, rest = joined.partition("Example: ")
            if head:
                section += nodes.paragraph("", head.strip())
            if example:
                section += nodes.literal_block(rest, rest, language="text")
        rows = [_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
        if rows:
            kinds: list[Any] = [nodes.literal, nodes.Text, nodes.Text]
            section += table(("argument or option", "meaning", "default"), rows, (4, 7, 2), kinds)
        return section


def _row(parameter: Any) -> tuple[str, str, str]:
    is_argument = parameter.param_type_name == "argument"
    name = (parameter.metavar or parameter.name.upper()) if is_argument else ", ".join(parameter.opts)
    default = parameter.default
    shown = "" if default is None or callable(default) or default in ((), [], False) else str(default)
    return name, parameter.help or "", "required" if parameter.required else shown


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}
