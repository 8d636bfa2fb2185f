"""Effects of the surroundings: the chamber, other units in it, the supply, the Earth's magnetic field.

* Chamber: vibration, air flow or magnetic fields of its cooling. The refrigeration runs while the set point
  falls and while it is cold, or while there is heat to remove: heat that leaks in from the room, and heat
  that walls and load release for about an hour after a ramp. In the latter form it runs while the set point,
  minus the temperature of the walls above it times the ratio of the two conductances, is below a limit.
* Other units: their heat warms one side of the unit.
* Supply: the bias follows its power at once, or with the lag of the parts that it heats. Electronics, heaters
  and discharge warm their vicinity within minutes after each power-on; with constant power this is a warm-up.
  How long the INS was off before the first power-on is unknown, so these parts may still be warm then.
* Magnetic field: its vertical component is exactly a g-sensitivity, since both follow Up. The horizontal
  component turns with the heading; a pair of headings half a turn apart cancels it if both have the same
  weight. The direction of the effective field is fitted: its inclination is that of the Earth's field if a
  dwell has one heading, and steeper if the pair cancels a part.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrobench.bench.bias.dwell_table import NEIGHBOURS_ON
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    Form,
    Parameter,
    fixed,
    needs_positions,
    no_ins_term,
    same_for_all_gyros,
    time_constant,
)
from gyrobench.bench.closure.effects.grammar import Law, course_of, driver_values, form_of, mean_decay
from gyrobench.bench.closure.temperature_record import lag
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.navigation.positions import POSITIONS

_MIN_SLOPE_C = 1e-4
#: Half width of the transition in which the refrigeration switches, K; it makes the terms depend smoothly on
#: the limit.
_SWITCHING_C = 0.5


def _refrigeration(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Shares of each dwell with a falling set point, and with one that requires cooling: (n, 3, 2)."""
    path_c = campaign.set_point_path_c
    falling = np.mean(np.diff(path_c, axis=1) < -_MIN_SLOPE_C, axis=1)
    cold = np.mean(path_c < values[0], axis=1)
    return same_for_all_gyros(np.stack([falling, cold], axis=1))


def _heat_to_remove(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Share of each dwell with heat to remove: (n, 3, 1)."""
    cold_below_c, ratio, tau_s = values
    record, set_c = campaign.record, course_of("chamber_set_c", campaign)[:, :1]
    limited_c = set_c - ratio * lag(set_c, record.time_s, tau_s)
    neighbours_c = np.concatenate([limited_c[:1], limited_c, limited_c[-1:]])
    low_c = np.minimum(np.minimum(neighbours_c[:-2], neighbours_c[2:]), limited_c) - _SWITCHING_C
    high_c = np.maximum(np.maximum(neighbours_c[:-2], neighbours_c[2:]), limited_c) + _SWITCHING_C
    runs = np.clip((cold_below_c - low_c) / (high_c - low_c), 0.0, 1.0)
    return same_for_all_gyros(campaign.means_over_dwells(runs))


def _missing_set_point(campaign: Campaign) -> str | None:
    return None if np.isfinite(campaign.set_c).all() else "the chamber's set point"


CHAMBER_STATE = Effect(
    name="chamber_state",
    statement="the bias changes while the chamber's refrigeration runs",
    experiment="hold a temperature and switch the chamber's compressor and fan off for several dwells",
    compensation=no_ins_term("it belongs to the chamber, not to the INS"),
    forms=(
        Form(
            ("cooling, share of the dwell", "holding cold, share of the dwell"),
            _refrigeration,
            (Parameter("cold_below_c", -15.0, 25.0, fixed(-12.0, -5.0, 5.0, 15.0)),),
            _missing_set_point,
            "falling or cold",
        ),
        Form(
            ("heat to remove, share of the dwell",),
            _heat_to_remove,
            (
                Parameter("cold_below_c", -40.0, 25.0, fixed(-10.0, 2.0, 14.0)),
                Parameter("walls_to_leak", 0.5, 30.0, fixed(2.0, 8.0)),
                Parameter("walls_tau_s", 900.0, 14_400.0, fixed(3600.0)),
            ),
            _missing_set_point,
            "heat to remove",
        ),
    ),
)


_NEIGHBOURS = Law(NEIGHBOURS_ON, memory="lag", parameters=(time_constant(60.0, 300.0, 1800.0),))


def _neighbours_heat(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Lagging number of other units that are on, (n, 3, 1); without their heat before the first power-on."""
    count_at_start = campaign.whole.columns[NEIGHBOURS_ON][0]
    heat_before_power_on = count_at_start * mean_decay(campaign, campaign.power_on_s[:1], values[0])
    return _NEIGHBOURS.columns(campaign, values) - same_for_all_gyros(heat_before_power_on[:, np.newaxis])


def _missing_neighbour(campaign: Campaign) -> str | None:
    if NEIGHBOURS_ON not in campaign.columns:
        return "another unit in the chamber"
    if np.ptp(campaign.columns[NEIGHBOURS_ON]) == 0.0:
        return "dwells with the unit beside it on, and others with it off"
    return _NEIGHBOURS.missing_input(campaign)


NEIGHBOURING_UNIT = Effect(
    name="neighbouring_unit",
    statement="the bias changes while another unit in the chamber is on, and follows its heat",
    experiment="leave this unit on and switch the one beside it off and on again, for several dwells each",
    forms=(
        replace(
            form_of(_NEIGHBOURS, ("other units on",)),
            columns=_neighbours_heat,
            missing_input=_missing_neighbour,
        ),
    ),
    compensation=no_ins_term("it belongs to the unit beside it"),
)


#: Duration of a change of the power at power-on or off, or between two dwells without a gap.
_SWITCHING_S = 1.0
#: Smallest relative change of the power in a power cycle that distinguishes a lag from a warm-up.
_MIN_CHANGE = 0.02


def _lagging_power(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Means over the dwells of the power with a first-order lag, zero while the INS is off: (n, 3, 1)."""
    whole = campaign.whole
    not_held_out = ~whole.held_out
    mean_w = _lagging_power_over(whole, np.ones_like(not_held_out), *values)
    if not_held_out.any():
        mean_w[not_held_out] = _lagging_power_over(whole, not_held_out, *values)
    return same_for_all_gyros(mean_w[campaign.in_whole, np.newaxis])


def _lagging_power_over(whole: Campaign, used: BoolArray, tau_s: float, warm_share: float) -> FloatArray:
    """Means over the dwells ``used`` (n,) only; the power is constant in each and linear in gaps."""
    start_s, end_s, on_s = whole.start_s[used], whole.end_s[used], whole.power_on_s
    power_w = driver_values("supply_w", whole)[used, 0]
    first_dwell = np.minimum(np.searchsorted(end_s, on_s, side="right"), len(end_s) - 1)
    off_s = np.minimum(np.where(first_dwell > 0, end_s[first_dwell - 1], np.inf), on_s - 2.0 * _SWITCHING_S)
    margin_s = np.minimum(0.5 * _SWITCHING_S, 0.1 * (end_s - start_s))
    edges_s = start_s + margin_s, end_s - margin_s
    times_s = np.concatenate([*edges_s, off_s + 0.5 * _SWITCHING_S, on_s - _SWITCHING_S, on_s])
    off_w = np.zeros(2 * len(on_s))
    off_w[:: len(on_s)] = warm_share * power_w[first_dwell[0]]  # of the first power-on
    time_s, order = np.unique(times_s, return_index=True)
    course_w = np.concatenate([power_w, power_w, off_w, power_w[first_dwell]])[order, np.newaxis]
    state_w = (course_w + lag(course_w, time_s, tau_s))[:, 0]
    rise_w = np.diff([state_w[np.searchsorted(time_s, each_s)] for each_s in edges_s], axis=0)[0]
    # The lagging state changes at the rate (power - state) / tau.
    return np.asarray(power_w - tau_s * rise_w / np.maximum(edges_s[1] - edges_s[0], 1e-9))


def _missing_power_step(campaign: Campaign) -> str | None:
    if missing := _POWER.missing_input(campaign):
        return missing
    power_w = driver_values("supply_w", campaign)[:, 0]
    changes_w = [np.ptp(power_w[campaign.run == run]) for run in np.unique(campaign.run)]
    is_constant = max(changes_w) < _MIN_CHANGE * np.abs(power_w).max()
    return "a change of the supply's power within a power cycle" if is_constant else None


_POWER = Law("supply_w")
SUPPLY_POWER = Effect(
    name="supply_power",
    label="supply power",
    statement="the bias follows the power of the supply or heater",
    experiment=(
        "hold temperature and position and step the supply voltage or heater power with a programmable "
        "supply: the bias follows within seconds or minutes, before the temperature of the optics does"
    ),
    compensation=no_ins_term("the INS has no term for what follows the supply power"),
    forms=(
        form_of(_POWER, ("supply power, W",), "at once"),
        Form(
            ("lagging supply power, W",),
            _lagging_power,
            (
                Parameter("tau_s", 30.0, 3600.0, fixed(120.0, 900.0)),
                Parameter("warm_at_first_power_on", 0.0, 1.0, fixed(0.0, 1.0), is_place=True),
            ),
            _missing_power_step,
            "lagging",
        ),
    ),
)


_ROTATION_AT_AZIMUTH_0 = {name: position.C_nb() for name, position in POSITIONS.items()}
_INCLINATION = Parameter("inclination_deg", -89.0, 89.0, fixed(-70.0, -30.0, 30.0, 70.0))


def _field_components(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    azimuth_rad = np.deg2rad(np.asarray(campaign.azimuth_deg))[:, np.newaxis]
    east, north = np.moveaxis(
        np.array([_ROTATION_AT_AZIMUTH_0[name] for name in campaign.position])[:, :2], 1, 0
    )
    north = np.cos(azimuth_rad) * north + np.sin(azimuth_rad) * east
    inclination_rad = np.deg2rad(values[0])
    return same_for_all_gyros(np.cos(inclination_rad) * north - np.sin(inclination_rad) * campaign.up_body)


def _missing_headings(campaign: Campaign) -> str | None:
    azimuth_deg = campaign.azimuth_deg
    if azimuth_deg is None or not np.isfinite(azimuth_deg).all():
        return "the headings of the dwells (column azimuth_deg)"
    if campaign.has_one_heading:
        return "dwells at headings other than one and its opposite"
    return needs_positions(campaign)


MAGNETIC_SENSITIVITY = Effect(
    name="magnetic_sensitivity",
    label="magnetic sensitivity",
    statement="the bias follows the Earth's magnetic field along the body axes",
    experiment=(
        "measure one position at four headings a quarter turn apart; a coil or a magnetic shield around the "
        "unit settles the vertical part, which equals a g-sensitivity at every heading"
    ),
    forms=(
        Form(
            tuple(f"magnetic field along {axis}" for axis in "xyz"),
            _field_components,
            (_INCLINATION,),
            _missing_headings,
        ),
    ),
    compensation=no_ins_term("the INS has no magnetometer"),
    contains=("g_sensitivity",),
    sensors=("gyro",),  # accelerometers sense gravity far more than any magnetic field
)
