"""Numbers that figures, section and terminal show of a search for effects."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from gyrobench.bench.closure.candidates import tried
from gyrobench.bench.closure.loop import LEFT_OVER_P, Closure
from gyrobench.bench.closure.problem import Solution
from gyrobench.bench.closure.search import SIGNIFICANCE
from gyrobench.bench.closure.validation import measured_minus
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.report.number_format import BiasScale


def residuals_dph(closure: Closure, model: Solution) -> FloatArray:
    """Measured bias minus a model in all dwells (n, 3), deg/h.

    A run that was not searched has its own mean removed, as in the errors of the closure.
    """
    return measured_minus(closure.campaign, closure.searched, model)


def noise_dph(closure: Closure) -> FloatArray:
    """Standard deviation of the noise in all dwells (n, 3), deg/h."""
    return closure.campaign.sigma_dph * closure.noise_scale


def rms(values: FloatArray) -> float:
    """Root of the mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def held_out_cycles(closure: Closure) -> str:
    """Name the cycles that the search did not see: "cycle 3", "cycles 2 and 3"."""
    cycles = np.unique(closure.campaign.cycle[~closure.searched]).tolist()
    return f"cycle{'s' if len(cycles) > 1 else ''} {listed(list(map(str, cycles)))}"


def rests_on_noise(closure: Closure) -> bool:
    """Whether the declared model leaves no more than noise: then there is nothing to have shares of."""
    return closure.before.p_noise >= LEFT_OVER_P


def smallest_visible_dph(closure: Closure) -> float:
    """Rms size from which an effect on one gyro would have been found, deg/h.

    In the best case: an effect of one term that neither the temperature's cubic nor the runs'
    constants imitate. Its gain in the sum of squares would be the number of dwells searched times
    the square of its size over the noise.
    """
    efforts = [tried(each.effect, closure.campaign) for each in closure.evidence]
    gain = float(chi2_distribution.isf(SIGNIFICANCE / (min(efforts) * len(efforts)), 1))
    return closure.noise_dph * float(np.sqrt(gain / closure.searched.sum()))


def scale_of_errors(closure: Closure) -> BiasScale:
    """Choose unit and decimals for errors of a closure: a tenth of the noise is shown."""
    return BiasScale.of([closure.error_before_dph], [0.1 * closure.noise_dph])
