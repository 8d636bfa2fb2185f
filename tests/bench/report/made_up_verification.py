"""Verifications with made-up measurements, one for each judgement; each is made once."""

from dataclasses import replace
from functools import cache

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.engine.verification_runs import flags_note
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.verification.compensation_verification import (
    MeasuredRun,
    VerificationResult,
    compare_runs,
)
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


def compare(closure, residual_dph, notes=(), lost=()):
    """VerificationResult of compensations that leave a bias along Up, by their names.

    ``lost``: pairs of a compensation and the number of a dwell with flags.
    """
    fitted_c = closure.campaign.gyro_c[closure.searched]
    whole = model_with_effects(closure)
    return VerificationResult(
        source="runs/made-up-001",
        closure=closure,
        models={"declared": declared_model(closure), **({"effect": whole} if whole.effects else {})},
        results=compare_runs(
            [
                MeasuredRun(name, _with_flags(rows_of(size, seed=seed), name, lost), [])
                for seed, (name, size) in enumerate(residual_dph.items())
            ],
            SITE,
            fitted_c,
        ),
        new_attitudes=14,
        dwells=14,
        is_same_seed=True,
        notes=tuple(notes),
    )


def _with_flags(rows, name, lost):
    flags = {True: ("the table moved",), False: ()}
    return [replace(row, flags=flags[(name, row.dwell) in lost]) for row in rows]


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
    return compare(clean(), {"none": 0.0, "declared": 0.0}, [flags_note("none", 1, 15)])


@cache
def alone():
    return compare(explained(), {"none": 0.02})


@cache
def degraded():
    """The declared model leaves more than no compensation, the model with the effects noise."""
    return compare(explained(), RESIDUAL_DPH | {"none": 0.008})


@cache
def without_a_plateau():
    """One run has no valid dwell at the second plateau, dwells 7 and 8, and the last one lacks dwell 3."""
    return compare(explained(), RESIDUAL_DPH, lost=[("declared", 7), ("declared", 8), ("effect", 3)])
