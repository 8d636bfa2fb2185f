"""Estimates the gyro biases of one dwell by the full error model of an INS at rest.

The model contains the terms that the paper's method neglects: the Schuler loop, the Earth rate and the
accelerometers. Their unknown parameters are estimated together with the biases. The random walk of the
sensors enters as integrated noise, so that every epoch has the correct weight, and the covariance follows
from the data. Level gyros are measured by the velocity, which is still correct if the mount creeps; the
vertical gyro by the heading inside each window, so the heading in a turn has no influence. The estimate is
recursive: epochs may be added as they arrive, and the estimate may be read at any time.

The goodness of fit is tested with the sums of the innovations over each minute. The residuals of a wrong
model change slowly: the normalised sum of white residuals keeps unit variance, that of slow ones grows with
the number of epochs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias import parameters, window_filter
from gyrobench.bench.bias.bias_steps import MIN_STEP_P_VALUE, BiasStep, WindowChange, find_bias_step
from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.dwell import BiasEstimate, Dwell, NavigationWindow, RestOutput, TurnPath
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.bias.error_split import ErrorPart, ErrorParts, noise_parts, prior_parts
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.bias.statistics import Chi2Test, chi2_p_value, chi2_test, least_chi2, solve
from gyrobench.bench.bias.window_filter import WindowFilter
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray, IntArray, block_diagonal
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import EARTH_RATE, earth_rate_enu
from gyrobench.bench.navigation.error_model import STATES, integrate, unit_walks

#: Prior of the damping rate without prior knowledge, 1/s.
_WIDE_DAMPING = 1.0
#: Prior of the latitude error without prior knowledge, rad.
_WIDE_LATITUDE = 0.1
#: Prior of a change of acceleration without prior knowledge, m/s^2; and the p-value above which
#: accelerometers count as settled.
_WIDE_ACCELERATION, _MAX_TRANSIENT_P_VALUE = 0.1, 0.01


@dataclass(frozen=True, eq=False)
class DwellInformation:
    """Information of a dwell's data on its parameters, without prior knowledge."""

    #: Shape (n, p). White rows with unit variance, for the parameters of
    #: :mod:`gyrobench.bench.bias.parameters`.
    rows: FloatArray
    data: FloatArray  #: Shape (n,). Data of these rows.
    #: bias_at_mean, acceleration_at_mean: Shape (3, p). Biases of gyros and accelerometers at their mean
    #: temperatures for a unit of each parameter.
    bias_at_mean: FloatArray
    acceleration_at_mean: FloatArray
    earth_rate: FloatArray  #: Shape (3,). ENU, rad/s.
    #: Rate North, rad/s, due to the heading error beyond the linear model; subtracted from the data.
    north_rate: float = 0.0

    @property
    def windows(self) -> int:
        """Number of windows."""
        return int(self.rows.shape[1] - parameters.COMMON_COUNT) // parameters.PER_WINDOW


@dataclass(frozen=True, eq=False, slots=True)
class StateSpaceEstimate(BiasEstimate):
    """Gyro biases of one dwell at the mean temperature of each gyro, with the results of the tests."""

    #: accelerometer_bias, accelerometer_sigma: Shape (3,). M/s^2, body axes; an axis that stays vertical is
    #: not measured and keeps its prior uncertainty.
    accelerometer_bias: FloatArray
    accelerometer_sigma: FloatArray
    #: Shape (3,). Part of it due to the errors that are the same in all dwells of the attitude, m/s^2; NaN
    #: for an incomplete dwell.
    accelerometer_common_sigma: FloatArray
    fit: Chi2Test  #: Goodness of fit of the model.
    #: Probability that the biases of the windows differ at least as much, if each gyro has one bias.
    steady_p_value: float
    #: Most significant step of the biases in the dwell; None in very short windows, or if not searched for.
    step: BiasStep | None
    #: Damping of the velocities, by these data or by the tilt; the biases assume none, as in a free inertial
    #: INS.
    damping: Damping
    #: latitude_error, latitude_sigma: Of the latitude that the INS uses, rad, by these data without prior.
    latitude_error: float
    latitude_sigma: float
    #: For the joint solution of several dwells; None if only :class:`JointInformation` of it is kept.
    information: DwellInformation | None
    parts: Mapping[str, ErrorPart]  #: Errors of the biases by source; empty for an incomplete dwell.

    @property
    def common_sigma_dph(self) -> FloatArray:
        """Standard uncertainties (3,) due to the errors that are the same in all dwells of the attitude."""
        return RADPS_TO_DPH * _sigma_of_attitude(self.parts)

    @property
    def probable_step(self) -> BiasStep | None:
        """The bias step if it is significant, and more so than all other tests; otherwise None."""
        other_p_values = self.fit.p_value, self.steady_p_value, self.damping.p_value
        return self.step if self.step and self.step.p_value < min(MIN_STEP_P_VALUE, *other_p_values) else None


def _sigma_of_attitude(parts: Mapping[str, ErrorPart]) -> FloatArray:
    """Standard uncertainties (3,) due to the errors that are the same in all dwells of an attitude."""
    columns = [part.columns for name, part in parts.items() if SOURCES[name].is_of_attitude]
    return np.asarray(np.linalg.norm(np.hstack([np.zeros((3, 1)), *columns]), axis=1))


class BiasFilter:
    """Recursive estimate of one dwell."""

    def __init__(self, model: ErrorModel) -> None:
        self._model = model
        self._earth_rate = earth_rate_enu(model.site.latitude)
        self._windows: list[WindowFilter] = []
        self._prior_root = parameters.prior_root(model.prior, 0, self._earth_rate)
        self._expansions: list[FloatArray] = []
        self._changes: list[WindowChange] = []
        self._reference_c = np.full(4, np.nan)
        self._last_change_k = np.zeros(4)

    def begin_window(self, time_s: float, C_nb: FloatArray, turn: TurnPath | None = None) -> None:
        """Begin a window of navigation at rest.

        ``time_s``, ``C_nb`` (3, 3): first epoch on the clock of the INS, and the attitude that it computes
        then; ``turn``: attitude of the table from the last window to this one. Raises MeasurementError if a
        window after the first has no turn, or begins before the last one ends.
        """
        count = parameters.COMMON_COUNT + parameters.PER_WINDOW * (len(self._windows) + 1)
        state_response = np.zeros((STATES, count))
        negated_state, covariance = np.zeros(STATES), np.zeros((STATES, STATES))
        if self._windows:
            if turn is None:
                raise MeasurementError("a window after the first one needs the turn that led to it")
            if not time_s > self._windows[-1].last_s:
                raise MeasurementError(
                    f"a window begins at {time_s:.3f} s, but the previous one has epochs until "
                    f"{self._windows[-1].last_s:.3f} s. Add windows in order, none of them empty"
                )
            last = self._windows[-1]
            change, turn_response = self._through_turn(time_s, turn, count - parameters.PER_WINDOW)
            self._changes.append(change)
            before = last.columns[:, : window_filter.DATA] @ self._expansions[-1]
            state_response[:, : -parameters.PER_WINDOW] = change.transition @ before + turn_response
            negated_state = change.transition @ last.columns[:, window_filter.DATA]
            noise = self._model.noise
            walks = np.square([noise.angle_random_walk, noise.velocity_random_walk])
            covariance = change.transition @ last.covariance @ change.transition.T
            covariance += np.tensordot(walks, change.walk_covariance, 1)
        state_response[3:5, count - parameters.PER_WINDOW :][:, parameters.VELOCITY] = np.eye(2)
        state_response[:3, count - parameters.PER_WINDOW :][:, parameters.ATTITUDE] = np.eye(3)
        self._windows.append(WindowFilter(self._model, time_s, C_nb, negated_state, covariance))
        self._expansions.append(_expansion(state_response, C_nb, self._earth_rate))
        self._prior_root = parameters.prior_root(self._model.prior, len(self._windows), self._earth_rate)

    def add(self, rest: RestOutput) -> None:
        """Add the next epochs of the present window.

        Only the first epoch of each second is used. The biases of gyros and accelerometers may change with
        their temperatures, if these are known. Raises MeasurementError if no window has begun, or a value is
        not a number.
        """
        if not self._windows:
            raise MeasurementError("epochs need a window that they belong to: begin one first")
        time_s, velocity_en_mps = rest.time_s, rest.velocity_enu_mps[:, :2]
        if not all(np.isfinite(each).all() for each in (time_s, velocity_en_mps, rest.C_nb)):
            raise MeasurementError(f"an epoch after {time_s[0]:.3f} s is not a number")
        chosen = self._windows[-1].new_epochs(time_s)
        if len(chosen):
            temperatures = self._changes_since_first(_temperatures(rest)[chosen])
            self._last_change_k = temperatures[-1]
            self._windows[-1].add(time_s[chosen], velocity_en_mps[chosen], rest.C_nb[chosen], temperatures)

    def estimate(self, complete: bool = False) -> StateSpaceEstimate:
        """Estimate the biases from the epochs added so far.

        For a ``complete`` dwell this also tests whether accelerometers settle after a turn and whether a bias
        steps; otherwise neither is assumed.

        Raises MeasurementError if there was no turn yet, or no epoch has been added after it.
        """
        if len(self._windows) < 2 or not self._windows[-1].epochs:
            raise MeasurementError(
                "no navigation after a turn: the biases are not observable beside the initial errors. "
                "Turn the unit and navigate again"
            )
        information, parameter_mask = self._information(test=complete)
        values, covariance = self._solution(information)
        full_parameters = _add_north_rate(values, information)
        expansions = [each * parameter_mask[: each.shape[1]] for each in self._expansions]
        at_mean, acceleration = information.bias_at_mean, information.acceleration_at_mean
        latitude_error, latitude_sigma = self._latitude(information)
        return StateSpaceEstimate(
            bias_radps=at_mean @ values,
            covariance=at_mean @ covariance @ at_mean.T,
            accelerometer_bias=acceleration @ values,
            accelerometer_sigma=np.sqrt(np.diag(acceleration @ covariance @ acceleration.T)),
            accelerometer_common_sigma=_sigma_of_attitude(
                self._prior_parts(information, parameter_mask, acceleration, covariance)
            )
            if complete
            else np.full(3, np.nan),
            fit=self._goodness_of_fit(expansions, full_parameters, covariance),
            steady_p_value=self._steady_p_value(information),
            step=find_bias_step(self._windows, self._changes, expansions, full_parameters, covariance)
            if complete
            else None,
            damping=self._damping(information),
            latitude_error=latitude_error,
            latitude_sigma=latitude_sigma,
            information=information,
            parts=self._error_parts(information, parameter_mask, expansions, covariance) if complete else {},
        )

    def _error_parts(
        self,
        information: DwellInformation,
        parameter_mask: FloatArray,
        expansions: list[FloatArray],
        covariance: FloatArray,
    ) -> ErrorParts:
        gain = covariance @ information.bias_at_mean.T
        noise = noise_parts(self._windows, self._changes, expansions, gain, self._model)
        by_prior = self._prior_parts(information, parameter_mask, information.bias_at_mean, covariance)
        return ErrorParts(noise | by_prior)

    def _prior_parts(
        self,
        information: DwellInformation,
        parameter_mask: FloatArray,
        at_mean: FloatArray,
        covariance: FloatArray,
    ) -> dict[str, ErrorPart]:
        """Errors of linear functions ``at_mean`` (3, p) of the parameters due to prior knowledge."""
        at_gain = at_mean @ covariance @ information.rows.T @ information.rows
        response = (at_mean - at_gain) @ self._prior_root
        return prior_parts(response, self._model.prior, parameter_mask, len(self._windows))

    def goodness_of_fit(self) -> Chi2Test:
        """Test whether the model explains the epochs added so far, even of a single window."""
        information, parameter_mask = self._information(test=True)
        expansions = [each * parameter_mask[: each.shape[1]] for each in self._expansions]
        values, covariance = self._solution(information)
        return self._goodness_of_fit(expansions, _add_north_rate(values, information), covariance)

    def chi2(self) -> float:
        """Sum of squared residuals of the data and of the parameters about their prior, in sigmas."""
        information = self.information()
        return least_chi2(information.rows, information.data, self._prior_root)

    def _solution(self, information: DwellInformation) -> tuple[FloatArray, FloatArray]:
        return solve(information.rows, information.data, self._prior_root)

    def _steady_p_value(self, information: DwellInformation) -> float:
        """Test whether the biases of any window differ from those of the dwell.

        The goodness-of-fit test has so many sums that a small difference between two windows would hide in
        it.
        """
        changes = [window.root[:, window_filter.INPUT :][:, :3] @ window.C_nb for window in self._windows]
        rows = np.hstack([information.rows, block_diagonal(*changes)[:, 3:]])
        count = len(self._prior_root)
        wide = np.eye(rows.shape[1] - count) * parameters.WIDE_GYRO_BIAS
        values, covariance = solve(rows, information.data, block_diagonal(self._prior_root, wide))
        significances = np.abs(values[count:]) / np.sqrt(np.diag(covariance)[count:])
        return min(1.0, len(significances) * math.erfc(significances.max() / math.sqrt(2.0)))

    def _damping(self, information: DwellInformation) -> Damping:
        prior_root = self._prior_root.copy()
        prior_root[parameters.DAMPING, parameters.DAMPING] = _WIDE_DAMPING
        values, covariance = solve(information.rows, information.data, prior_root)
        variance = float(covariance[parameters.DAMPING, parameters.DAMPING])
        # A random walk of the velocity returns to its mean by chance, which looks like damping. If constants
        # are fitted, the information on the rate times its mean estimate is half the duration for each axis
        # (Dickey and Fuller, 1979).
        duration_s = sum(window.last_s - window.first_s for window in self._windows)
        return Damping(float(values[parameters.DAMPING]) - duration_s * variance, math.sqrt(variance))

    def _latitude(self, information: DwellInformation) -> tuple[float, float]:
        prior = replace(self._model.prior, latitude=_WIDE_LATITUDE)
        prior_root = parameters.prior_root(prior, len(self._windows), self._earth_rate)
        values, covariance = solve(information.rows, information.data, prior_root)
        rates = parameters.NAVIGATION_RATE
        latitude_gain = np.array([self._earth_rate[2], -self._earth_rate[1]]) / EARTH_RATE**2
        sigma = math.sqrt(latitude_gain @ covariance[rates, rates] @ latitude_gain)
        return float(latitude_gain @ values[rates]), sigma

    def _changes_since_first(self, temperatures_c: FloatArray) -> FloatArray:
        """Change (n, 4) of temperatures since the first one; NaN is replaced by the latest known change."""
        self._reference_c = np.where(np.isnan(self._reference_c), temperatures_c[0], self._reference_c)
        changes = temperatures_c - self._reference_c
        return np.where(np.isnan(changes), self._last_change_k, changes)

    def _through_turn(self, time_s: float, turn: TurnPath, count: int) -> tuple[WindowChange, FloatArray]:
        """Propagation through a turn, and the state (6, count) after it for a unit of each parameter."""
        last = self._windows[-1]
        turn_transition, state_response = np.eye(STATES), np.zeros((STATES, count))
        walk_covariance = np.zeros((2, STATES, STATES))
        # The unit rests before and after the turn. The attitude is that of the INS before the turn, moved
        # with the table.
        edges = np.clip(np.concatenate([[last.last_s], turn.time_s, [time_s]]), last.last_s, time_s)
        path = last.C_nb @ turn.C_nb[0].T @ np.concatenate([turn.C_nb[:1], turn.C_nb, turn.C_nb[-1:]])
        rotations = rotation_vectors(path[:-1].transpose(0, 2, 1) @ path[1:])
        middle = path[:-1] @ rotation_matrices(0.5 * rotations)
        durations = np.diff(edges)
        site = self._model.site
        steps, walks = integrate(site, durations, 0.0, 0.0), unit_walks(site, durations)
        for k in np.flatnonzero(durations > 0.0):
            rate_body = middle[k].T @ self._earth_rate + rotations[k] / durations[k]
            inputs = parameters.inputs(middle[k], rate_body, count)
            inputs[:3, parameters.GYRO_SLOPE] = middle[k] * self._last_change_k[:3]
            inputs[3:, parameters.ACCELEROMETER_SLOPE] = middle[k][:2] * self._last_change_k[3]
            transition = steps.transition[k]
            turn_transition = transition @ turn_transition
            state_response = transition @ state_response + steps.response[k] @ inputs
            walk_covariance = transition @ walk_covariance @ transition.T + walks[:, k]
        return WindowChange(
            turn_transition, state_response[:, parameters.GYRO_BIAS], walk_covariance
        ), state_response

    def _information(self, test: bool) -> tuple[DwellInformation, FloatArray]:
        """Information in all epochs added, and a mask (p,) of the parameters in it, 0 or 1.

        Estimating the settling of the accelerometers after a turn raises the uncertainty of the level gyros
        by a sixth, so accelerometers count as settled unless the data contradict it.
        """
        information = self.information()
        count = len(self._windows)
        transient_indices = parameters.transients(count)
        parameter_mask = np.ones(information.rows.shape[1])
        if not len(transient_indices) or self._model.prior.accelerometer_transient == 0.0:
            return information, parameter_mask
        if not (test and self._transient_p_value(information, transient_indices) < _MAX_TRANSIENT_P_VALUE):
            parameter_mask[transient_indices] = 0.0
        return replace(information, rows=information.rows * parameter_mask), parameter_mask

    def _transient_p_value(self, information: DwellInformation, transient_indices: IntArray) -> float:
        prior_root = self._prior_root.copy()
        prior_root[transient_indices, transient_indices] = _WIDE_ACCELERATION
        values, covariance = solve(information.rows, information.data, prior_root)
        changes_mps2 = values[transient_indices]
        covariance = covariance[np.ix_(transient_indices, transient_indices)]
        # Short windows can't distinguish settling from a bias, so they are no evidence of it.
        if np.sqrt(np.diag(covariance)).max() > self._model.prior.accelerometer_transient:
            return 1.0
        chi2 = float(changes_mps2 @ np.linalg.solve(covariance, changes_mps2))
        return chi2_p_value(len(transient_indices), chi2)

    def information(self) -> DwellInformation:
        """Information in all epochs added, without prior knowledge.

        A gyro bias East turns the heading that an INS finds by gyrocompassing: 2 deg for 0.5 deg/h. This
        reduces the Earth's rate North in its axes by half the square of that angle, which the linear model
        lacks.
        """
        count = self._expansions[-1].shape[1]
        pairs = list(zip(self._windows, self._expansions, strict=True))
        temperature_sum = np.sum([each.temperature_sum for each in self._windows], axis=0)
        mean_k = temperature_sum / sum(each.epochs for each in self._windows)
        at_mean, acceleration_at_mean = np.zeros((2, 3, count))
        at_mean[:, parameters.GYRO_BIAS] = acceleration_at_mean[:, parameters.ACCELEROMETER_BIAS] = np.eye(3)
        at_mean[:, parameters.GYRO_SLOPE] = np.diag(mean_k[:3])
        acceleration_at_mean[:, parameters.ACCELEROMETER_SLOPE] = mean_k[3] * np.eye(3)
        linear = DwellInformation(
            rows=np.vstack([_expand_rows(window.root, expansion, count) for window, expansion in pairs]),
            data=np.concatenate([window.root[:, window_filter.DATA] for window in self._windows]),
            bias_at_mean=at_mean,
            acceleration_at_mean=acceleration_at_mean,
            earth_rate=self._earth_rate,
        )
        heading = float(self._solution(linear)[0][parameters.FIRST_HEADING_ERROR])
        north_rate = (math.cos(heading) - 1.0) * float(self._earth_rate[1])
        data = linear.data - north_rate * linear.rows[:, parameters.NAVIGATION_RATE.start]
        return replace(linear, data=data, north_rate=north_rate)

    def _goodness_of_fit(
        self, expansions: list[FloatArray], values: FloatArray, covariance: FloatArray
    ) -> Chi2Test:
        totals = [window.minute_sums() for window in self._windows]
        sums = np.concatenate([each[:, window_filter.DATA] for each in totals])
        pairs = zip(totals, expansions, strict=True)
        responses = np.concatenate([_expand_rows(*pair, len(values)) for pair in pairs])
        return chi2_test(sums - responses @ values, responses, covariance)


def _temperatures(rest: RestOutput) -> FloatArray:
    """Temperatures (n, 4) of the gyros and the accelerometers; NaN if not known."""
    count = len(rest.time_s)
    return np.column_stack(
        [
            np.full((count, 3), np.nan) if rest.gyro_c is None else rest.gyro_c,
            np.full(count, np.nan) if rest.accelerometer_c is None else rest.accelerometer_c,
        ]
    )


def _add_north_rate(values: FloatArray, information: DwellInformation) -> FloatArray:
    """Parameters (p,) that explain the innovations, from which the rate North was not subtracted."""
    result = values.copy()
    result[parameters.NAVIGATION_RATE.start] += information.north_rate
    return result


def estimate_state_space(dwell: Dwell, model: ErrorModel) -> StateSpaceEstimate:
    """Estimate the gyro biases of one complete dwell; see the module docstring.

    Raises MeasurementError if the dwell has no turn.
    """
    return _filter_dwell(dwell, model).estimate(complete=True)


def dwell_chi2(dwell: Dwell, model: ErrorModel) -> float:
    """Chi-square of a dwell under an error model; see :meth:`BiasFilter.chi2`."""
    return _filter_dwell(dwell, model).chi2()


def _filter_dwell(dwell: Dwell, model: ErrorModel) -> BiasFilter:
    bias_filter = BiasFilter(model)
    for index, window in enumerate(dwell.windows):
        turn = dwell.turns[index - 1] if index else None
        bias_filter.begin_window(window.time_s[0], window.C_nb[0], turn)
        bias_filter.add(window)
    return bias_filter


def navigation_fit(window: NavigationWindow, model: ErrorModel) -> Chi2Test:
    """Test whether an error model explains one navigation; does not test the alignment."""
    bias_filter = BiasFilter(model)
    bias_filter.begin_window(window.time_s[0], window.C_nb[0])
    bias_filter.add(window)
    return bias_filter.goodness_of_fit()


def _expansion(state_response: FloatArray, C_nb: FloatArray, earth_rate: FloatArray) -> FloatArray:
    """Columns of a window (c, p) for a unit of each parameter, given its first state (6, p)."""
    count = state_response.shape[1]
    expansion = np.zeros((window_filter.DATA, count))
    expansion[: window_filter.INPUT] = state_response
    expansion[window_filter.INPUT : window_filter.HEADING] = parameters.inputs(
        C_nb, C_nb.T @ earth_rate, count
    )
    expansion[window_filter.HEADING, count - parameters.PER_WINDOW + parameters.HEADING] = 1.0
    expansion[window_filter.SLOPE : window_filter.ACCELEROMETER_SLOPE, parameters.GYRO_SLOPE] = np.eye(3)
    expansion[window_filter.ACCELEROMETER_SLOPE : window_filter.TRANSIENT, parameters.ACCELEROMETER_SLOPE] = (
        C_nb[:2]
    )
    expansion[window_filter.TRANSIENT : window_filter.DAMPING, count - parameters.PER_WINDOW :][
        :, parameters.TRANSIENT
    ] = np.eye(2)
    expansion[window_filter.DAMPING, parameters.DAMPING] = 1.0
    return expansion


def _expand_rows(rows: FloatArray, expansion: FloatArray, count: int) -> FloatArray:
    """Convert rows for the columns of a window (n, c) to rows for all parameters of the dwell (n, count)."""
    result = np.zeros((len(rows), count))
    result[:, : expansion.shape[1]] = rows[:, : window_filter.DATA] @ expansion
    return result
