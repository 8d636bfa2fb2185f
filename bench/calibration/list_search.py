"""The shortest list of rotations that reaches given uncertainties on a table.

A list grows by one rotation at a time, of a quarter, a half or whole turns about an axis of the table within
its limits. The best lists of each length are kept (beam search); a list is better the less it misses the
targets by. The quickest of the first that reach all of them is shortened: rotations are taken out as long as
it still does.

All lists consist of the same few movements between quarter turns of the axes. So each movement is integrated
once, and the information of a list follows by sending the state of the whitening filter through them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.calibration.information import ATTITUDE_ERROR, FORCE_SCALE, IS_FORCE_SCALE
from gyrobench.bench.calibration.rotation_list import (
    STEP_S,
    ExpectedUncertainties,
    RotationList,
    RotationSetup,
    TableRotation,
    expected_uncertainties,
    ideal_increments,
    motion,
)
from gyrobench.bench.calibration.strapdown import ATTITUDE, epoch_steps
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import Angles

#: Lists kept of each length, and the longest.
_BEAM, _MAX_ROTATIONS = 60, 36
#: Whole turns in one rotation, if the axis has the range.
_MAX_TURNS = 10
#: Length of an epoch, s; one value of the velocity at rest stands for those of each second.
_EPOCH_S = 5.0
#: Parts of the targets to search for, since the search is coarser than the expected uncertainties.
_MARGINS = (1.0, 0.97, 0.9)
_UNITS = {"deg/h": "dph", "ppm": "ppm", "arcsec": "arcsec", "ug": "ug"}
#: Parameters of a list.
_COLUMNS = [*range(COUNT), *range(ATTITUDE.start, ATTITUDE.stop)]
_SIZES = np.array([*(each.size for each in COEFFICIENTS), *[ATTITUDE_ERROR] * 3])


def parse_targets(text: str) -> FloatArray:
    """Largest uncertainties (21,), SI, from ``gyro_bias_dph=0.001,gyro_scale_factor_z_ppm=0.5``.

    Coefficients without a target are infinite. Raises DocumentError if a name or a number is wrong.
    """
    names: dict[str, list[int]] = {}
    for number, each in enumerate(COEFFICIENTS):
        unit = _UNITS[each.unit]
        for name in (f"{each.name}_{unit}", f"{each.name}_{each.axis}_{unit}"):
            names.setdefault(name, []).append(number)
    targets = np.full(COUNT, np.inf)
    for part in text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        try:
            limit = float(value)
        except ValueError:
            limit = np.nan
        if name not in names or not 0.0 < limit < np.inf:
            known = ", ".join(name for name, numbers in names.items() if len(numbers) > 1)
            raise DocumentError(
                f"--reach: '{part.strip()}' is no coefficient with an uncertainty above 0. Give NAME=NUMBER "
                f"with {known}, or one axis as in gyro_scale_factor_z_ppm"
            )
        for number in names[name]:
            targets[number] = limit / COEFFICIENTS[number].per_si
    return targets


def shortest_list(
    pattern: RotationList, targets: FloatArray, setup: RotationSetup
) -> tuple[RotationList, ExpectedUncertainties]:
    """A list of rotations that reaches the targets, and what it will know.

    ``pattern``: gives start, dwell and rate; its rotations are used, as far as needed, if nothing quicker is
    found. ``targets`` (21,): largest uncertainties, SI; infinite where there is none. Whole turns are tried
    only where ``setup`` states their uncertainty. Raises DocumentError if no list reaches the targets.
    """
    unseen = np.array(IS_FORCE_SCALE) & np.isfinite(targets)
    if unseen.any() and not setup.has_vertical:
        raise DocumentError(
            "accelerometer scale factors are not observable without increments (ins.signals.increments). "
            "Leave their targets out"
        )
    left: list[str] = []
    for margin in _MARGINS:
        search = _Search(pattern, margin * targets, setup)
        rotations, left = search.run()
        if left:
            break
        found = pattern.model_copy(
            update={
                "rotation_list": f"{pattern.rotation_list}_shortest",
                "description": "Proposed by gyrobench plan --observability --reach.",
                "rotations": rotations,
            }
        )
        expected = expected_uncertainties(found, setup)
        missed = np.isfinite(targets) & ~((expected.sigmas <= targets) & expected.is_observed)
        if not missed.any():
            return found, expected
        left = _named(missed, expected.sigmas)
    raise DocumentError(
        f"no list of up to {_MAX_ROTATIONS} rotations on this table reaches the targets: "
        f"{', '.join(left)}. Give larger uncertainties or a longer dwell_s, or --whole-turns-arcsec for "
        "scale factors"
    )


def _named(missed: BoolArray, sigmas: FloatArray) -> list[str]:
    """Coefficients that miss their targets, with their uncertainties."""
    return [
        f"{each.name} {each.axis} ({sigma * each.per_si:.3g} {each.unit})"
        for each, sigma, misses in zip(COEFFICIENTS, sigmas, missed, strict=True)
        if misses
    ]


@dataclass(frozen=True, eq=False)
class _Movement:
    """A rotation and the rest after it, from given angles, in epochs."""

    #: transition, covariance, drive: Shapes (n, 6, 6), (n, 6, 6), (n, 6, 24).
    transition: FloatArray
    covariance: FloatArray
    drive: FloatArray
    at_rest: BoolArray  #: Shape (n,).
    is_spin: bool


@dataclass(frozen=True, eq=False)
class _Partial:
    """A list so far."""

    rotations: tuple[TableRotation, ...]
    angles: Angles
    #: state, covariance, information: Shapes (9, 24), (9, 9), (24, 24). Of the whitening filter: what it does
    #: not know of psi, u and the psi before a spin, for each parameter; its covariance; white rows, squared.
    state: FloatArray
    covariance: FloatArray
    information: FloatArray


class _Search:
    def __init__(self, pattern: RotationList, targets: FloatArray, setup: RotationSetup) -> None:
        self._pattern, self._targets, self._setup = pattern, targets, setup
        self._white = float(np.mean(setup.noise.white_velocity**2)) / _EPOCH_S
        self._turn = (setup.whole_turns or 0.0) ** 2
        self._measured, self._sizes = 3 if setup.has_vertical else 2, _SIZES.copy()
        if not setup.has_vertical:
            self._sizes[np.flatnonzero(IS_FORCE_SCALE)] = FORCE_SCALE
        self._cache: dict[tuple[float, float, str, float], _Movement] = {}
        self._limits = {"outer": setup.table.outer_limits_deg, "inner": setup.table.inner_limits_deg}
        self._start = setup.table.angles(POSITIONS[pattern.start].C_nb())

    def run(self) -> tuple[list[TableRotation], list[str]]:
        """Rotations that reach the targets; or what the best list leaves too uncertain."""
        given = self._of(self._pattern.rotations)
        known = [given] if given and self._ratios([given]).max() <= 1.0 else []
        beam = [self._begun()]
        for _ in range(_MAX_ROTATIONS):
            grown = [self._extended(each, move) for each in beam for move in self._moves(each.angles)]
            if not grown:
                break
            ratios = self._ratios(grown)
            reaching = [each for each, ratio in zip(grown, ratios, strict=True) if ratio.max() <= 1.0]
            if reaching:
                shortened = [self._shortened(each) for each in (*known, min(reaching, key=self._seconds))]
                return list(min(shortened, key=self._seconds).rotations), []
            scores = np.log(np.maximum(ratios, 1.0)).sum(axis=1) + 1e-3 * np.log(ratios).sum(axis=1)
            beam, seen = [], set()
            for number in np.argsort(scores, kind="stable"):
                # Lists that differ by symmetry alone would fill the beam.
                key = (*np.mod(grown[number].angles, 360.0), round(float(scores[number]), 6))
                if key not in seen:
                    seen.add(key)
                    beam.append(grown[number])
                if len(beam) == _BEAM:
                    break
        for each in known:
            return list(self._shortened(each).rotations), []
        sigmas = np.zeros(COUNT)
        targeted = np.isfinite(self._targets)
        sigmas[targeted] = self._ratios(beam[:1])[0] * self._targets[targeted]
        return [], _named(sigmas > self._targets, sigmas)

    def _shortened(self, found: _Partial) -> _Partial:
        shorter: _Partial | None = found
        while shorter is not None:
            found, moves = shorter, shorter.rotations
            fewer = (self._of((*moves[:k], *moves[k + 1 :])) for k in range(len(moves)))
            shorter = next((each for each in fewer if each and self._ratios([each]).max() <= 1.0), None)
        return found

    def _of(self, rotations: Sequence[TableRotation]) -> _Partial | None:
        part = self._begun()
        for rotation in rotations:
            if not self._allows(part.angles, rotation):
                return None
            part = self._extended(part, rotation)
        return part

    def _seconds(self, part: _Partial) -> float:
        return sum(self._pattern.dwell_s + self._pattern.seconds(each) for each in part.rotations)

    def _moves(self, angles: Angles) -> Iterator[TableRotation]:
        axes: tuple[Literal["outer", "inner"], ...] = ("outer", "inner")
        for axis, at_deg in zip(axes, angles, strict=True):
            low, high = self._limits[axis]
            sizes = [90.0, 180.0]
            if self._setup.whole_turns is not None:
                room = min(max(high - at_deg, at_deg - low) / 360.0, _MAX_TURNS)
                sizes += [360.0 * int(room)] * (room >= 1.0)
            for angle_deg in (sign * size for size in sizes for sign in (1.0, -1.0)):
                rotation = TableRotation(axis=axis, angle_deg=angle_deg)
                if self._allows(angles, rotation):
                    yield rotation

    def _allows(self, angles: Angles, rotation: TableRotation) -> bool:
        low, high = self._limits[rotation.axis]
        return low <= _moved(angles, rotation)[rotation.axis == "inner"] <= high

    def _ratios(self, parts: Sequence[_Partial]) -> FloatArray:
        """Uncertainties over targets (n, m) of the coefficients that have one."""
        information = np.array([each.information for each in parts]) + np.eye(len(_COLUMNS))
        variances = np.diagonal(np.linalg.inv(information), axis1=1, axis2=2)
        targeted = np.isfinite(self._targets)
        ratios = (np.sqrt(variances) * self._sizes)[:, :COUNT] / self._targets
        return np.asarray(ratios[:, targeted])

    def _begun(self) -> _Partial:
        state, covariance = np.zeros((9, len(_COLUMNS))), np.zeros((9, 9))
        state[:3, COUNT:] = np.eye(3) * self._sizes[COUNT:]
        covariance[3:6, 3:6] = self._white * np.eye(3)
        begun = _Partial((), self._start, state, covariance, np.zeros((len(_COLUMNS),) * 2))
        return self._through(begun, self._movement(self._start, None), (), self._start)

    def _extended(self, part: _Partial, rotation: TableRotation) -> _Partial:
        rotations, angles = (*part.rotations, rotation), _moved(part.angles, rotation)
        return self._through(part, self._movement(part.angles, rotation), rotations, angles)

    def _through(
        self, part: _Partial, movement: _Movement, rotations: tuple[TableRotation, ...], angles: Angles
    ) -> _Partial:
        state, covariance, information = part.state.copy(), part.covariance.copy(), part.information.copy()
        _filter(
            movement.transition,
            movement.covariance,
            movement.drive,
            movement.at_rest,
            movement.is_spin and self._setup.whole_turns is not None,
            self._measured,
            self._white,
            self._turn,
            state,
            covariance,
            information,
        )
        return _Partial(rotations, angles, state, covariance, information)

    def _movement(self, angles: Angles, rotation: TableRotation | None) -> _Movement:
        outer, inner = (round(each % 360.0, 6) for each in angles)
        key = (outer, inner, rotation.axis, rotation.angle_deg) if rotation else (outer, inner, "", 0.0)
        if key not in self._cache:
            made = self._pattern.model_copy(update={"rotations": [rotation] if rotation else []})
            attitude, at_rest, spins = motion(made, self._setup.table, angles)
            rest = round(self._pattern.dwell_s / STEP_S) if rotation else 0
            attitude, at_rest = attitude[rest:], at_rest[rest:]
            angle, velocity = ideal_increments(attitude, self._setup.site)
            size = round(_EPOCH_S / STEP_S)
            ends = np.append(np.arange(size, len(angle), size), len(angle)).astype(np.int64)
            transition, covariance, drive = epoch_steps(
                angle,
                velocity,
                STEP_S,
                ends,
                attitude[0],
                self._setup.noise,
                self._setup.site.latitude,
                self._setup.site.gravity,
            )
            drive = np.ascontiguousarray(drive[:, :, _COLUMNS] * self._sizes)
            self._cache[key] = _Movement(transition, covariance, drive, at_rest[ends], bool(spins))
        return self._cache[key]


def _moved(angles: Angles, rotation: TableRotation) -> Angles:
    outer, inner = angles
    is_outer = rotation.axis == "outer"
    return (outer + rotation.angle_deg, inner) if is_outer else (outer, inner + rotation.angle_deg)


@compiled
def _filter(
    transition: FloatArray, covariance: FloatArray, drive: FloatArray, at_rest: BoolArray, is_spin: bool,
    measured: int, white: float, turn: float, Z: FloatArray, P: FloatArray, information: FloatArray,
) -> None:  # fmt: skip
    if is_spin:
        for i in range(3):
            for a in range(Z.shape[1]):
                Z[6 + i, a] = Z[i, a]
            for a in range(9):
                P[6 + i, a] = P[i, a]
        for a in range(9):
            for i in range(3):
                P[a, 6 + i] = P[a, i]
    is_turned = not is_spin
    for epoch in range(len(transition)):
        _moved_on(transition[epoch], Z)
        _moved_on(transition[epoch], P)
        _moved_on(transition[epoch], P.T)
        for i in range(6):
            for a in range(Z.shape[1]):
                Z[i, a] += drive[epoch, i, a]
            for a in range(6):
                P[i, a] += covariance[epoch, i, a]
        if not at_rest[epoch]:
            continue
        for i in range(measured):
            _take(Z[3 + i].copy(), P[3 + i].copy(), P[3 + i, 3 + i] + white, Z, P, information)
        if not is_turned:
            is_turned = True
            for i in range(3):
                spread = P[:, i] - P[:, 6 + i]
                _take(Z[i] - Z[6 + i], spread, spread[i] - spread[6 + i] + turn, Z, P, information)


@compiled
def _moved_on(transition: FloatArray, rows: FloatArray) -> None:
    """Multiply the first six rows by a transition, in place."""
    moved = np.empty(6)
    for a in range(rows.shape[1]):
        for i in range(6):
            moved[i] = 0.0
            for j in range(6):
                moved[i] += transition[i, j] * rows[j, a]
        for i in range(6):
            rows[i, a] = moved[i]


@compiled
def _take(
    row: FloatArray,
    spread: FloatArray,
    variance: float,
    Z: FloatArray,
    P: FloatArray,
    information: FloatArray,
) -> None:
    """Take in a measurement: its row, its covariance with the state, its variance."""
    for i in range(9):
        gain = spread[i] / variance
        for a in range(len(row)):
            Z[i, a] -= gain * row[a]
        for j in range(9):
            P[i, j] -= gain * spread[j]
    for a in range(len(row)):
        for b in range(len(row)):
            information[a, b] += row[a] * row[b] / variance
