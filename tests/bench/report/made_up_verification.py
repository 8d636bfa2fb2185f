"""Verifications with made-up measurements, one for each judgement; each is made once."""

from functools import cache

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.verification.compensation_verification import VerificationResult, compensation_result
from tests.bench.report.made_up_closure import clean, explained

SITE = Site(np.radians(36.4), 60.0)
SIGMA_DPH = 0.001
#: Residual bias along Up with each compensation, deg/h.
RESIDUAL_DPH = {"none": 0.02, "declared": 0.015, "effect": 0.0}


def rows_of(bias_along_up_dph, constant_dph=0.003, seed=1, positions=POSITIONS):
    """Dwells at three temperatures, two of them in all positions."""
    random = np.random.default_rng(seed)
    stops = [(1, 50.0, positions), (2, 20.0, ["x_up", "z_down"]), (1, -10.0, positions)]
    rows = []
    for cycle, set_c, names in stops:
        for name in names:
            up = POSITIONS[name].C_nb()[2]
            bias_dph = constant_dph + bias_along_up_dph * up + SIGMA_DPH * random.standard_normal(3)
            number = len(rows) + 1
            rows.append(
                DwellRow(
                    unit="1001",
                    run="run 9",
                    dwell=number,
                    cycle=cycle,
                    position=name,
                    start_s=1800.0 * number,
                    end_s=1800.0 * (number + 1),
                    since_power_on_s=1800.0 * number,
                    gyro_c=(set_c + 12.0,) * 3,
                    gyro_rate_c_per_h=(0.0,) * 3,
                    bias_dph=tuple(bias_dph),
                    sigma_dph=(SIGMA_DPH,) * 3,
                    azimuth_deg=90.0,
                    chamber_set_c=set_c,
                )
            )
    return rows


def compare(closure, residual_dph, notes=()):
    """VerificationResult of compensations that leave a bias along Up, by their names."""
    fitted_c = closure.campaign.gyro_c[closure.searched]
    whole = model_with_effects(closure)
    return VerificationResult(
        source="runs/made-up-001",
        closure=closure,
        models={"declared": declared_model(closure), **({"effect": whole} if whole.effects else {})},
        results=tuple(
            compensation_result(name, rows_of(size, seed=seed), [], SITE, fitted_c)
            for seed, (name, size) in enumerate(residual_dph.items())
        ),
        new_attitudes=14,
        dwells=14,
        is_same_seed=True,
        notes=tuple(notes),
    )


@cache
def confirmed():
    return compare(explained(), RESIDUAL_DPH)


@cache
def improved():
    return compare(explained(), RESIDUAL_DPH | {"effect": 0.008})


@cache
def not_confirmed():
    return compare(explained(), RESIDUAL_DPH | {"effect": 0.03})


@cache
def inconclusive():
    return compare(clean(), {"none": 0.0, "declared": 0.0}, ["In the run none 1 of 15 dwells have flags."])


@cache
def alone():
    return compare(explained(), {"none": 0.02})
