"""Tests the signs and axes of the signal map on each dwell, before biases are estimated from it.

Two relations hold only for the correct map. Neither needs a bias or a lever arm:

* From window to window, the attitude follows the path of the table. With a wrong sign of the heading, a
  quaternion of other frames, or a wrong direction of a table axis it turns the opposite way; with the inner
  axis vertical, the first and the last of these can't be distinguished.
* At rest, the velocity of an INS changes by the component of gravity along its tilted axes. With the rotation
  ``r`` of the attitude since the start of a window, ``dV_E/dt = g r_N + 2 W_U V_N + constant`` and
  ``dV_N/dt = -g r_E - 2 W_U V_E + constant``. The random walk of the gyros and the Schuler loop cancel, since
  they change tilt and velocity consistently. The residual is noise of the accelerometers and of the output.
  An INS may damp its velocity.

If the declared map contradicts one of these relations, the same frames are tested with maps of other signs
and axes, and with tables whose axes have the opposite direction. A map or table is reported if both relations
hold for it. Otherwise something else is wrong, which other checks find.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell import MAX_ATTITUDE_DISAGREEMENT, MIN_EPOCHS
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, integral
from gyrobench.bench.foundations.errors import SignalMapError
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from gyrobench.bench.runs.marks import DwellMarks, WindowMark
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import NavigationData
from gyrobench.drivers.ins.signal_map import EulerMap, QuaternionMap, SignalMap

#: Largest deviation of the attitude from the path of the table, rad. The two axes of a table may turn at
#: different rates; a turn in the wrong direction deviates by 90 deg at half way.
_MAX_OFF_PATH = np.deg2rad(30.0)
_PATH_POINTS = 37
#: The declared velocities contradict the tilt if their residuals exceed this multiple of the smallest
#: residuals of other signs and axes, and this number of steps of the output.
_CONTRADICTION_RATIO, _MIN_STEPS = 3.0, 3.0
#: Other velocities agree with the tilt if their residuals are at most this multiple of the smallest.
_AGREEMENT_RATIO = 2.0

#: Highest rate at which an INS damps its velocity, 1/s.
_MAX_DAMPING = 0.01
_TINY = 1e-300

_VELOCITIES = ("ins.signals.velocity_east", "ins.signals.velocity_north")


def _wrong_sign(name: str) -> str:
    return f"{name} has the wrong sign"


def _exchanged(name: str, other: str) -> str:
    return f"{name} and {other} are exchanged"


@dataclass(frozen=True, eq=False)
class _VelocityChange:
    """``velocity_en @ matrix`` are the velocities after the change."""

    matrix: FloatArray
    faults: tuple[str, ...]


def _velocity_changes() -> Iterator[_VelocityChange]:
    """All signs and orders of the two velocities; the first one changes nothing."""
    for axes, signs in itertools.product(
        (np.eye(2), np.eye(2)[::-1]), ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
    ):
        # Signs are those of the declared signals, before an exchange.
        wrong = [name for name, sign in zip(_VELOCITIES, signs, strict=True) if sign < 0.0]
        faults = [*[_exchanged(*_VELOCITIES)] * int(axes[0, 1]), *map(_wrong_sign, wrong)]
        yield _VelocityChange(np.diag(signs) @ axes, tuple(faults))


_VELOCITY_CHANGES = tuple(sorted(_velocity_changes(), key=lambda change: len(change.faults)))


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Residuals of one signal map and table."""

    #: table_deviation, path_deviation: Largest angle from the table at rest and in the turns, rad.
    table_deviation: float
    path_deviation: float
    #: Shape (8, 2). Residual of velocity East and North about the tilt, m/s, for each change of the map.
    velocity_rms: FloatArray
    #: Of both velocities together, as declared, rotated about Up by the angle that fits best.
    rotated_rms: float
    #: Shape (8,). Of both velocities together if the accelerometers may drift steadily in each window.
    rms_with_drift: FloatArray

    @property
    def is_on_path(self) -> bool:
        return bool(
            self.table_deviation <= MAX_ATTITUDE_DISAGREEMENT and self.path_deviation <= _MAX_OFF_PATH
        )


@dataclass(frozen=True, eq=False)
class SignCheck:
    """Test of signs and axes for one station."""

    signals: SignalMap  #: As declared.
    decode: Callable[..., NavigationData]  #: Decodes frames; argument ``signal_map`` replaces the map.
    table: TwoAxisTable
    site: Site
    velocity_step_mps: float  #: Resolution of the velocity.

    def check(self, marks: DwellMarks, frames: FrameBlock, navigation: NavigationData) -> bool:
        """Compare attitude, table and velocities of a dwell; returns whether the test is conclusive.

        It is not if other signs or axes of the velocities are also consistent, as in short windows.
        ``navigation``: the frames, decoded by the declared map. Raises SignalMapError if another map is
        consistent with them and the declared one is not.
        """
        declared = self._evidence(marks, navigation)
        if declared is None:
            return False
        is_consistent, *others = self._are_consistent(declared)
        if declared.is_on_path and is_consistent:
            return not any(others)
        candidates: list[tuple[tuple[str, ...], _Evidence]] = [((), declared)]
        for axes, table in self.table.reversed_axes():
            if evidence := self._evidence(marks, navigation, table=table):
                text = "has the wrong direction (watch which way positive angles turn)"
                candidates.append((tuple(f"rate_table.{axis} {text}" for axis in axes), evidence))
        if evidence := self._evidence(marks, navigation, -1.0):
            candidates.append(((_wrong_sign("location.latitude_deg"),), evidence))
        for faults, signal_map in _attitude_changes(self.signals):
            evidence = self._evidence(marks, self.decode(frames, signal_map=signal_map))
            if evidence is not None:
                candidates.append((faults, evidence))
        candidates = [(faults, evidence) for faults, evidence in candidates if evidence.is_on_path]
        if not candidates:
            return False
        best = min(float(np.linalg.norm(evidence.velocity_rms, axis=1).min()) for _, evidence in candidates)
        if declared.is_on_path and best > _CONTRADICTION_RATIO * max(
            declared.rotated_rms, self.velocity_step_mps
        ):
            return False  # turned by no right angle: gyrobench.bench.dwells.setup_check names the angle
        limit = max(_AGREEMENT_RATIO * best, self.velocity_step_mps)
        matches = [
            ((*faults, *change.faults), evidence, rms)
            for faults, evidence in candidates
            for change, rms, rms_with_drift in zip(
                _VELOCITY_CHANGES, evidence.velocity_rms, evidence.rms_with_drift, strict=True
            )
            if np.linalg.norm(rms) <= limit
            and not (declared.is_on_path and rms_with_drift > declared.rms_with_drift[0])
        ]
        fewest = min((len(faults) for faults, _, _ in matches), default=0)
        if fewest:
            alternatives = [each for each in matches if len(each[0]) == fewest]
            raise SignalMapError(_fault_text(declared, alternatives))
        return False

    def _are_consistent(self, evidence: _Evidence) -> BoolArray:
        """Mask (8,) of the changes of the velocities that are consistent with the tilt; the first is none."""
        best = evidence.velocity_rms.min(axis=0)
        limit = np.maximum(_CONTRADICTION_RATIO * best, _MIN_STEPS * self.velocity_step_mps)
        return np.asarray((evidence.velocity_rms <= limit).all(axis=1))

    def _evidence(
        self,
        marks: DwellMarks,
        navigation: NavigationData,
        hemisphere: float = 1.0,
        table: TwoAxisTable | None = None,
    ) -> _Evidence | None:
        """Residuals of the data about table and gravity; None if there are too few data.

        ``hemisphere``: -1 for the opposite one. ``table``: replaces that of the station.
        """
        table = table or self.table
        table_deviation = 0.0
        residuals: list[FloatArray] = []
        residuals_with_drift: list[FloatArray] = []
        for mark in marks.windows:
            epochs = navigation.between(mark.first_frame, mark.end_frame)
            time_s = navigation.ins_time_s[epochs]
            if len(time_s) < MIN_EPOCHS or (np.diff(time_s) <= 0.0).any():
                return None
            every = max(1, round(EPOCH_S / float(np.median(np.diff(time_s)))))
            C_nb, velocity = (
                each[epochs][::every] for each in (navigation.attitude, navigation.velocity_enu_mps[:, :2])
            )
            if not (np.isfinite(C_nb).all() and np.isfinite(velocity).all()):
                return None
            deviation = _angles_to(C_nb[:1], table.attitude(mark.outer_deg, mark.inner_deg)[np.newaxis])
            table_deviation = max(table_deviation, float(deviation[0]))
            rotation = rotation_vector_enu(C_nb, C_nb[0])
            for parts, degree in ((residuals, 1), (residuals_with_drift, 2)):
                parts.append(
                    self._velocity_residuals(time_s[::every], velocity, rotation, hemisphere, degree)
                )
        path_deviation = max(
            (_path_deviation(table, navigation, *pair) for pair in itertools.pairwise(marks.windows)),
            default=0.0,
        )
        *of_changes, tilt, displacement = np.concatenate(residuals, axis=1)
        # Least-squares rotation as complex numbers: East is real, North imaginary.
        rotated, level = (each @ np.array([1.0, 1.0j]) for each in (of_changes[0] + tilt, tilt))
        turn = np.vdot(rotated, level)
        differences = rotated * turn / max(abs(turn), _TINY) - level
        rotated_rms = math.sqrt(float(np.mean(np.abs(differences) ** 2)))
        *of_changes_with_drift, _, displacement_with_drift = np.concatenate(residuals_with_drift, axis=1)
        rms_with_drift = np.linalg.norm(_rms([*of_changes_with_drift, displacement_with_drift]), axis=1)
        return _Evidence(
            table_deviation, path_deviation, _rms([*of_changes, displacement]), rotated_rms, rms_with_drift
        )

    def _velocity_residuals(
        self, time_s: FloatArray, velocity: FloatArray, rotation: FloatArray, hemisphere: float, degree: int
    ) -> FloatArray:
        """Residuals of the velocities (n, 2) of a window about the tilt, shape (10, n, 2).

        One for each change of the velocities, then the velocities due to the tilt, and last the integral of
        the velocities, all without their polynomials of this degree in time.
        """
        integrals = [
            integral(each, time_s)
            for each in (self.site.gravity * np.stack([rotation[:, 1], -rotation[:, 0]], axis=-1), velocity)
        ]
        line = np.linalg.qr(np.vander((time_s - time_s.mean()) / np.ptp(time_s), degree + 1))[0]
        velocity_residual, tilt, displacement = (
            each - line @ (line.T @ each) for each in (velocity, *integrals)
        )
        _, _, rate_up = earth_rate_enu(hemisphere * self.site.latitude)
        coriolis = 2.0 * rate_up * np.array([[0.0, -1.0], [1.0, 0.0]])
        changes = [each.matrix for each in _VELOCITY_CHANGES]
        return np.stack(
            [
                *(velocity_residual @ each - tilt - displacement @ each @ coriolis for each in changes),
                tilt,
                displacement,
            ]
        )


def _rms(residuals: Sequence[FloatArray]) -> FloatArray:
    """Rms (8, 2) of the residuals of the velocities; those as declared may be damped by the INS."""
    *of_changes, displacement = residuals
    damping = (displacement * of_changes[0]).sum() / max(float((displacement**2).sum()), _TINY)
    of_changes[0] = of_changes[0] - displacement * np.clip(damping, -_MAX_DAMPING, 0.0)
    return np.asarray(np.sqrt(np.mean(np.square(of_changes), axis=1)))


def _path_deviation(
    table: TwoAxisTable, navigation: NavigationData, before: WindowMark, after: WindowMark
) -> float:
    """Largest angle between the attitude in a turn and the nearest one on the path of the table."""
    C_nb = navigation.attitude[navigation.between(before.end_frame, after.first_frame)]
    C_nb = C_nb[np.isfinite(C_nb).all(axis=(1, 2))]
    if not len(C_nb):
        return 0.0
    share = np.linspace(0.0, 1.0, _PATH_POINTS)
    outer = before.outer_deg + share * (after.outer_deg - before.outer_deg)
    inner = before.inner_deg + share * (after.inner_deg - before.inner_deg)
    return float(_angles_to(C_nb, table.attitude(outer, inner)).max())


def _angles_to(C_nb: FloatArray, others: FloatArray) -> FloatArray:
    """Angle (n,) from each attitude (n, 3, 3) to the nearest of others (m, 3, 3)."""
    traces = C_nb.reshape(-1, 9) @ others.reshape(-1, 9).T
    return np.asarray(np.arccos(np.clip(0.5 * (traces.max(axis=1) - 1.0), -1.0, 1.0)))


def _attitude_changes(signals: SignalMap) -> Iterator[tuple[tuple[str, ...], SignalMap]]:
    """Possible faults of the map of the attitude, each with the corrected map."""

    def with_fields(kind: str, **fields: object) -> SignalMap:
        form = getattr(signals.attitude, kind).model_copy(update=fields)
        attitude = signals.attitude.model_copy(update={kind: form})
        return signals.model_copy(update={"attitude": attitude})

    def opposite_signs(form: EulerMap | QuaternionMap, names: Iterable[str]) -> dict[str, object]:
        sources = {name: getattr(form, name) for name in names}
        return {name: source.model_copy(update={"sign": -source.sign}) for name, source in sources.items()}

    euler, quaternion = signals.attitude.euler, signals.attitude.quaternion
    if euler is not None:
        prefix, other = "ins.signals.attitude.euler", "down" if euler.yaw_positive == "up" else "up"
        yield (
            (f"{prefix}.yaw_positive is '{euler.yaw_positive}' in place of '{other}'",),
            with_fields("euler", yaw_positive=other),
        )
        for names in (("roll",), ("pitch",), ("roll", "pitch")):
            faults = tuple(_wrong_sign(f"{prefix}.{name}") for name in names)
            yield faults, with_fields("euler", **opposite_signs(euler, names))
        exchanged = with_fields("euler", roll=euler.pitch, pitch=euler.roll)
        yield (_exchanged(f"{prefix}.roll", f"{prefix}.pitch"),), exchanged
    if quaternion is not None:
        prefix = "ins.signals.attitude.quaternion"
        frames = "frd_to_ned" if quaternion.frames == "rfu_to_enu" else "rfu_to_enu"
        yield (
            (f"{prefix}.frames is '{quaternion.frames}' in place of '{frames}'",),
            with_fields("quaternion", frames=frames),
        )
        yield (
            (f"{prefix} leads from navigation to body axes: give x, y and z the other sign",),
            with_fields("quaternion", **opposite_signs(quaternion, "xyz")),
        )
        for name in "xyz":
            yield (
                (_wrong_sign(f"{prefix}.{name}"),),
                with_fields("quaternion", **opposite_signs(quaternion, name)),
            )
        exchanged = with_fields("quaternion", x=quaternion.y, y=quaternion.x)
        yield (_exchanged(f"{prefix}.x", f"{prefix}.y"),), exchanged
        components = [getattr(quaternion, name) for name in "wxyz"]
        for where, reordered in (
            ("first", components[1:] + components[:1]),
            ("last", components[-1:] + components[:-1]),
        ):
            wrong, right = components[0].signal, reordered[0].signal
            yield (
                (f"{prefix}.w is {wrong} in place of {right}, the scalar sent {where}",),
                with_fields("quaternion", **dict(zip("wxyz", reordered, strict=True))),
            )


def _fault_text(
    declared: _Evidence, alternatives: list[tuple[tuple[str, ...], _Evidence, FloatArray]]
) -> str:
    faults_text = "; or ".join(" and ".join(faults) for faults, _, _ in alternatives)
    _, other, rms = alternatives[0]
    if declared.is_on_path:
        axis = int(np.argmax(declared.velocity_rms[0] / rms))
        reason = (
            f"at rest the velocity {('East', 'North')[axis]} differs by "
            f"{1e3 * declared.velocity_rms[0, axis]:.2g} mm/s from the one that follows from the tilt of the "
            f"INS, and by {1e3 * rms[axis]:.2g} mm/s with this corrected"
        )
    else:
        deviation, alternative = (
            max(evidence.table_deviation, evidence.path_deviation) * 180.0 / np.pi
            for evidence in (declared, other)
        )
        reason = (
            f"the attitude deviates from that of the table by {deviation:.0f} deg, "
            f"and by {alternative:.1f} deg with this corrected"
        )
    return f"{faults_text}: {reason}. Correct the station file"
