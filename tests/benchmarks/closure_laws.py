"""Laws of undeclared effects of simulated units: those that have a candidate, and those on no list."""

from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.kernels import compiled
from tests.benchmarks.closure_courses import STEP_H, Course, lagged


@dataclass(frozen=True)
class Law:
    """Terms of one effect on the grid, shape (m, 3, k), and the gains of each gyro, shape (3, k)."""

    terms: np.ndarray
    gains: np.ndarray
    values: tuple[float, ...] = ()  #: Parameters, as the candidate has them.
    is_candidates_own: bool = False


def _law(draw, shape, own=False, values=()):
    """Law of one term, (m, 3) or (m, 1); each gyro shows it, one of them often little."""
    gains = draw.choice([-1.0, 1.0], 3) * draw.uniform(0.4, 1.3, 3)
    if draw.random() < 0.4:
        gains[draw.integers(3)] *= 0.15
    return Law(np.broadcast_to(shape, (len(shape), 3))[:, :, None], gains[:, None], values, own)


def _above(c: Course, exponent: float) -> np.ndarray:
    above_c = c.board_c - c.optics_c
    return above_c * (np.abs(above_c) / 7.0 + 1e-9) ** exponent


def _temperature_rate(c, draw, own):
    def rate_of(course):
        return np.gradient(course.optics_c, STEP_H, axis=0)

    rate = rate_of(c)
    if own:
        return _law(draw, rate, own)
    limit = draw.uniform(2.5, 6.0) * c.of_laws(rate_of).std()
    return _law(draw, limit * np.tanh(rate / limit) * (1.0 + draw.uniform(-0.1, 0.1) * c.optics_c / 50.0))


def _thermal_gradient(c, draw, own):
    return _law(draw, _above(c, 0.0 if own else draw.uniform(0.1, 0.3)), own)


def _attitude_thermal(c, draw, own):
    onset_c, width_c = draw.uniform(20.0, 52.0), draw.uniform(2.0, 7.0)
    warmer = (c.optics_c - onset_c) / width_c
    laws = (
        lambda: 1.0 / (1.0 + np.maximum(warmer / 2.0 + 0.5, 0.0) ** 2),
        lambda: np.clip(0.5 - warmer / 4.0, 0.0, 1.0),
        lambda: 0.5 - np.arctan(warmer) / np.pi,
        lambda: np.maximum(-warmer, 0.0) ** draw.uniform(0.8, 1.0),
    )
    onset = 1.0 / (1.0 + np.exp(warmer)) if own else laws[draw.integers(len(laws))]()
    flow = _above(c, 0.0 if own else draw.uniform(0.05, 0.25)) * onset
    gravity = flow[:, :, None] * c.up[:, None, :]
    terms = np.concatenate([_above(c, 0.0)[:, :, None], gravity], axis=2)
    gains = draw.normal(0.0, 1.0, (3, 4)) * np.array([0.4, 1.0, 1.0, 1.0])
    return Law(terms, gains, (onset_c, width_c), own)


def _thermal_hysteresis(c, draw, own):
    width_c = draw.uniform(2.0, 10.0)
    if own:
        return _law(draw, play(c.optics_c, width_c) - c.optics_c, own, (width_c,))
    widths, weights = width_c * np.array([0.4, 0.8, 1.2, 2.0]), draw.dirichlet([2.0, 4.0, 4.0, 2.0])
    plays = [
        weight * (play(c.optics_c, width) - c.optics_c) for width, weight in zip(widths, weights, strict=True)
    ]
    return _law(draw, np.sum(plays, axis=0))


def _thermal_lag(c, draw, own):
    tau_h = draw.uniform(0.15, 1.6)
    if own:
        return _law(draw, c.optics_c - lagged(c.optics_c, tau_h), own, (tau_h * 3600.0,))
    behind = lagged(lagged(c.optics_c, 0.85 * tau_h), 0.15 * tau_h)
    return _law(draw, c.optics_c - behind)


def _warm_up(c, draw, own):
    tau_h = float(np.exp(draw.uniform(np.log(0.8), np.log(12.0))))
    if own:
        return _law(draw, np.exp(-c.since_h / tau_h)[:, None], own, (tau_h * 3600.0,))
    if draw.random() < 0.5:
        return _law(draw, np.exp(-((c.since_h / tau_h) ** draw.uniform(0.85, 1.15)))[:, None])
    fast = draw.uniform(0.0, 0.3)
    return _law(
        draw, (fast * np.exp(-3.0 * c.since_h / tau_h) + (1 - fast) * np.exp(-c.since_h / tau_h))[:, None]
    )


def _time_drift(c, draw, own):
    days = c.time_h / 24.0
    bend = 0.0 if own else draw.uniform(-0.06, 0.06)
    return _law(draw, (days + bend * days * (24.0 * days / c.length_h - 1.0))[:, None], own)


def _g_sensitivity(c, draw, own):
    terms = np.repeat(c.up[:, None, :], 3, axis=1)
    gains = draw.normal(0.0, 1.0, (3, 3)) + np.diag(draw.choice([-1.0, 1.0], 3))
    if own:
        return Law(terms, gains, (), own)
    return Law(terms * (1.0 + draw.uniform(-0.03, 0.03) * c.optics_c[:, :, None] / 50.0), gains)


def _chamber_state(c, draw, own):
    demand = np.maximum(c.cooling, 0.0)
    on, since, state = np.zeros(len(demand)), 0, False
    switch = draw.uniform(4.0, 9.0)
    for now, each in enumerate(demand.tolist()):
        since += 1
        if since >= 8 and state != (each > (0.6 * switch if state else switch)):
            state, since = not state, 0
        on[now] = state
    return _law(draw, (on * (1.0 + draw.uniform(0.0, 0.3) * np.minimum(demand / 60.0, 1.0)))[:, None])


def _bias_jump(c, draw, own):
    at_h = draw.uniform(0.12, 0.55) * c.length_h
    settle_h = 1e-3 if own else draw.uniform(0.02, 0.4)
    after = np.where(c.time_h >= at_h, -np.expm1(-np.maximum(c.time_h - at_h, 0.0) / settle_h), 0.0)
    return _law(draw, after[:, None], own, (at_h * 3600.0,))


def _thermal_g_sensitivity(c, draw, own):
    warm = (c.optics_c / 50.0) * (1.0 + draw.uniform(-0.1, 0.1) * c.optics_c / 50.0)
    return Law(warm[:, :, None] * c.up[:, None, :], draw.normal(0.0, 1.0, (3, 3)))


def _magnetic_sensitivity(c, draw, own):
    """Permanent and induced; a pair of headings half a turn apart cancels a part of the horizontal field."""
    dip, left = np.radians(draw.uniform(55.0, 75.0)), draw.uniform(0.3, 1.0)
    body = left * np.cos(dip) * c.north - np.sin(dip) * c.up
    terms = np.concatenate([body, 0.0 * body if own else 0.1 * body**2 * np.sign(body)], axis=1)
    return Law(np.repeat(terms[:, None, :], 3, axis=1), draw.normal(0.0, 1.0, (3, 6)))


def _supply_power(c, draw, own):
    return _law(draw, lagged(c.power[:, None], draw.uniform(0.01, 0.1)))


def _ageing(c, draw, own):
    tau_h = draw.uniform(15.0, 60.0)
    return _law(draw, np.log1p(c.time_h / tau_h)[:, None])


def _daily_course(c, draw, own):
    return _law(draw, c.room_c[:, None] if own else lagged(c.room_c[:, None], draw.uniform(0.1, 0.7)), own)


def _mode_hop(c, draw, own):
    comb_c, phase = draw.uniform(7.0, 16.0), draw.random(3)
    return _law(draw, (c.optics_c / comb_c + phase) % 1.0 - 0.5)


def _resonance(c, draw, own):
    at_c, width_c = draw.uniform(0.0, 60.0, 3), draw.uniform(1.5, 6.0)
    apart = (c.optics_c - at_c) / width_c
    return _law(draw, (1.0 if draw.random() < 0.5 else apart) / (1.0 + apart**2))


def _curve(c, draw, own):
    return _law(draw, ((c.optics_c - draw.uniform(0.0, 30.0)) / 40.0) ** int(draw.integers(4, 6)))


def _position_time(c, draw, own):
    course = np.sin(2.0 * np.pi * c.time_h / (c.length_h * draw.uniform(0.6, 2.0)) + draw.uniform(0.0, 6.3))
    return Law(np.repeat((c.up * course[:, None])[:, None, :], 3, axis=1), draw.normal(0.0, 1.0, (3, 3)))


def _supply_ripple(c, draw, own):
    return _law(
        draw, np.sin(2.0 * np.pi * c.time_h / draw.uniform(2.5, 9.0) + draw.uniform(0.0, 6.3))[:, None]
    )


def _telegraph(c, draw, own):
    flips = draw.random((len(c.time_h), 3)) < STEP_H / draw.uniform(1.5, 8.0)
    return _law(draw, 1.0 - 2.0 * (np.cumsum(flips, axis=0) % 2))


def _random_walk(c, draw, own):
    return _law(draw, np.cumsum(draw.standard_normal((len(c.time_h), 3)), axis=0))


def _flicker(c, draw, own):
    frequency = np.fft.rfftfreq(2 * len(c.time_h))
    frequency[0] = np.inf
    spectrum = np.fft.rfft(draw.standard_normal((2 * len(c.time_h), 3)), axis=0) / np.sqrt(frequency)[:, None]
    return _law(draw, np.fft.irfft(spectrum, axis=0)[: len(c.time_h)])


#: What a composed law may follow, by driver of the grammar of effects, shape (m, 3) or (m, 1).
_DRIVERS = {
    "gyro_c": lambda c: c.optics_c,
    "gyro_rate_c_per_h": lambda c: np.gradient(c.optics_c, STEP_H, axis=0),
    "above_optics_k": lambda c: c.board_c - c.optics_c,
    "case_c": lambda c: c.case_c[:, None],
    "chamber_c": lambda c: c.air_c[:, None],
    "room_c": lambda c: c.room_c[:, None],
}


def _composed(driver):
    """A law from driver, memory and shape that no effect of the list has."""

    def law(c, draw, own):
        state = _DRIVERS[driver](c)
        middle, spread = (of(c.of_laws(_DRIVERS[driver])) for of in (np.median, np.std))
        if driver in ("gyro_c", "case_c", "chamber_c") and draw.random() < 0.5:
            wide = draw.random() < 0.5
            state = play(state, 0.4 * spread) if wide else lagged(state, draw.uniform(0.5, 2.0))
        apart = (state - middle - draw.uniform(-0.7, 0.7) * spread) / (draw.uniform(0.15, 0.5) * spread)
        shapes = (1.0 / (1.0 + apart**2), 1.0 / (1.0 + np.exp(-apart)), np.logaddexp(0.0, apart))
        return _law(draw, shapes[draw.integers(len(shapes))], own)

    return law


#: Effects by name: those of the candidates, and those on no list.
ON_THE_LIST = {
    "temperature_rate": _temperature_rate, "thermal_gradient": _thermal_gradient,
    "attitude_thermal": _attitude_thermal, "thermal_hysteresis": _thermal_hysteresis,
    "thermal_lag": _thermal_lag, "warm_up": _warm_up, "time_drift": _time_drift,
    "g_sensitivity": _g_sensitivity, "chamber_state": _chamber_state, "bias_jump": _bias_jump,
    "thermal_g_sensitivity": _thermal_g_sensitivity, "magnetic_sensitivity": _magnetic_sensitivity,
    "supply_power": _supply_power, "ageing": _ageing, "daily_course": _daily_course,
}  # fmt: skip
ON_NO_LIST = {
    "mode_hop": _mode_hop, "resonance": _resonance, "curve": _curve, "position_time": _position_time,
    "supply_ripple": _supply_ripple, "telegraph": _telegraph, "random_walk": _random_walk,
    "flicker": _flicker,
}  # fmt: skip
COMPOSED = {f"composed, {driver}": _composed(driver) for driver in _DRIVERS}
EFFECTS = ON_THE_LIST | ON_NO_LIST | COMPOSED


@compiled
def play(values, half_width):
    out = values.copy()
    for now in range(1, len(values)):
        for column in range(values.shape[1]):
            low, high = values[now, column] - half_width, values[now, column] + half_width
            out[now, column] = min(max(out[now - 1, column], low), high)
    return out
