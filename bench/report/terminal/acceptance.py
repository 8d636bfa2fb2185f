"""The verdict on a unit for a terminal of 80 columns."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.acceptance_wording import place_of, verdict_sentence
from gyrobench.bench.report.terminal.parts import plain_table
from gyrobench.bench.report.wording import BiasScale


def acceptance_summary(acceptance: Acceptance) -> RenderableType:
    """One line for each gyro, and the verdict on the unit."""
    verdict = Text(f"Unit {acceptance.verdict}. {verdict_sentence(acceptance)}", style="bold")
    judged = acceptance.judgements
    if not judged:
        return verdict
    scale = BiasScale.of([each.limit_dph for each in judged], [each.sigma_dph for each in judged])
    heading = f"Acceptance: largest differences in {scale.unit}, limits of the true ones"
    headers = ["gyro", "verdict", "where", "bin/°C", "measured", "true", "limit"]
    table = plain_table(headers, words=4, fold=False)
    for gyro in AXES:
        deciding = acceptance.deciding(gyro)
        cells = ["", "", "", "", ""]
        if deciding is not None:
            cells = [
                place_of(deciding).replace(" above ", " - "),
                bin_label(deciding.bin_low_c, deciding.bin_high_c, ".."),
                scale.text(deciding.value_dph),
                f"{scale.text(deciding.at_least_dph)}..{scale.text(deciding.at_most_dph)}",
                scale.text(deciding.limit_dph),
            ]
        table.add_row(gyro_label(gyro), acceptance.gyros.get(gyro, ""), *map(Text, cells))
    return Group(Text(heading, style="bold"), table, verdict)
