"""The list of commands in `gyrobench --help`, grouped by task."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

#: Commands by task; a command without a group is listed last.
GROUPS: dict[str, tuple[str, ...]] = {
    "Measure": ("run", "resume", "control", "verify"),
    "Before a run": ("plan", "check", "jog", "message"),
    "Watch and report": ("monitor", "report", "export", "bins", "close", "import", "raw-rate"),
    "Many runs": ("runs", "fleet"),
    "Files": ("new", "validate", "schema"),
    "Try and learn": ("emulate", "record", "replay"),
}
_OTHERS = "Other"
#: The first sentence is shown in full.
_MAX_HELP = 300


class CommandGroups(TyperGroup):
    """Lists its commands group by group."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands, in the order of the groups."""
        known = super().list_commands(ctx)
        grouped = [name for names in GROUPS.values() for name in names if name in known]
        return [*grouped, *(name for name in known if name not in grouped)]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the groups into the help."""
        names = self.list_commands(ctx)
        widest = max(map(len, names))
        grouped = {name: group for group, of_group in GROUPS.items() for name in of_group}
        for group in (*GROUPS, _OTHERS):
            rows = []
            for name in names:
                command = self.get_command(ctx, name)
                if command is not None and not command.hidden and grouped.get(name, _OTHERS) == group:
                    rows.append((name.ljust(widest), command.get_short_help_str(_MAX_HELP)))
            if rows:
                with formatter.section(group):
                    formatter.write_dl(rows)
