"""What a candidate effect is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.foundations.arrays import FloatArray


@dataclass(frozen=True)
class Parameter:
    """A number that a form of an effect is fitted with, beside its sizes.

    Attributes
    ----------
    name : str
        With its unit: "tau_s", "onset_c".
    low, high : float
        Bounds of the fit.
    starts : callable
        Gives the values that the fit starts from, for a campaign: all of them are tried.
    is_open_end : bool
        Whether the upper bound stands for values beyond it, with which the effect becomes another
        one: a time constant as long as the campaign is a drift.
    """

    name: str
    low: float
    high: float
    starts: Callable[[Campaign], FloatArray]
    is_open_end: bool = False


@dataclass(frozen=True)
class Form:
    """One mathematical form of an effect.

    Attributes
    ----------
    name : str
        What tells it from the effect's other forms; empty where there is one only.
    terms : tuple of str
        What each term follows, with its unit.
    columns : callable
        Terms of a campaign at values of the parameters: shape (n, 3, k), NaN nowhere. The bias of a
        gyro is a sum of its k terms, each times a size in deg/h.
    parameters : tuple of Parameter
        Those that all three gyros share.
    lacks : callable
        Says which input the form needs and the campaign does not have; None if it has all.
    """

    terms: tuple[str, ...]
    columns: Callable[[Campaign, tuple[float, ...]], FloatArray]
    parameters: tuple[Parameter, ...] = ()
    lacks: Callable[[Campaign], str | None] = lambda campaign: None  # noqa: ARG005
    name: str = ""


@dataclass(frozen=True)
class Effect:
    """A physical cause of gyro bias that the declared model lacks.

    Attributes
    ----------
    name : str
        As in ``closure.json``.
    statement : str
        What it says of the bias, for a person; a sentence without its end: "the bias follows ...".
    experiment : str
        The measurement that shows it alone, for a person: "hold ... and ...".
    forms : tuple of Form
        The forms tried; the one that fits best counts.
    imitated_by : tuple of str
        Names of effects that correlate with it so much that, where they can't be tried, they may be
        the cause in its place.
    """

    name: str
    statement: str
    experiment: str
    forms: tuple[Form, ...]
    imitated_by: tuple[str, ...] = ()


def fixed(*values: float) -> Callable[[Campaign], FloatArray]:
    """Starting values that do not depend on the campaign."""
    return lambda campaign: np.array(values)  # noqa: ARG005


def above_optics_c(campaign: Campaign) -> FloatArray:
    """Temperature of the electronics above the optics (n, 3), NaN where nothing tells it."""
    known = campaign.above_optics_c
    return np.full_like(campaign.gyro_c, np.nan) if known is None else known


def needs_positions(campaign: Campaign) -> str | None:
    """Say what lacks where all dwells are in one position."""
    return "dwells in more than one position" if len(set(campaign.position)) < 2 else None


def needs_electronics(campaign: Campaign) -> str | None:
    """Say what lacks where nothing tells the electronics' temperatures."""
    return (
        "temperature sensors at the gyros' electronics, or at the case with dwells that follow one another"
        if campaign.above_optics_c is None
        else None
    )
