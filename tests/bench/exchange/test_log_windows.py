import numpy as np

from gyrobench.bench.exchange.log_windows import cut_windows, max_consecutive


def batches(count, size):
    random = np.random.default_rng(0)
    time_s = np.arange(count) * 0.5
    rates = {f"rate_{axis}": random.standard_normal(count) for axis in "xyz"}
    samples = {"time_s": time_s, **rates, "gyro_x_c": 20.0 + time_s}
    return [
        {name: values[begin : begin + size] for name, values in samples.items()}
        for begin in range(0, count, size)
    ]


def test_windows_do_not_depend_on_how_the_log_was_cut_into_batches():
    whole = list(cut_windows(batches(1000, 1000), 30.0, 5.0))
    for size in (1, 7, 60, 999):
        parts = list(cut_windows(batches(1000, size), 30.0, 5.0))
        assert [each.start_s for each in parts] == [each.start_s for each in whole]
        for part, one in zip(parts, whole, strict=True):
            np.testing.assert_array_equal(part.rate_dph, one.rate_dph)
            assert part.max_step_s == one.max_step_s
            assert part.trends == one.trends


def test_no_more_than_a_batch_and_a_window_are_held():
    read = []

    def counted():
        for batch in batches(1000, 10):
            read.append(batch)
            yield batch

    first = next(cut_windows(counted(), 30.0, 0.0))
    assert first.samples == 60
    assert len(read) == 7


def test_the_slope_is_per_hour():
    [*_, window] = cut_windows(batches(1000, 100), 30.0, 0.0)
    assert np.isclose(window.trends["gyro_x_c"].slope_per_h, 3600.0)


def test_the_longest_run_of_true_values_is_counted():
    assert max_consecutive(np.array([True, False, True, True, True, False, True, True])) == 3
    assert max_consecutive(np.array([False, False])) == 0
    assert max_consecutive(np.array([], dtype=bool)) == 0
