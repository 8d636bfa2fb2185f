"""Effects that the design of a campaign can't distinguish, for any biases."""

from __future__ import annotations

import itertools

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import same_for_all_gyros
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray

#: Two sets of terms can't be distinguished if at most this share of the length of one is independent.
_CONFOUNDED_SHARE = 0.3
#: Degree of the polynomial in time that attitudes are compared with; time constant of the slow warm-up over
#: the length of the campaign.
_TIME_DEGREE, _SLOW_WARM_UP = 3, 0.5
_NO_HEADINGS = "Headings were not recorded (column azimuth_deg)"


def confounding(campaign: Campaign, searched: BoolArray) -> tuple[str, ...]:
    """Sentences on effects that the dwells searched (n,) can't distinguish, each with its reason.

    Two effects are confounded if their terms are dependent after projecting out the declared model.
    """
    searched_part, slow_time = campaign.part(searched), campaign.slow_time(_TIME_DEGREE)
    sentences, is_of_dwells = [], campaign.quantity.row == "dwell"
    if not is_of_dwells:
        sentences.append(
            "The coefficients of a plateau are those of all its attitudes: no effect of attitude can be seen "
            "or excluded."
        )
    elif len(set(searched_part.position)) == 1:
        sentences.append("All dwells are in one attitude: no effect of attitude can be seen or excluded.")
    elif len(list(itertools.groupby(searched_part.position))) == len(set(searched_part.position)):
        sentences.append(
            "Each attitude was measured once, in one stretch of time: attitude cannot be distinguished from "
            "drift, except by the form assumed for the drift."
        )
    elif _independent_share(campaign, searched, campaign.up_body, slow_time) < _CONFOUNDED_SHARE:
        sentences.append(
            "The attitudes follow each other as slowly as a drift: attitude cannot be distinguished from "
            "drift."
        )
    if len(set(searched_part.run.tolist())) == 1:
        decay = np.exp(
            -campaign.since_power_on_s / (_SLOW_WARM_UP * max(float(np.ptp(searched_part.middle_s)), 1.0))
        )
        if _independent_share(campaign, searched, decay[:, np.newaxis], slow_time) < _CONFOUNDED_SHARE:
            sentences.append(
                "All dwells searched are in one power cycle: a slow warm-up cannot be distinguished from "
                "drift."
            )
    if is_of_dwells and campaign.quantity.name == "accelerometer_bias":
        sentences.append(
            "A dwell shows an accelerometer's bias relative to the axis of its turn, as the gyros sense it: "
            "biases that follow gravity linearly cannot be distinguished from misalignments of gyros or "
            "accelerometers, at any temperature."
        )
    elif is_of_dwells and searched_part.has_one_heading is not False:
        headings = (
            "All dwells have one heading or its opposite" if searched_part.has_one_heading else _NO_HEADINGS
        )
        sentences.append(
            f"{headings}: an effect of the Earth's magnetic field cannot be distinguished from g-sensitivity."
        )
    if len(np.unique(searched_part.cycle)) == 1:
        sentences.append(
            "One cycle was searched: what repeats with the temperature profile cannot be distinguished from "
            "what happens once."
        )
    return tuple(sentences)


def _independent_share(
    campaign: Campaign, searched: BoolArray, terms: FloatArray, others: FloatArray
) -> float:
    """Largest share of terms (n, k) that is independent of others (n, l), without the declared model."""
    problem = declared_problem(campaign, searched)
    with_others = problem.with_columns(same_for_all_gyros(others))
    return with_others.independent_share(same_for_all_gyros(terms))
