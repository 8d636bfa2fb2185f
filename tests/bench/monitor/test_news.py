import pytest

from gyrobench.bench.live.picture import RunState
from gyrobench.bench.monitor.news import age_text, news_of
from tests.bench.monitor.served_run import NOW


@pytest.mark.parametrize(
    ("state", "updated", "age_s", "is_over", "is_silent"),
    [
        (RunState.RUNNING, "2026-03-02T16:41:59+00:00", 2.0, False, False),
        (RunState.RUNNING, "2026-03-02T16:41:21+00:00", 40.0, False, True),
        (RunState.HOLDING, "2026-03-02T10:42:01+00:00", 21600.0, False, True),
        (RunState.FINISHED, "2026-03-01T16:42:01+00:00", 86400.0, True, False),
        (RunState.RUNNING, "2026-03-02T16:43:00+00:00", 0.0, False, False),
        (RunState.RUNNING, "", 0.0, False, False),
    ],
)
def test_a_run_that_should_write_and_does_not_is_silent(state, updated, age_s, is_over, is_silent):
    news = news_of(state, updated, NOW)
    assert (news.age_s, news.is_over, bool(news.warning)) == (age_s, is_over, is_silent)


def test_ages_are_told_in_the_unit_that_fits():
    ages = (0.4, 40.0, 720.0, 5 * 3600.0, 3 * 86400.0)
    assert [age_text(age_s) for age_s in ages] == ["0 s", "40 s", "12 min", "5 h", "3 days"]
