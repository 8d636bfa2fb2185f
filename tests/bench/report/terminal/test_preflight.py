import io

from rich.console import Console

from gyrobench.bench.report.terminal.tables import preflight_report
from gyrobench.bench.station.check_result import Check

LONG = "can't open /dev/serial/by-id/usb-adapter-of-the-chamber: [Errno 2] No such file or directory"
CHECKS = [
    Check.of("rate table", "answers", True, "Acutrol", "never said"),
    Check.of("chamber", "answers", False, LONG, "Check the cable."),
    Check.skipped("disk", "space for the run", "unknown", "Give --procedure."),
]


def printed(checks):
    text = io.StringIO()
    Console(file=text, width=80, markup=False, highlight=False).print(preflight_report(checks))
    return text.getvalue()


def test_every_check_is_stated_in_80_columns_with_what_to_do_where_it_did_not_pass():
    text = printed(CHECKS)
    assert max(map(len, text.splitlines())) <= 80
    lines = [line.split() for line in text.splitlines()]
    assert ["pass", "answers", "Acutrol"] in lines
    assert lines.index(["rate", "table"]) < lines.index(["chamber"]) < lines.index(["disk"])
    assert "FAIL    answers" in text
    assert "Check the cable." in text
    assert "Give --procedure." in text
    assert "never said" not in text


def test_the_sum_says_whether_the_bench_is_ready():
    assert "1 passed, 1 failed, 1 skipped: not ready for a run." in printed(CHECKS)
    assert "1 passed, 0 failed, 1 skipped: ready for a run as far as checked." in printed(
        [CHECKS[0], CHECKS[2]]
    )
