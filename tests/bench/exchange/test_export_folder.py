import pytest

from gyrobench.bench.exchange.export_folder import type_of, unit_of


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("bias_x_dph", "deg/h"),
        ("gyro_x_rate_c_per_h", "K/h"),
        ("rate_dph_per_c_per_h", "deg/h per K/h"),
        ("growing_dph_per_k", "deg/h per K"),
        ("outer_rate_dps", "deg/s"),
        ("case_c", "degC"),
        ("latitude_error_arcmin", "arcmin"),
        ("spread_p_value", "1"),
        ("position", ""),
    ],
)
def test_a_name_reports_its_unit(column, unit):
    assert unit_of(column) == unit


def test_names_counts_and_values_have_types_of_their_own():
    import pyarrow as pa

    assert type_of("unit") == pa.string()
    assert type_of("dwell") == pa.int64()
    assert type_of("bias_x_dph") == pa.float64()
