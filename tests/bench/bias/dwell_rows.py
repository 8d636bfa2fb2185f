"""Dwell rows with nothing but what a test of their grouping and comparison needs."""

from gyrobench.bench.bias.dwell_table import DwellRow


def dwell_row(number, position, gyro_c, bias_dph=0.0, *, set_c=20.0, cycle=1, run="1", sigma_dph=0.001):
    return DwellRow(
        unit="1001", run=run, dwell=number, cycle=cycle, position=position, start_s=1500.0 * number,
        end_s=1500.0 * number + 1200.0, since_power_on_s=0.0, gyro_c=(gyro_c,) * 3,
        gyro_rate_c_per_h=(0.0,) * 3, bias_dph=(bias_dph,) * 3, sigma_dph=(sigma_dph,) * 3,
        chamber_set_c=set_c,
    )  # fmt: skip
