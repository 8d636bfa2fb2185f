"""Searches the shortest list of rotations that reaches given uncertainties on a table.

Lists are extended by one rotation at a time, of a quarter, a half or whole turns about an axis of the table
within its limits. The best lists of each length are kept (beam search), ranked by how closely they reach the
targets. As soon as lists reach all targets, the quickest of them is shortened: rotations are removed as long
as the list still reaches the targets.

All lists consist of the same few movements between quarter turns of the axes. So each movement is integrated
once, and the information of a list is computed by propagating the state of the whitening filter through its
movements.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.calibration.information import (
    ATTITUDE_ERROR,
    FORCE_SCALE,
    IS_FORCE_SCALE,
    USUAL_QUADRATIC,
)
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
from gyrobench.bench.calibration.strapdown import ATTITUDE, QUADRATIC
from gyrobench.bench.calibration.whitening import begin_turn, epoch_steps, propagate
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import Angles

#: Number of lists kept of each length, and the largest length.
_BEAM, _MAX_ROTATIONS = 60, 36
#: Most whole turns in one rotation, if the range of the axis allows it.
_MAX_TURNS = 10
#: Length of an epoch, s; one value of the velocity at rest replaces the values of each second.
_EPOCH_S = 5.0
#: Factors on the targets in successive searches, since the search is coarser than the final prediction.
_MARGINS = (1.0, 0.97, 0.9)
_UNITS = {"deg/h": "dph", "ppm": "ppm", "arcsec": "arcsec", "ug": "ug"}
#: Columns of the parameters of a list, and their sizes.
_COLUMNS = [*range(COUNT), *range(QUADRATIC.start, QUADRATIC.stop), *range(ATTITUDE.start, ATTITUDE.stop)]
_SIZES = np.array([*(each.size for each in COEFFICIENTS), *[USUAL_QUADRATIC] * 3, *[ATTITUDE_ERROR] * 3])


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
            valid_names = ", ".join(name for name, numbers in names.items() if len(numbers) > 1)
            raise DocumentError(
                f"--reach: '{part.strip()}' is no coefficient with an uncertainty above 0. Give NAME=NUMBER "
                f"with {valid_names}, or one axis as in gyro_scale_factor_z_ppm"
            )
        for number in names[name]:
            targets[number] = limit / COEFFICIENTS[number].per_si
    return targets


def shortest_list(
    pattern: RotationList, targets: FloatArray, setup: RotationSetup
) -> tuple[RotationList, ExpectedUncertainties]:
    """Shortest list of rotations found that reaches the targets, and its expected uncertainties.

    ``pattern``: gives start, dwell and rate; its rotations are used, as far as needed, if no quicker list is
    found. ``targets`` (21,): largest uncertainties, SI; infinite for coefficients without a target. Whole
    turns are tried only if ``setup`` states their uncertainty. Raises DocumentError if no list reaches the
    targets.
    """
    unobservable = np.array(IS_FORCE_SCALE) & np.isfinite(targets)
    if unobservable.any() and not setup.has_vertical:
        raise DocumentError(
            "accelerometer scale factors are not observable without increments (ins.signals.increments). "
            "Leave their targets out"
        )
    proposals: list[tuple[RotationList, ExpectedUncertainties]] = []

    def missed_by(rotations: list[TableRotation]) -> list[str]:
        """Targets that a list misses, as texts; a list that reaches all becomes a proposal."""
        changes = {
            "rotation_list": f"{pattern.rotation_list}_shortest",
            "description": "Proposed by gyrobench plan --observability --reach.",
            "rotations": rotations,
        }
        candidate = pattern.model_copy(update=changes)
        expected = expected_uncertainties(candidate, setup)
        missed = np.isfinite(targets) & ~((expected.sigmas <= targets) & expected.is_observed)
        if not missed.any():
            proposals.append((candidate, expected))
        return _missed_texts(missed, expected.sigmas)

    if _Search(pattern, targets, setup).has_possible_pattern:
        missed_by(pattern.rotations)
    missed_texts: list[str] = []
    for margin in _MARGINS:
        rotations, missed_texts = _Search(pattern, margin * targets, setup).run()
        if missed_texts or not (missed_texts := missed_by(rotations)):
            break
    if proposals:
        return min(proposals, key=lambda each: each[0].duration_s)
    raise DocumentError(
        f"no list of up to {_MAX_ROTATIONS} rotations on this table reaches the targets: "
        f"{', '.join(missed_texts)}. Give larger uncertainties or a longer dwell_s, or --whole-turns-arcsec "
        "for scale factors"
    )


def _missed_texts(missed: BoolArray, sigmas: FloatArray) -> list[str]:
    """Texts with the coefficients that miss their targets and their uncertainties."""
    return [
        f"{each.name} {each.axis} ({sigma * each.per_si:.3g} {each.unit})"
        for each, sigma, misses in zip(COEFFICIENTS, sigmas, missed, strict=True)
        if misses
    ]


@dataclass(frozen=True, eq=False)
class _Movement:
    """A rotation and the rest after it, from given angles, in epochs."""

    #: transition, covariance, drive: Shapes (n, 6, 6), (n, 6, 6), (n, 6, 27).
    transition: FloatArray
    covariance: FloatArray
    drive: FloatArray
    at_rest: BoolArray  #: Shape (n,).
    is_spin: bool


@dataclass(frozen=True, eq=False)
class _PartialList:
    """A list of rotations under construction, with the state of its whitening filter."""

    rotations: tuple[TableRotation, ...]
    angles: Angles
    #: state, covariance, information: Shapes (9, 27), (9, 9), (27, 27). For each parameter, the part of psi,
    #: u and the psi before a spin that the filter does not estimate; its covariance; information of the rows.
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

    @property
    def has_possible_pattern(self) -> bool:
        """Whether the table can perform the rotations of the pattern."""
        return self._partial_list(self._pattern.rotations) is not None

    def run(self) -> tuple[list[TableRotation], list[str]]:
        """Rotations that reach the targets; otherwise texts with the targets that the best list misses."""
        given = self._partial_list(self._pattern.rotations)
        starting = [given] if given and self._ratios([given]).max() <= 1.0 else []
        beam = [self._empty_list()]
        for _ in range(_MAX_ROTATIONS):
            extended = [
                self._append(each, move) for each in beam for move in self._candidate_rotations(each.angles)
            ]
            if not extended:
                break
            ratios = self._ratios(extended)
            reaching = [each for each, ratio in zip(extended, ratios, strict=True) if ratio.max() <= 1.0]
            if reaching:
                shortened = [self._shorten(each) for each in (*starting, min(reaching, key=self._duration_s))]
                return list(min(shortened, key=self._duration_s).rotations), []
            scores = np.log(np.maximum(ratios, 1.0)).sum(axis=1) + 1e-3 * np.log(ratios).sum(axis=1)
            beam, seen = [], set()
            for index in np.argsort(scores, kind="stable"):
                # Lists that differ only by a symmetry would fill the beam.
                key = (*np.mod(extended[index].angles, 360.0), round(float(scores[index]), 6))
                if key not in seen:
                    seen.add(key)
                    beam.append(extended[index])
                if len(beam) == _BEAM:
                    break
        for each in starting:
            return list(self._shorten(each).rotations), []
        sigmas = np.zeros(COUNT)
        targeted = np.isfinite(self._targets)
        sigmas[targeted] = self._ratios(beam[:1])[0] * self._targets[targeted]
        return [], _missed_texts(sigmas > self._targets, sigmas)

    def _shorten(self, shortest: _PartialList) -> _PartialList:
        shorter: _PartialList | None = shortest
        while shorter is not None:
            shortest, moves = shorter, shorter.rotations
            shorter_lists = (self._partial_list((*moves[:k], *moves[k + 1 :])) for k in range(len(moves)))
            shorter = next(
                (each for each in shorter_lists if each and self._ratios([each]).max() <= 1.0), None
            )
        return shortest

    def _partial_list(self, rotations: Sequence[TableRotation]) -> _PartialList | None:
        part = self._empty_list()
        for rotation in rotations:
            if not self._allows(part.angles, rotation):
                return None
            part = self._append(part, rotation)
        return part

    def _duration_s(self, part: _PartialList) -> float:
        return sum(self._pattern.dwell_s + self._pattern.seconds(each) for each in part.rotations)

    def _candidate_rotations(self, angles: Angles) -> Iterator[TableRotation]:
        axes: tuple[Literal["outer", "inner"], ...] = ("outer", "inner")
        for axis, at_deg in zip(axes, angles, strict=True):
            low, high = self._limits[axis]
            angles_deg = [90.0, 180.0]
            if self._setup.whole_turns is not None:
                room = min(max(high - at_deg, at_deg - low) / 360.0, _MAX_TURNS)
                angles_deg += [360.0 * int(room)] * (room >= 1.0)
            for angle_deg in (sign * size for size in angles_deg for sign in (1.0, -1.0)):
                rotation = TableRotation(axis=axis, angle_deg=angle_deg)
                if self._allows(angles, rotation):
                    yield rotation

    def _allows(self, angles: Angles, rotation: TableRotation) -> bool:
        low, high = self._limits[rotation.axis]
        return low <= _angles_after(angles, rotation)[rotation.axis == "inner"] <= high

    def _ratios(self, parts: Sequence[_PartialList]) -> FloatArray:
        """Uncertainties over targets (n, m) of the coefficients that have one."""
        information = np.array([each.information for each in parts]) + np.eye(len(_COLUMNS))
        variances = np.diagonal(np.linalg.inv(information), axis1=1, axis2=2)
        targeted = np.isfinite(self._targets)
        ratios = (np.sqrt(variances) * self._sizes)[:, :COUNT] / self._targets
        return np.asarray(ratios[:, targeted])

    def _empty_list(self) -> _PartialList:
        state, covariance = np.zeros((9, len(_COLUMNS))), np.zeros((9, 9))
        state[:3, -3:] = ATTITUDE_ERROR * np.eye(3)
        covariance[3:6, 3:6] = self._white * np.eye(3)
        begun = _PartialList((), self._start, state, covariance, np.zeros((len(_COLUMNS),) * 2))
        return self._apply_movement(begun, self._movement(self._start, None), (), self._start)

    def _append(self, part: _PartialList, rotation: TableRotation) -> _PartialList:
        rotations, angles = (*part.rotations, rotation), _angles_after(part.angles, rotation)
        return self._apply_movement(part, self._movement(part.angles, rotation), rotations, angles)

    def _apply_movement(
        self, part: _PartialList, movement: _Movement, rotations: tuple[TableRotation, ...], angles: Angles
    ) -> _PartialList:
        state, covariance, information = part.state.copy(), part.covariance.copy(), part.information.copy()
        is_spin = movement.is_spin and self._setup.whole_turns is not None
        _filter(
            movement.transition, movement.covariance, movement.drive, movement.at_rest, is_spin,
            self._measured, self._white, self._turn, state, covariance, information,
        )  # fmt: skip
        return _PartialList(rotations, angles, state, covariance, information)

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
            noise, site = self._setup.noise, self._setup.site
            transition, covariance, drive = epoch_steps(
                angle, velocity, STEP_S, ends, attitude[0], noise, site.latitude, site.gravity
            )
            drive = np.ascontiguousarray(drive[:, :, _COLUMNS] * self._sizes)
            self._cache[key] = _Movement(transition, covariance, drive, at_rest[ends], bool(spins))
        return self._cache[key]


def _angles_after(angles: Angles, rotation: TableRotation) -> Angles:
    outer, inner = angles
    is_outer = rotation.axis == "outer"
    return (outer + rotation.angle_deg, inner) if is_outer else (outer, inner + rotation.angle_deg)


@compiled
def _filter(
    transition: FloatArray, covariance: FloatArray, drive: FloatArray, at_rest: BoolArray, is_spin: bool,
    measured: int, white: float, turn: float, Z: FloatArray, P: FloatArray, information: FloatArray,
) -> None:  # fmt: skip
    if is_spin:
        begin_turn(Z, P, np.eye(3))
    is_turned = not is_spin
    for epoch in range(len(transition)):
        propagate(transition[epoch], Z)
        propagate(transition[epoch], P)
        propagate(transition[epoch], P.T)
        for i in range(6):
            for a in range(Z.shape[1]):
                Z[i, a] += drive[epoch, i, a]
            for a in range(6):
                P[i, a] += covariance[epoch, i, a]
        if not at_rest[epoch]:
            continue
        for i in range(measured):
            _update(Z[3 + i].copy(), P[3 + i].copy(), P[3 + i, 3 + i] + white, Z, P, information)
        if not is_turned:
            is_turned = True
            for i in range(3):
                spread = P[:, i] - P[:, 6 + i]
                _update(Z[i] - Z[6 + i], spread, spread[i] - spread[6 + i] + turn, Z, P, information)


@compiled
def _update(
    row: FloatArray, spread: FloatArray, variance: float, Z: FloatArray, P: FloatArray,
    information: FloatArray,
) -> None:  # fmt: skip
    """Update state, covariance and information by a measurement.

    ``row``, ``spread``, ``variance``: its row, its covariance with the state, and its variance.
    """
    for i in range(9):
        gain = spread[i] / variance
        for a in range(len(row)):
            Z[i, a] -= gain * row[a]
        for j in range(9):
            P[i, j] -= gain * spread[j]
    for a in range(len(row)):
        for b in range(len(row)):
            information[a, b] += row[a] * row[b] / variance
