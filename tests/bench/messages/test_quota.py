from gyrobench.bench.messages.messenger import Quota


def test_the_hour_slides():
    quota = Quota(2)
    assert [quota.lets_pass("a", now_s) for now_s in (0.0, 1800.0, 3599.0, 3600.0, 3601.0, 5400.0)] == [
        True,
        True,
        False,
        True,
        False,
        True,
    ]


def test_what_is_not_the_same_has_an_hour_of_its_own():
    quota = Quota(1)
    assert quota.lets_pass("a", 0.0)
    assert quota.lets_pass("b", 0.0)
    assert not quota.lets_pass("a", 1.0)
