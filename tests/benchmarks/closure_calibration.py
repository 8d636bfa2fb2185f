"""What the search for effects states about many simulated units, beside what is true of them.

Results are kept, one JSON line a unit, so that making them can be interrupted.
"""

import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import close_loop, composed
from tests.benchmarks.closure_laws import COMPOSED, ON_NO_LIST, ON_THE_LIST
from tests.benchmarks.closure_units import NOISES, make_unit, shape_known_error_dph

#: Of twenty units in a row.
GROUPS = (
    *["clean"] * 3, *["clean, hard noise"] * 2, *["one"] * 7, *["two"] * 3, "three",
    *["unknown, 0.3 to 1 sigma"] * 2, *["unknown, 1 to 10 sigma"] * 2,
)  # fmt: skip
#: Units from this number on have a law of the grammar of effects that is on no list.
FIRST_COMPOSED, LAW = 1_000_000, "unknown, composed law"
LOOKS = 10
#: Heat flows; the second has the first as one of its terms.
CONTAINED = {"thermal_gradient", "attitude_thermal"}
_CAMPAIGNS = {
    "ageing": {"design": "power cycles", "cycles": 5},
    "magnetic_sensitivity": {"design": "headings"},
}
#: Of what 95 % intervals are counted; predictions are also those of a model that is not exactly true.
INEXACT = "predictions with other laws, or with effects missed"
INTERVALS = ("sizes", "parameters", "predictions", INEXACT)
#: Standard deviations that hold 95 %.
WITHIN_95 = 1.959964


def drawn(seed):
    """Group of a unit, and how it is made."""
    draw = np.random.default_rng([seed, 19])
    if seed >= FIRST_COMPOSED:
        kind, size = [*COMPOSED][seed % len(COMPOSED)], float(draw.uniform(3.0, 10.0))
        return LAW, {"effects": [kind], "sizes": [size], "noise": NOISES[0], "candidates_own": True}
    group = GROUPS[seed % len(GROUPS)]
    count = {"one": 1, "two": 2, "three": 3}.get(group, 1 if group.startswith("unknown") else 0)
    names = [*(ON_NO_LIST if group.startswith("unknown") else ON_THE_LIST)]
    effects = draw.choice(names, count, replace=False)
    while set(effects.tolist()) >= CONTAINED:
        effects = draw.choice(names, count, replace=False)
    low, high = {"unknown, 0.3 to 1 sigma": (0.3, 1.0), "unknown, 1 to 10 sigma": (1.0, 10.0)}.get(
        group, (0.3, 20.0)
    )
    sizes = np.exp(draw.uniform(np.log(low), np.log(high), count))
    noise = str(draw.choice(NOISES[1:])) if "hard" in group or draw.random() < 0.12 else NOISES[0]
    if group == "clean":
        noise = NOISES[0]
    options = {"effects": effects.tolist(), "sizes": sizes.tolist(), "noise": noise}
    # Most units that need it have a campaign that can show the effect.
    for effect, needed in _CAMPAIGNS.items():
        if effect in options["effects"] and draw.random() < 0.8:
            options |= needed
    return group, options | {"candidates_own": bool(draw.random() < 0.4)}


def examined(seed):
    """One unit: what it is, what was stated, and what of that holds."""
    group, options = drawn(seed)
    rows, truth = make_unit(seed, **options)
    begin_s = time.process_time()
    closure = close_loop(campaign_of(rows))
    took_s = time.process_time() - begin_s
    found = sorted(each.effect.name for each in closure.effects)
    result = {
        "seed": seed,
        "group": group,
        **options,
        "design": truth.design,
        "has_own_laws": _has_own_laws(closure, truth),
        "verdict": closure.verdict,
        "found": found,
        "tied": {each.effect.name: list(each.tied_with) for each in closure.effects},
        "noise_scale": closure.noise_scale,
        # The largest thing that the table may hide, in the units of the sizes.
        "hidden": max(filter(math.isfinite, closure.detectable_dph.values()), default=0.0)
        / closure.noise_dph
        * closure.noise_scale,
        "true_noise_scale": float(np.sqrt(np.mean((truth.sigma_dph / closure.campaign.sigma_dph) ** 2))),
        "probabilities": _probabilities(closure),
        "error_before_dph": _error_dph(closure, closure.declared, truth),
        "error_after_dph": _error_dph(closure, closure.model, truth),
        "error_shape_known_dph": shape_known_error_dph(rows, truth),
        "inside": _inside(closure, truth),
        "took_s": took_s,
    }
    if group == LAW:
        laws = composed(closure).composed
        result["drivers"] = dict([*laws.driver_probabilities.items()][:3]) if laws else {}
    if group.startswith("unknown") and closure.verdict == "explained":
        longer = close_loop(campaign_of(make_unit(seed, **options, looks=LOOKS)[0]))
        result["longer"] = [longer.verdict, sorted(each.effect.name for each in longer.effects)]
    return result


def _has_own_laws(closure, truth):
    """Whether each effect of the unit is exactly one that was fitted; without boards a heat flow is not."""
    fitted = {each.effect.name for each in closure.evidence if not each.missing_input}
    own = all(each.sizes_dph is not None and each.kind in fitted for each in truth.parts)
    has_boards = bool(np.isfinite(closure.campaign.whole.board_c).all())
    return own and (has_boards or not truth.kinds & CONTAINED)


def _probabilities(closure):
    posterior = closure.posterior
    return {
        "nothing": posterior.no_effect_probability,
        "not_on_list": posterior.unlisted_probability,
        "effects": posterior.effect_probabilities,
        "found": closure.probability,
        "hypotheses": [
            [sorted(each.names), each.has_remainder, each.probability] for each in posterior.hypotheses[:8]
        ],
    }


def _error_dph(closure, model, truth):
    """Held-out rms against the true bias; the constant of a power cycle that was not searched is removed."""
    errors, run, searched = model.bias_dph - truth.bias_dph, closure.campaign.run, closure.searched
    for unseen in set(run[~searched].tolist()) - set(run[searched].tolist()):
        errors[run == unseen] -= errors[run == unseen].mean(axis=0)
    return float(np.sqrt(np.mean(errors[~searched] ** 2)))


def _inside(closure, truth):
    """Of 95 % intervals of sizes, parameters and predictions: how many hold the true value, and how many are.

    Sizes and parameters of effects with the candidate's own law, where exactly the right effects are found.
    """
    inside = {what: [0, 0] for what in INTERVALS}

    def count(what, errors, sigmas):
        inside[what][0] += int(np.sum(np.abs(errors) <= WITHIN_95 * sigmas))
        inside[what][1] += int(np.size(errors))

    found = {each.effect.name: each for each in closure.effects}
    is_right = found.keys() == truth.kinds
    for part in truth.parts if is_right else ():
        one = found[part.kind]
        if part.sizes_dph is None or part.sizes_dph.shape != one.sizes_dph.shape:
            continue
        kept = one.candidate.kept
        count("sizes", (one.sizes_dph - part.sizes_dph)[kept], one.sizes_sigma_dph[kept])
        held = [
            low <= value <= high for value, (low, high) in zip(part.values, one.values_range, strict=True)
        ]
        inside["parameters"][0] += int(sum(held))
        inside["parameters"][1] += len(held)
    if closure.verdict != "unexplained":
        campaign, searched = closure.campaign, closure.searched
        seen = ~searched & np.isin(campaign.run, campaign.run[searched])
        errors_dph, sigma_dph = closure.model.bias_dph - truth.bias_dph, closure.prediction_sigma_dph
        is_own = is_right and _has_own_laws(closure, truth)
        count("predictions" if is_own else INEXACT, errors_dph[seen], sigma_dph[seen])
    return inside


def examine(seeds, results, processes=2):
    """Examine units that have no result yet, in several processes; returns all results asked for."""
    results.parent.mkdir(parents=True, exist_ok=True)
    known = read(results)
    left = [seed for seed in seeds if seed not in known]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.benchmarks.closure_calibration", str(results)]
    workers = [
        subprocess.Popen(
            [*command, *map(str, left[place::processes])], cwd=Path(__file__).parents[2], env=environment
        )
        for place in range(processes)
        if left[place::processes]
    ]
    try:
        failed = [each.args for each in workers if each.wait()]
    finally:
        for each in workers:
            each.terminate()
    if failed:
        raise RuntimeError(f"{len(failed)} processes failed")
    known = read(results)
    return [known[seed] for seed in seeds]


def read(results):
    """Results by seed; a line that was cut short is left out."""
    lines = results.read_text().splitlines() if results.exists() else []
    return {each["seed"]: each for each in map(_parsed, lines) if each}


def _parsed(line):
    try:
        return json.loads(line)
    except json.JSONDecodeError:
        return None


if __name__ == "__main__":
    for unit in map(int, sys.argv[2:]):
        line = json.dumps(examined(unit))
        with Path(sys.argv[1]).open("a") as file:
            file.write(f"{line}\n")
