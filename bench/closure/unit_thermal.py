"""Thermal model of a unit in a chamber: a chain of first-order lags.

The case follows the chamber air, the optics of each gyro follow the case, and the electronics the optics; the
power of the unit raises each temperature. The lags and temperature rises are those of a typical unit, or
fitted to a measured campaign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.temperature_record import lag
from gyrobench.bench.foundations.arrays import FloatArray, rms
from gyrobench.bench.procedure.estimate import ThermalEstimate

#: Typical unit: share of the case in the lag of the gyros behind the air, and in their self-heating.
_CASE_LAG_SHARE = 0.2
_CASE_HEATING_SHARE = 0.35
#: Temperature of the electronics above the optics in a powered unit, and its lag.
ELECTRONICS_ABOVE_OPTICS_K = 12.0
_ELECTRONICS_LAG_SHARE = 0.25
#: Share of the electronics' heat that flows to the case; the rest flows to the optics.
_CASE_SHARE_OF_ELECTRONICS = 0.7
#: Relative reduction of the electronics' temperature above the optics by convection if the optics are
#: directly above; directions from electronics to optics of the x, y and z gyro, perpendicular to its axis.
_CONVECTION_SHARE = 0.08
_TO_OPTICS_BODY = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
#: Number of samples for a mean over a dwell.
_INSTANTS = 21
#: Bounds of a fitted lag; smallest number of dwells for a fit.
_LAGS_S = (60.0, 36_000.0)
_MIN_DWELLS = 12
#: Number of lags that are tried for a case without a sensor.
_CASE_LAGS = 20
#: Assumed rate of the chamber in pauses, and share of the next dwell from which on a pause counts.
_RAMP_C_PER_S, _MAX_PAUSE = 2.0 / 60.0, 0.05


@dataclass(frozen=True)
class Course:
    """Temperatures of air and unit at m times, degC."""

    time_s: FloatArray  #: Shape (m,).
    #: air_c, case_c: Shape (m,). Chamber air, and case.
    air_c: FloatArray
    case_c: FloatArray
    #: optics_c, electronics_c: Shape (m, 3). Temperatures of each gyro.
    optics_c: FloatArray
    electronics_c: FloatArray

    def means(self, values: FloatArray, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Means of values at all times (m,) or (m, k) over n intervals: (n,) or (n, k)."""
        return _means(self.time_s, values, start_s, end_s)

    def changes_c(self, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Changes of the optics over n intervals, (n, 3)."""
        first_c, last_c = (
            np.stack([np.interp(each, self.time_s, optics_c) for optics_c in self.optics_c.T], axis=1)
            for each in (start_s, end_s)
        )
        return np.asarray(last_c - first_c)

    @property
    def end(self) -> Course:
        """The last instant."""
        return Course(*(getattr(self, name)[-1:] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class UnitThermal:
    """Lags and temperature rises of a unit; arrays in the order of the gyros."""

    case_lag_s: float  #: Lag of the case behind the air.
    case_rise_k: float  #: Case above the air after a long soak with the unit on.
    optics_lag_s: FloatArray  #: Shape (3,). Lag behind the case.
    electronics_lag_s: FloatArray  #: Shape (3,). Lag behind the optics.
    #: optics_rise_k, electronics_rise_k: Shape (3, 4). Optics above the case, and electronics above the
    #: optics, after a long soak: constant part, then the coefficients of Up along x, y and z.
    optics_rise_k: FloatArray
    electronics_rise_k: FloatArray
    rms_k: float | None  #: Rms residual of the fit to the optics; None for a typical unit.

    @classmethod
    def typical(cls, thermal: ThermalEstimate) -> UnitThermal:
        """A navigation-grade unit with the lag and self-heating that a station states."""
        case_lag_s = _CASE_LAG_SHARE * thermal.time_constant_s
        rise_k = np.hstack([np.ones((3, 1)), -_CONVECTION_SHARE * _TO_OPTICS_BODY])
        return cls(
            case_lag_s,
            _CASE_HEATING_SHARE * thermal.self_heating_c,
            np.full(3, thermal.time_constant_s - case_lag_s),
            np.full(3, _ELECTRONICS_LAG_SHARE * thermal.time_constant_s),
            np.outer(np.full(3, (1.0 - _CASE_HEATING_SHARE) * thermal.self_heating_c), [1.0, 0.0, 0.0, 0.0]),
            ELECTRONICS_ABOVE_OPTICS_K * rise_k,
            rms_k=None,
        )

    def course(
        self,
        time_s: FloatArray,
        air_c: FloatArray,
        power: FloatArray,
        up_body: FloatArray,
        start: Course | None = None,
    ) -> Course:
        """Temperatures of the unit.

        Parameters
        ----------
        time_s, air_c, power : ndarray, shape (m,)
            Times, temperature of the air, and dissipation relative to that of the powered unit: 0 if off.
        up_body : ndarray, shape (m, 3)
            Unit vector Up in body axes; zero if unknown.
        start : Course, optional
            Its last instant gives the temperatures at the first time; by default the steady state with the
            first air temperature and power.
        """
        last = None if start is None else start.end
        initial_c = [None] * 7 if last is None else [*last.case_c, *last.optics_c[0], *last.electronics_c[0]]
        case_c = _lagged(air_c + self.case_rise_k * power, time_s, self.case_lag_s, initial_c[0])
        driven = power[:, np.newaxis] * np.column_stack([np.ones(len(time_s)), up_body])
        optics_c, electronics_c = np.empty((len(time_s), 3)), np.empty((len(time_s), 3))
        for gyro in range(3):
            target_c = case_c + driven @ self.optics_rise_k[gyro]
            optics_c[:, gyro] = _lagged(target_c, time_s, self.optics_lag_s[gyro], initial_c[1 + gyro])
            board_target_c = (
                _unpowered_electronics_c(optics_c[:, gyro], target_c) + driven @ self.electronics_rise_k[gyro]
            )
            lag_s = self.electronics_lag_s[gyro]
            electronics_c[:, gyro] = _lagged(board_target_c, time_s, lag_s, initial_c[4 + gyro])
        return Course(time_s, air_c, case_c, optics_c, electronics_c)

    def fitted_to(self, campaign: Campaign) -> tuple[UnitThermal, Course | None]:
        """Fit lags and rises to the dwells of a campaign; returns also the course of the temperatures.

        Values that were not measured (rise of the case, electronics) stay as they are. Without a temperature
        of the chamber nothing is fitted, and the course is None. The unit is assumed to be on from the first
        dwell to the last, with any temperatures at each power-on.
        """
        whole = campaign.whole
        time_s, air_c = whole.record.time_s, whole.record.air_c
        if air_c is None:
            air_c = _air_between_dwells(whole, time_s)
        if len(whole) < _MIN_DWELLS or not np.isfinite(air_c).all():
            return self, None
        dwell_index = np.clip(np.searchsorted(whole.start_s, time_s, side="right") - 1, 0, None)
        driven = np.column_stack([np.ones(len(time_s)), whole.up_body[dwell_index]])
        case_lag_s, case_rise_k = self.case_lag_s, self.case_rise_k
        if np.isfinite(whole.case_c).all():
            case_lag_s, [case_rise_k], case_c = _fit_lag(whole, time_s, whole.case_c, air_c, driven[:, :1])
        else:  # the lag with which the optics of the x gyro fit best

            def sum_of_squares(lag_s: float) -> float:
                case_c = _lagged(air_c + case_rise_k, time_s, lag_s, None)
                course_c = _fit_lag(whole, time_s, whole.gyro_c[:, 0], case_c, driven)[2]
                residual_k = _means(time_s, course_c, whole.start_s, whole.end_s) - whole.gyro_c[:, 0]
                return float(np.sum(residual_k**2))

            case_lag_s = min(np.geomspace(_LAGS_S[0], _LAGS_S[1], _CASE_LAGS).tolist(), key=sum_of_squares)
            case_c = _lagged(air_c + case_rise_k, time_s, case_lag_s, None)
        optics, electronics = [], []
        for gyro in range(3):
            optics.append(_fit_lag(whole, time_s, whole.gyro_c[:, gyro], case_c, driven))
            around_c = _unpowered_electronics_c(optics[gyro][2], case_c + driven @ optics[gyro][1])
            if np.isfinite(whole.board_c[:, gyro]).all():
                electronics.append(_fit_lag(whole, time_s, whole.board_c[:, gyro], around_c, driven))
            else:
                lag_s, rise_k = self.electronics_lag_s[gyro], self.electronics_rise_k[gyro]
                course_c = _lagged(around_c + driven @ rise_k, time_s, lag_s, None)
                electronics.append((lag_s, rise_k, course_c))
        optics_lags_s, optics_rises_k, optics_c = map(np.array, zip(*optics, strict=True))
        lags_s, rises_k, electronics_c = map(np.array, zip(*electronics, strict=True))
        residual_k = _means(time_s, optics_c.T, whole.start_s, whole.end_s) - whole.gyro_c
        rms_k = rms(residual_k)
        fitted = UnitThermal(
            case_lag_s, float(case_rise_k), optics_lags_s, lags_s, optics_rises_k, rises_k, rms_k
        )
        return fitted, Course(time_s, air_c, case_c, optics_c.T, electronics_c.T)


def _air_between_dwells(campaign: Campaign, time_s: FloatArray) -> FloatArray:
    """Air temperature (m,) from the means of the dwells: linear between them, in a pause a ramp at its start.

    If the air was not measured, it is replaced by the set point within the dwells.
    """
    air_c, nodes = campaign.air_c, dict(zip(campaign.middle_s.tolist(), campaign.air_c.tolist(), strict=True))
    if not np.isfinite(air_c).all():
        air_c, path_c = campaign.set_c, campaign.set_point_path_c
        fractions = (np.arange(path_c.shape[1]) + 0.5) / path_c.shape[1]
        node_s = (
            campaign.start_s[:, np.newaxis] + fractions * (campaign.end_s - campaign.start_s)[:, np.newaxis]
        )
        nodes = dict(zip(node_s.ravel().tolist(), path_c.ravel().tolist(), strict=True))
    lengths_s, pauses_s = campaign.end_s - campaign.start_s, campaign.start_s[1:] - campaign.end_s[:-1]
    for index in np.flatnonzero(pauses_s > _MAX_PAUSE * lengths_s[1:]):
        ramp_start_s, ramp_s = campaign.end_s[index], abs(air_c[index + 1] - air_c[index]) / _RAMP_C_PER_S
        nodes[ramp_start_s] = air_c[index]
        nodes[ramp_start_s + min(ramp_s + 1.0, pauses_s[index])] = air_c[index + 1]
    node_s = sorted(nodes)
    return np.asarray(np.interp(time_s, node_s, [nodes[each_s] for each_s in node_s]))


def _fit_lag(
    campaign: Campaign, time_s: FloatArray, measured_c: FloatArray, driven_c: FloatArray, columns: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Fit a temperature that lags ``driven_c`` plus ``columns`` (m, k) to the means of the dwells.

    Returns its lag, the sizes (k,) of the columns and its course (m,). It may start from any temperature at
    the first time and at each power-on.
    """
    starts_s = [time_s[0], *(each for each in campaign.power_on_s if time_s[0] < each < time_s[-1])]
    driven = np.column_stack([driven_c, columns])

    def solve(log_lag: float) -> tuple[float, FloatArray, FloatArray]:
        lag_s = float(np.exp(log_lag))
        since_s = time_s[:, np.newaxis] - np.array(starts_s)
        decays = np.where(since_s >= 0.0, np.exp(-np.maximum(since_s, 0.0) / lag_s), 0.0)
        columns_and_decays = np.hstack([driven + lag(driven, time_s, lag_s), decays])
        means = _means(time_s, columns_and_decays, campaign.start_s, campaign.end_s)
        sizes = np.linalg.lstsq(means[:, 1:], measured_c - means[:, 0], rcond=1e-9)[0]
        course = columns_and_decays[:, 0] + columns_and_decays[:, 1:] @ sizes
        residual_c = measured_c - means[:, 0] - means[:, 1:] @ sizes
        return float(np.sum(residual_c**2)), np.asarray(sizes), np.asarray(course)

    minimum = minimize_scalar(
        lambda log_lag: solve(log_lag)[0], bounds=tuple(np.log(_LAGS_S)), method="bounded"
    )
    _, sizes, course = solve(minimum.x)
    return float(np.exp(minimum.x)), sizes[: columns.shape[1]], course


def _lagged(target: FloatArray, time_s: FloatArray, lag_s: float, initial: float | None) -> FloatArray:
    """First-order lag of a target (m,), from an initial value or, if None, at rest before the first time."""
    lagged = target + lag(target[:, np.newaxis], time_s, lag_s)[:, 0]
    if initial is not None:
        lagged = lagged + (initial - target[0]) * np.exp(-(time_s - time_s[0]) / lag_s)
    return np.asarray(lagged)


def _unpowered_electronics_c(optics_c: FloatArray, target_c: FloatArray) -> FloatArray:
    """Temperature that the electronics would have without power."""
    return np.asarray(optics_c + _CASE_SHARE_OF_ELECTRONICS * (target_c - optics_c))


def _means(time_s: FloatArray, values: FloatArray, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
    instants_s = np.linspace(start_s, end_s, _INSTANTS)
    columns = [np.interp(instants_s, time_s, each).mean(axis=0) for each in np.atleast_2d(values.T)]
    return np.asarray(columns[0] if values.ndim == 1 else np.stack(columns, axis=1))
