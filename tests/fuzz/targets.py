"""What is fuzzed: base files, how they are damaged, and the code that reads them.

A target's ``use`` writes the damaged bytes into a folder, reads them as a command does, and raises
:class:`~tests.fuzz.checks.WrongResultError` where the result disagrees with an independent reading of
the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from tests.fuzz import documents, run_folders, sensor_logs, tables
from tests.fuzz.mutations import (
    Mutator,
    damaged_bytes,
    damaged_csv,
    damaged_dbc,
    damaged_json,
    damaged_json_lines,
    damaged_yaml,
)

#: A place in a document; a file that can't be taken for text has none.
_YAML = r"\.yaml:\d+:\d+: |/input/fuzzed\.yaml: (is not UTF-8|\d+ bytes; at most)"
#: The world that is used with each station: the station file may be right by itself.
_NO_FIT = r"/worlds/quick\.yaml: .* Choose a world and a station that belong together"
_TABLE = r"/input/fuzzed\.csv:"


@dataclass(frozen=True)
class Target:
    """One kind of file.

    Attributes
    ----------
    share : int
        How many of the inputs are of this kind, relative to the others.
    base : tuple of bytes
        Files to damage.
    damage : Mutator
        How.
    use : callable
        ``use(folder, data)``: reads the data as the commands do, in an empty folder.
    place : str
        Regular expression of a place that a message has to name.
    """

    share: int
    base: tuple[bytes, ...]
    damage: Mutator
    use: Callable[[Path, bytes], None]
    place: str

    def input(self, random: Random) -> bytes:
        """Make one damaged file."""
        return self.damage(random, random.choice(self.base))


def finished_run(shared: Path) -> Path:
    """Give a finished run, whose files are damaged; made where it is not yet there."""
    return run_folders.finished_run(shared, tables.dwell_table())


def targets(run: Path) -> dict[str, Target]:
    """Give the targets by name.

    Parameters
    ----------
    run : Path
        A finished run folder.
    """
    return _documents() | _tables(run) | _run_files(run)


def _documents() -> dict[str, Target]:
    shipped, port = documents.shipped, r"^(rate table|chamber|INS): .*(port|channel|interface|address|://)"
    return {
        "procedure": Target(20, shipped("procedures"), damaged_yaml, documents.use_procedure, _YAML),
        "station": Target(
            18, shipped("stations"), damaged_yaml, documents.use_station, f"{_YAML}|{port}|{_NO_FIT}"
        ),
        "world": Target(14, shipped("worlds"), damaged_yaml, documents.use_world, _YAML),
        "fault list": Target(6, shipped("faults"), damaged_yaml, documents.use_faults, _YAML),
        "DBC": Target(
            14,
            (documents.dbc_path().read_bytes(),),
            damaged_dbc,
            documents.use_dbc,
            r"/input/\w+\.(dbc|yaml):",
        ),
        "compensation": Target(
            3, (documents.COMPENSATION.encode(),), damaged_yaml, documents.use_compensation, _YAML
        ),
    }


def _tables(run: Path) -> dict[str, Target]:
    dwells = (tables.dwell_table(), (run / "dwells.csv").read_bytes())
    return {
        "dwell table": Target(14, dwells, damaged_csv, tables.use_dwell_table, _TABLE),
        "import map": Target(
            4, (sensor_logs.MAP.encode(),), damaged_yaml, sensor_logs.use_map, f"{_YAML}|/input/log\\.csv:"
        ),
        "sensor log": Target(4, (sensor_logs.log().encode(),), damaged_csv, sensor_logs.use_log, _TABLE),
    }


def _run_files(run: Path) -> dict[str, Target]:
    def target(
        share: int,
        name: str,
        damage: Mutator,
        use: Callable[[Path], Callable[[Path, bytes], None]],
        base: tuple[bytes, ...] = (),
    ) -> Target:
        place = rf"/input/run(/|: ){name.split('/')[0]}"
        return Target(share, base or ((run / name).read_bytes(),), damage, use(run), place)

    part, readings = run_folders.PART, "telemetry/part-00001.parquet"
    journals = run_folders.cut_journals(run)
    return {
        "journal": target(3, "journal.jsonl", damaged_json_lines, run_folders.use_journal),
        "resumed run": target(2, "journal.jsonl", damaged_json_lines, run_folders.use_cut_journal, journals),
        "CAN log": target(2, part, damaged_bytes, run_folders.use_can_log),
        "telemetry": target(1, readings, damaged_bytes, run_folders.use_telemetry),
        "provenance": target(1, "provenance.json", damaged_json, run_folders.use_provenance),
        "noise": target(1, "noise.json", damaged_json, run_folders.use_noise),
        "verification table": target(2, "verification.csv", damaged_csv, run_folders.use_verification_table),
        "calibration table": target(2, "calibration.csv", damaged_csv, run_folders.use_calibration_table),
        "closure": Target(
            1, (run_folders.CLOSURE.encode(),), damaged_json, run_folders.use_closure, r"/input/closure\.json"
        ),
    }
