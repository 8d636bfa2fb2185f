"""Are the probabilities that the search states frequencies? Simulated units of other physics than its own.

As a script it writes the tables of docs/calibration_of_probabilities.md and its figure; an interrupted one
continues where it was::

    python -m tests.benchmarks.bench_calibration --results FILE --page docs/calibration_of_probabilities.md
"""

import argparse
import itertools
import statistics
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from tests.benchmarks.closure_calibration import FIRST_COMPOSED, GROUPS, INTERVALS, LAW, LOOKS, examine

STATED = 0.99
VERDICTS = ("clean", "explained", "ambiguous", "unexplained")
BINS = np.array([0.0, 0.01, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 1.0 + 1e-12])
SIZES = (0.3, 1.0, 3.0, 20.0)
KNOWN = ("one", "two", "three")


def is_right(one):
    """Whether exactly the effects of the unit are named; of one without, whether it is called clean."""
    return set(one["found"]) == set(one["effects"]) and (bool(one["effects"]) or one["verdict"] == "clean")


def is_tied(one):
    """Whether each effect of the unit is named or tied with one that is."""
    named = set(one["found"]).union(*one["tied"].values())
    return len(one["found"]) == len(one["effects"]) and set(one["effects"]) <= named


def is_unknown(one):
    return one["group"].startswith("unknown")


def has_remainder(one):
    """Whether something is in the unit that no candidate describes exactly."""
    return is_unknown(one) or not one["has_own_laws"]


def missed(one):
    """Sizes of the effects that are in the unit and not named."""
    named = set(one["found"])
    pairs = zip(one["effects"], one["sizes"], strict=True)
    return [size for effect, size in pairs if effect not in named]


def stated(one, hidden=True):
    """Probability of what a verdict states, and whether it is true; None where nothing is stated.

    ``hidden``: an effect may be missed that is smaller than what the search states as detectable.
    """
    known = one["probabilities"]
    if one["verdict"] == "ambiguous":
        return None
    if one["verdict"] == "unexplained":
        return known["not_on_list"], has_remainder(one)
    is_complete = max(missed(one), default=0.0) <= (one["hidden"] if hidden else 0.0)
    return known["found"], is_complete and set(one["found"]) <= set(one["effects"])


def statements(results, hidden=True):
    """Verdicts with at least the probability of a finding: how many are true, and how many are."""
    made = [each for one in results if (each := stated(one, hidden)) and each[0] >= STATED]
    return sum(true for _, true in made), len(made)


def interval(right, count):
    """95 % interval of a frequency (Wilson)."""
    if not count:
        return 0.0, 1.0
    found = binomtest(right, count).proportion_ci(method="wilson")
    return found.low, found.high


def share(right, count):
    low, high = interval(right, count)
    return f"{right} of {count} ({100 * low:.1f} to {100 * high:.1f} %)" if count else "none"


def in_group(results, *groups):
    return [each for each in results if each["group"] in groups]


def names_effect(one):
    return one["verdict"] in ("explained", "ambiguous")


def is_explained(one):
    return one["verdict"] == "explained"


def is_unexplained(one):
    return one["verdict"] == "unexplained"


def is_refuted(one):
    """Whether the unit is `explained`, and with more data not, or by other effects."""
    if not is_explained(one):
        return False
    verdict, found = one["longer"]
    return verdict not in ("explained", "ambiguous") or found != one["found"]


def median_ratio(results):
    """Median held-out error over that of the fit that knows the shape, where the right effects are named."""
    right = [each for each in in_group(results, *KNOWN) if is_right(each)]
    if not right:
        return "none"
    return (
        f"{statistics.median(each['error_after_dph'] / each['error_shape_known_dph'] for each in right):.3f}"
    )


def figures(results):
    """Rows of the table: what, and the figure."""
    known = in_group(results, *KNOWN)
    clean, hard, weak, strong = (in_group(results, GROUPS[place]) for place in (0, 3, 16, 18))

    def counted(of, condition):
        return share(sum(map(condition, of)), len(of))

    rows = {
        "one to three effects of the list, 0.3 to 20 sigma: exactly these named": counted(known, is_right),
        "... or each named or tied": counted(known, lambda one: is_right(one) or is_tied(one)),
        "... `explained`, and wrong": counted(known, lambda one: is_explained(one) and not is_right(one)),
        "held-out error over the fit that knows the shape, median": median_ratio(results),
        f"verdicts with P >= {STATED}: true, and nothing missed that the search states as detectable": share(
            *statements(results)
        ),
        "... and nothing missed at all": share(*statements(results, hidden=False)),
        "clean, an effect named": counted(clean, names_effect),
        "clean, sigma understated or outliers: `unexplained`": counted(hard, is_unexplained),
        "... an effect named": counted(hard, names_effect),
        "... noise within 10 % of the true one, of those understated": share(*_noise_named(hard)),
        "on no list, 0.3 to 1 sigma: `explained`": counted(weak, is_explained),
        f"... refuted by {LOOKS} times the data": counted(weak, is_refuted),
        "on no list, 1 to 10 sigma: `explained`": counted(strong, is_explained),
    }
    rows |= _composed_laws(in_group(results, LAW))
    for what in INTERVALS:
        inside, count = (sum(each["inside"][what][place] for each in results) for place in (0, 1))
        rows[f"95 % intervals of {what} that hold"] = (
            f"{100 * inside / count:.1f} % of {count}" if count else "none"
        )
    rows["processor time of one search, median"] = (
        f"{statistics.median(each['took_s'] for each in results):.2f} s"
    )
    return rows


def _composed_laws(units):
    def first(one):
        return next(iter(one["drivers"]), "") == one["effects"][0].removeprefix("composed, ")

    return {
        "composed law, 3 to 10 sigma: right driver first": share(sum(map(first, units)), len(units)),
        "... `explained` by effects of the list": share(sum(map(is_explained, units)), len(units)),
    }


def _noise_named(hard):
    understated = [each for each in hard if "understated" in each["noise"]]
    named = [abs(each["noise_scale"] / each["true_noise_scale"] - 1.0) < 0.1 for each in understated]
    return sum(named), len(named)


def confusion(results):
    """Verdicts by what is in the unit."""
    lines = ["| in the unit | right | " + " | ".join(VERDICTS) + " |", "|---" * (len(VERDICTS) + 2) + "|"]
    for group in dict.fromkeys((*GROUPS, LAW)):
        for low, high in itertools.pairwise(SIZES) if group == "one" else [(0.0, np.inf)]:
            mine = [
                each for each in in_group(results, group) if low <= max(each["sizes"], default=1.0) < high
            ]
            unknown = group.startswith("unknown")
            right = sum(is_unexplained(each) if unknown else is_right(each) for each in mine)
            counts = [sum(each["verdict"] == verdict for each in mine) for verdict in VERDICTS]
            label = f"{group} effect, {low:g} to {high:g} sigma" if group == "one" else group
            lines.append(f"| {label} | {right} of {len(mine)} | " + " | ".join(map(str, counts)) + " |")
    return "\n".join(lines)


def stated_and_true(results):
    """Series of the reliability diagram: probabilities, and whether what they are of is true."""
    series = {"each effect": [], "nothing": [], "not on the list": [], "best set of effects": []}
    for one in results:
        known = one["probabilities"]
        series["each effect"] += [(p, name in one["effects"]) for name, p in known["effects"].items()]
        series["nothing"].append((known["nothing"], not one["effects"]))
        if is_unknown(one) or one["has_own_laws"] or max(one["sizes"], default=0.0) < 1.0:
            series["not on the list"].append((known["not_on_list"], is_unknown(one)))
        names, rest, probability = known["hypotheses"][0]
        true = has_remainder(one) if rest else set(names) == set(one["effects"])
        series["best set of effects"].append((probability, true))
    return series


def reliability(pairs):
    """By bin of the probability stated: mean of it, number, and number true."""
    stated_p, true = np.array([each[0] for each in pairs]), np.array([each[1] for each in pairs])
    place = np.digitize(stated_p, BINS) - 1
    return [
        (float(stated_p[place == each].mean()), int(np.sum(place == each)), int(true[place == each].sum()))
        for each in range(len(BINS) - 1)
        if np.any(place == each)
    ]


def reliability_table(results):
    lines = ["| probability of | stated | true |", "|---|---|---|"]
    for name, pairs in stated_and_true(results).items():
        for mean, count, true in reliability(pairs) if pairs else ():
            lines.append(f"| {name} | {mean:.3f} | {share(true, count)} |")
    return "\n".join(lines)


def draw_reliability(results, path):
    """Probability stated against frequency true, with 95 % binomial intervals."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.2), layout="constrained")
    series = stated_and_true(results)
    for axes, (name, pairs) in zip(figure.subplots(1, len(series), sharey=True), series.items(), strict=True):
        axes.plot([0, 1], [0, 1], color="0.7", lw=0.8)
        for mean, count, true in reliability(pairs):
            low, high = interval(true, count)
            axes.plot([mean, mean], [low, high], color="tab:blue", lw=1.2)
            axes.plot(mean, true / count, "o", color="tab:blue", ms=3.5)
            axes.annotate(
                str(count), (mean, high), (0, 2), textcoords="offset points", ha="center", fontsize=6
            )
        axes.set(title=name, xlabel="probability stated", xlim=(-0.03, 1.03), ylim=(-0.03, 1.08))
        axes.set_aspect("equal")
    figure.axes[0].set_ylabel("frequency true")
    figure.savefig(path, dpi=130)


def markdown(results):
    rows = [f"| {name} | {value} |" for name, value in figures(results).items()]
    table = "\n".join(["| | |", "|---|---|", *rows])
    return "\n\n".join([table, confusion(results), reliability_table(results)])


def units(count):
    """Numbers of units, one in twenty with a composed law."""
    composed = max(count // 20, 7)
    return [*range(count - composed), *range(FIRST_COMPOSED, FIRST_COMPOSED + composed)]


def test_probabilities_of_causes_are_frequencies(tmp_path):
    results = examine(units(60), tmp_path / "results.jsonl")
    print(f"\n{markdown(results)}")
    true, count = statements(results)
    assert count - true <= 1
    assert not any(map(names_effect, in_group(results, "clean")))
    assert sum(map(is_explained, in_group(results, GROUPS[16]))) <= 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--results", type=Path, required=True)
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    found = examine(units(arguments.units), arguments.results)
    text = markdown(found)
    print(text)
    if arguments.page:
        lines = arguments.page.read_text().split("<!-- table -->")
        arguments.page.write_text(f"{lines[0]}<!-- table -->\n{text}\n<!-- table -->{lines[2]}")
        draw_reliability(found, arguments.page.parent / "images" / "reliability_of_probabilities.png")
