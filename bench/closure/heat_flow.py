"""Heat that reaches a gyro's optics from its electronics, by what warms them and what they lose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.stats import f as f_distribution

from bench.closure.campaign import Campaign

FloatArray = NDArray[np.float64]

_S_PER_H = 3600.0
_DWELLS_A_KNOT = 4
_CASE_TIMES_H = (0.3, 0.7, 1.5, 4.0)
_P = 1e-4


def into_optics_k(campaign: Campaign, case_time_h: float) -> FloatArray:
    """Heat flow into each gyro's optics (n, 3) over the conductance from optics to case, K.

    The optics' heat balance: ``time constant * dT/dt + (T - case)``.

    Parameters
    ----------
    campaign : Campaign
        With temperatures of the case.
    case_time_h : float
        Heat capacity of the optics over their conductance to the case.
    """
    return case_time_h * campaign.rate_c_per_h + campaign.gyro_c - campaign.case_c[:, np.newaxis]


def flow_depends_on_attitude(campaign: Campaign) -> bool:
    """Whether the temperatures alone show that the flow into the optics depends on gravity.

    What is smooth in time says nothing: an F-test asks whether the flow times the direction of
    gravity explains more of the flow than a smooth course does.
    """
    middle_s = campaign.middle_s
    inner = np.linspace(middle_s[0], middle_s[-1], max(len(campaign) // _DWELLS_A_KNOT, 4))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    smooth = BSpline.design_matrix(middle_s, knots, 3).toarray()
    best = 1.0
    for case_time_h in _CASE_TIMES_H:
        for flow_k in into_optics_k(campaign, case_time_h).T:
            turned = np.concatenate([smooth, flow_k[:, np.newaxis] * campaign.up_body], axis=1)
            without, with_it = (_misfit(columns, flow_k) for columns in (smooth, turned))
            freedom = len(flow_k) - turned.shape[1]
            if freedom > 0 and with_it > 0.0:
                ratio = (without - with_it) / 3.0 / (with_it / freedom)
                best = min(best, float(f_distribution.sf(ratio, 3, freedom)))
    return best * 3 * len(_CASE_TIMES_H) < _P


def _misfit(columns: FloatArray, data: FloatArray) -> float:
    rest = data - columns @ np.linalg.lstsq(columns, data, rcond=None)[0]
    return float(rest @ rest)
