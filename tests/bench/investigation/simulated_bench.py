"""A bench behind a command, for `gyrobench investigate TABLE --bench`: a unit with an undeclared effect.

::

    python simulated_bench.py UNIT.json PLAN.json NEW.csv

UNIT.json holds the seed, the effects with their sizes, the kinds of step that the bench refuses, and all
steps so far; measured steps are added to it. Everything is simulated again from the start, minute by minute,
by a thermal network with convection and radiation: a unit behaves the same however its blocks are cut.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, write_dwells

STEP_S = 60.0
STEP_H = STEP_S / 3600.0
UP = {
    "z_up": (0, 0, 1), "z_down": (0, 0, -1), "y_up": (0, 1, 0),
    "y_down": (0, -1, 0), "x_up": (1, 0, 0), "x_down": (-1, 0, 0),
}  # fmt: skip
SIGMA_DPH = 0.0012
REFUSED = 3


def main(unit_file, plan_file, table):
    unit = json.loads(Path(unit_file).read_text())
    plan = json.loads(Path(plan_file).read_text())
    for step in plan["steps"]:
        if step["kind"] in unit.get("refuses", []) or (
            "factor" in unit.get("refuses", []) and step.get("factor", 1.0) != 1.0
        ):
            print(f"this bench can't do the step {step['kind']}", file=sys.stderr)
            return REFUSED
    steps = unit["steps"] + [step for step in plan["steps"] if step not in unit["steps"]]
    new = {step["dwell"] for step in plan["steps"] if step["kind"] == "dwell"}
    write_dwells(Path(table), [row for row in simulate(unit | {"steps": steps}) if row.dwell in new])
    Path(unit_file).write_text(json.dumps(unit | {"steps": steps}))
    return 0


def first_campaign(temperatures_c, ramp_c_per_h=60.0, soak_h=2.0, cycles=2, dwell_s=1200.0):
    """Steps of a campaign in six positions at each temperature, in one power-on."""
    steps, now_s, dwell, at_c = [], 0.0, 0, 22.0

    def add(kind, duration_s, **keys):
        nonlocal now_s
        steps.append({"kind": kind, "start_s": now_s, "end_s": now_s + duration_s} | keys)
        now_s += duration_s

    add("power", 60.0, on=True, factor=1.0)
    for cycle in range(1, cycles + 1):
        for to_c in temperatures_c if cycle % 2 else temperatures_c[::-1]:
            if to_c != at_c:
                add("chamber", abs(to_c - at_c) / ramp_c_per_h * 3600.0, to_c=to_c, ramp_c_per_h=ramp_c_per_h)
            at_c = to_c
            add("soak", soak_h * 3600.0)
            for position in UP:
                dwell += 1
                add("dwell", dwell_s, dwell=dwell, cycle=cycle, run="B-1", position=position, azimuth_deg=0.0)
    return steps


def simulate(unit):
    """All dwells of the steps."""
    steps, draw = unit["steps"], np.random.default_rng([unit["seed"], 1])
    count = round(steps[-1]["end_s"] / STEP_S)
    set_c, power, since_s, up = np.full(count, 22.0), np.zeros(count), np.zeros(count), np.zeros((count, 3))
    up[:, 2] = 1.0
    for step in steps:
        part = slice(round(step["start_s"] / STEP_S), round(step["end_s"] / STEP_S))
        later = slice(part.start, None)
        if step["kind"] == "power":
            if step["on"] and power[part.start - 1 if part.start else 0] == 0.0:
                since_s[later] = STEP_S * np.arange(len(since_s[later]))
            power[later] = step.get("factor", 1.0) if step["on"] else 0.0
        elif step["kind"] == "chamber":
            set_c[part] = np.linspace(set_c[part.start], step["to_c"], part.stop - part.start)
            set_c[part.stop :] = step["to_c"]
        elif step["kind"] == "dwell":
            up[later] = UP[step["position"]]
    air_c, case_c, optics_c, board_c = temperatures(draw, set_c, power, up)
    bias_dph = declared(draw, optics_c)
    for place, (kind, size_dph) in enumerate(sorted(unit["effects"].items())):
        gains = np.random.default_rng([unit["seed"], 2, place]).choice([-1.0, 1.0], 3) * np.array(
            [1.0, 0.8, 0.5]
        )
        terms = EFFECTS[kind](optics_c, board_c, up, since_s)
        bias_dph = bias_dph + size_dph * gains * terms
    dwells = [step for step in steps if step["kind"] == "dwell"]
    return [row_of(unit, step, bias_dph, air_c, set_c, case_c, optics_c, board_c, since_s) for step in dwells]


def row_of(unit, step, bias_dph, air_c, set_c, case_c, optics_c, board_c, since_s):
    part = slice(round(step["start_s"] / STEP_S), round(step["end_s"] / STEP_S))
    draw = np.random.default_rng([unit["seed"], 3, step["dwell"]])
    length_h = (step["end_s"] - step["start_s"]) / 3600.0
    sigma_dph = SIGMA_DPH * math.sqrt(1.0 / 3.0 / length_h)
    of_run = np.random.default_rng([unit["seed"], 4, int(step["run"].rsplit("-", 1)[1])]).normal(
        0.0, 0.003, 3
    )
    rate = (optics_c[part][-1] - optics_c[part][0]) / (length_h - STEP_H)
    noise_c = 0.01 * draw.standard_normal((3, 3))
    return DwellRow(
        unit=unit["unit"],
        run=step["run"],
        dwell=step["dwell"],
        cycle=step["cycle"],
        position=step["position"],
        start_s=step["start_s"],
        end_s=step["end_s"],
        since_power_on_s=float(since_s[part.start]),
        gyro_c=tuple((optics_c[part].mean(axis=0) + noise_c[0]).tolist()),
        gyro_rate_c_per_h=tuple((rate + 2.0 * noise_c[1]).tolist()),
        bias_dph=tuple((bias_dph[part].mean(axis=0) + of_run + sigma_dph * draw.standard_normal(3)).tolist()),
        sigma_dph=(sigma_dph,) * 3,
        azimuth_deg=step["azimuth_deg"],
        chamber_set_c=float(set_c[part].mean()),
        chamber_c=float(air_c[part].mean()),
        case_c=float(case_c[part].mean()),
        board_c=tuple((board_c[part].mean(axis=0) + noise_c[2]).tolist()),
    )


def temperatures(draw, set_c, power, up):
    """Air, case, optics (m, 3) and electronics (m, 3)."""
    out = [np.empty(len(set_c)), np.empty(len(set_c)), np.empty((len(set_c), 3)), np.empty((len(set_c), 3))]
    unit, along = draw.uniform(0.85, 1.2, 6), draw.normal(0.0, 0.08, (3, 3))
    air, case, optics, board = 22.0, 22.0, np.full(3, 22.0), np.full(3, 22.0)
    spread = draw.uniform(0.9, 1.1, 3)
    for now, goal_c in enumerate(set_c):
        air += STEP_H * 18.0 * (goal_c - air)
        over = board - optics
        flow = (
            over
            * np.abs(over / 8.0 + 1e-9) ** 0.2
            * (1.0 + along @ up[now] / (1.0 + np.exp((optics - 50.0) / 5.0)))
        )
        radiated = ((air + 273.15) ** 4 - (case + 273.15) ** 4) / (4.0 * 295.0**3)
        case += STEP_H * (1.5 * unit[0] * (air - case) + 0.3 * radiated + 0.3 * np.sum(board - case) / 3.0)
        optics = optics + STEP_H * (0.5 * unit[1] * spread * flow + 2.0 * unit[2] * (case - optics))
        board = board + STEP_H * (18.0 * unit[3] * power[now] - 0.8 * flow + 1.4 * unit[4] * (case - board))
        out[0][now], out[1][now], out[2][now], out[3][now] = air, case, optics, board
    return out


def declared(draw, optics_c):
    powers = np.stack([(optics_c / 50.0) ** degree for degree in (1, 2, 3)], axis=2)
    return np.einsum("mgk,gk->mg", powers, draw.normal(0.0, 1.0, (3, 3)) * [0.02, 0.012, 0.006])


def slopes(values):
    return np.gradient(values, axis=0) / STEP_H


def lagged(values, tau_h):
    found, keep = values.copy(), math.exp(-STEP_H / tau_h)
    for now in range(1, len(values)):
        found[now] = keep * found[now - 1] + (1.0 - keep) * values[now]
    return found


def of_all(values):
    return values[:, np.newaxis] * np.ones(3)


def attitude_thermal(optics, board, up, since_s):
    flow = np.array([[0.2, 1.0, 0.3], [1.0, 0.1, 0.4], [0.3, 0.5, 1.0]])
    return (board - optics) / 10.0 * (up @ flow) / (1.0 + np.exp((optics - 50.0) / 5.0))


def g_sensitivity(optics, board, up, since_s):
    return up @ np.array([[1.0, 0.3, 0.1], [0.2, 0.8, 0.3], [0.1, 0.3, 1.0]])


def resonance(centre_c):
    """On no list."""
    return lambda optics, board, up, since_s: 2.0 / (1.0 + ((board - centre_c) / 5.0) ** 2)


#: Undeclared effects, each of about 1 in a usual campaign.
EFFECTS = {
    "temperature_rate": lambda optics, board, up, since_s: slopes(optics) / 15.0,
    "thermal_gradient": lambda optics, board, up, since_s: (board - optics - 9.0) / 2.0,
    "attitude_thermal": attitude_thermal,
    "g_sensitivity": g_sensitivity,
    "resonance": resonance(42.0),
    "moved_resonance": resonance(25.0),
    "warm_up": lambda optics, board, up, since_s: of_all(2.0 * np.exp(-since_s / 3600.0 / 9.0)),
    "time_drift": lambda optics, board, up, since_s: of_all(STEP_H / 40.0 * np.arange(len(since_s))),
    "thermal_lag": lambda optics, board, up, since_s: (optics - lagged(optics, 0.8)) / 8.0,
}

if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
