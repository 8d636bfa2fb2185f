"""The search for effects and stock methods of model selection on the log of a measured MEMS IMU.

Each part of the log is foreseen from the rest; errors are rms over the held-out windows, deg/h.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.exchange.log_import import import_logs
from tests.benchmarks.stock_methods import METHODS, held_out_errors

IMU = Path(__file__).parents[3] / "shared" / "data" / "imu_thermal" / "imu_raw_data.csv"
BLOCK_S = 300.0


def in_blocks(rows, block_s):
    """Rows with numbered blocks as cycles, and the cycles to hold out: the odd and the even ones."""
    numbered = [replace(row, cycle=1 + int((row.start_s - rows[0].start_s) // block_s)) for row in rows]
    cycles = {row.cycle for row in numbered}
    return [(numbered, [cycle for cycle in cycles if cycle % 2 == odd]) for odd in (1, 0)]


def last_cooling(rows):
    """The same with all after the hottest window as the last cycle, which is held out."""
    hottest = max(range(len(rows)), key=lambda index: rows[index].gyro_c[0])
    numbered = in_blocks(rows, BLOCK_S)[0][0]
    return [([*numbered[: hottest + 1], *(replace(row, cycle=99) for row in rows[hottest + 1 :])], [99])]


def dealt(rows, held_out):
    """Rows in two cycles, the second one held out, as the stock methods take them."""
    return [replace(row, cycle=2 if row.cycle in held_out else 1) for row in rows]


def rms(errors):
    return np.sqrt((np.concatenate(errors) ** 2).mean(axis=0)).round().astype(int)


@pytest.mark.skipif(not IMU.exists(), reason="the measured log of an IMU is not beside the checkout")
def test_search_beside_stock_methods():
    rows = import_logs([IMU], "tofupilot_imu").rows
    tests = {
        "5-min blocks": in_blocks(rows, BLOCK_S),
        "10-min blocks": in_blocks(rows, 2.0 * BLOCK_S),
        "last cooling": last_cooling(rows),
    }
    for label, parts in tests.items():
        closures = [close_loop(campaign_of(part), held_out) for part, held_out in parts]
        errors = {
            name: [
                (each.campaign.bias_dph - getattr(each, model).bias_dph)[~each.searched] for each in closures
            ]
            for name, model in (("cubic", "declared"), ("gyrobench close", "model"))
        }
        for name, method in METHODS.items():
            results = [(dealt(*part), method(dealt(*part))) for part in parts]
            errors[name] = [held_out_errors(part, result.after_dph, 2) for part, result in results]
        print(f"\n{label}: held-out rms x, y, z, deg/h")
        for name, each in errors.items():
            print(f"  {name:18s} {'  '.join(f'{value:5d}' for value in rms(each))}")
        for number, each in enumerate(closures, 1):
            found = [
                f"{one.candidate.effect.name} {[round(value) for value in one.candidate.values]}"
                f"{' tied with ' + ', '.join(one.tied_with) if one.tied_with else ''}"
                for one in each.effects
            ]
            alone = rms([errors["cubic"][number - 1]]), rms([errors["gyrobench close"][number - 1]])
            print(
                f"    part {number} held out: {each.verdict}; {'; '.join(found) or 'nothing proven'}; "
                f"{alone[0]} -> {alone[1]}; what is left: {each.after.noise_ratio:.0f} x noise"
            )
            assert np.isfinite(each.error_after_dph)
