"""Signs and axes of the signal map, tested on each dwell before any bias is estimated from it.

Two relations hold for the right map alone, and none of them needs a bias or a lever arm:

* On its way from window to window the attitude stays on the path of the table. A heading with the wrong
  sign, a quaternion of other frames, or an axis of the table with the wrong direction leads the other way
  round; with the inner axis vertical the first and the last of these look alike.
* At rest an INS accelerates as its own tilt lets gravity in. With the rotation ``r`` of the attitude since
  the begin of a window, ``dV_E/dt = g r_N + 2 W_U V_N + constant`` and ``dV_N/dt = -g r_E - 2 W_U V_E +
  constant``. The random walk of the gyros and the Schuler loop drop out, since they move tilt and velocity
  alike; what remains is noise of the accelerometers and of the output. An INS may damp its velocity.

Where the declared map contradicts one of them, maps with other signs and axes are tried on the same frames,
and tables with axes of the opposite direction. A map or table is named if both relations hold for it;
otherwise something else is wrong, and other checks find it.
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

#: Farthest that the attitude may lie from the path of the table, rad. The two axes of a table may run at
#: different speeds; a wrong sense is off by 90 deg half way.
_MAX_OFF_PATH = np.deg2rad(30.0)
_PATH_POINTS = 37
#: The declared velocities contradict the tilt if they are off by this multiple of what others are, and by
#: this number of steps of the output.
_CONTRADICTS, _MIN_STEPS = 3.0, 3.0
#: Others agree with the tilt if they are as near as this many times the nearest.
_AGREES = 2.0

#: Fastest that an INS damps its velocity, 1/s.
_MAX_DAMPING = 0.01
_TINY = 1e-300

_VELOCITIES = ("ins.signals.velocity_east", "ins.signals.velocity_north")


def _wrong_sign(name: str) -> str:
    return f"{name} has the wrong sign"


def _wrong_direction(axis: str) -> str:
    return f"rate_table.{axis} has the wrong direction (watch which way positive angles turn)"


def _exchanged(name: str, other: str) -> str:
    return f"{name} and {other} are exchanged"


@dataclass(frozen=True, eq=False)
class _VelocityChange:
    """``velocity_en @ matrix`` are the velocities after the change."""

    matrix: FloatArray
    faults: tuple[str, ...]


def _velocity_changes() -> Iterator[_VelocityChange]:
    """All signs and orders of the two velocities, fewest changes first; the first one changes nothing."""
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
    """How a map of the attitude fits."""

    #: off_table, off_path: Largest angle from the table at rest and in the turns, rad.
    off_table: float
    off_path: float
    #: Shape (8, 2). What tilt does not explain of velocity East and North, m/s, for each change of the map.
    velocity_rms: FloatArray
    #: The same of both velocities together, as declared, in the axes about Up that fit best.
    turned_rms: float
    #: Shape (8,). Of both velocities together if the accelerometers may drift steadily in each window.
    drifting_rms: FloatArray

    @property
    def is_on_path(self) -> bool:
        return bool(self.off_table <= MAX_ATTITUDE_DISAGREEMENT and self.off_path <= _MAX_OFF_PATH)


@dataclass(frozen=True, eq=False)
class SignCheck:
    """The test for one station."""

    signals: SignalMap  #: As declared.
    decode: Callable[..., NavigationData]  #: Frames to navigation data; ``signal_map`` replaces the map.
    table: TwoAxisTable
    site: Site
    velocity_step_mps: float  #: Resolution of the velocity.

    def check(self, marks: DwellMarks, frames: FrameBlock, navigation: NavigationData) -> bool:
        """Compare attitude, table and velocities of a dwell; returns whether it decides.

        It does not where other signs or axes of the velocities would hold too, as in short windows.
        ``navigation``: the frames, decoded by the declared map. Raises SignalMapError if another map fits
        them and the declared one does not.
        """
        declared = self._evidence(marks, navigation)
        if declared is None:
            return False
        if self._holds(declared):
            return not self._may_hold(declared)[1:].any()
        tried: list[tuple[tuple[str, ...], _Evidence]] = [((), declared)]
        for axes, table in self.table.reversed_axes():
            if other := self._evidence(marks, navigation, table=table):
                tried.append((tuple(map(_wrong_direction, axes)), other))
        if other := self._evidence(marks, navigation, -1.0):
            tried.append(((_wrong_sign("location.latitude_deg"),), other))
        for faults, signal_map in _attitude_changes(self.signals):
            evidence = self._evidence(marks, self.decode(frames, signal_map=signal_map))
            if evidence is not None:
                tried.append((faults, evidence))
        tried = [(faults, evidence) for faults, evidence in tried if evidence.is_on_path]
        if not tried:
            return False
        best = min(float(np.linalg.norm(evidence.velocity_rms, axis=1).min()) for _, evidence in tried)
        if declared.is_on_path and best > _CONTRADICTS * max(declared.turned_rms, self.velocity_step_mps):
            return False  # turned by no right angle: gyrobench.bench.dwells.setup_check names the angle
        limit = max(_AGREES * best, self.velocity_step_mps)
        found = [
            ((*faults, *change.faults), evidence, rms)
            for faults, evidence in tried
            for change, rms, drifting in zip(
                _VELOCITY_CHANGES, evidence.velocity_rms, evidence.drifting_rms, strict=True
            )
            if np.linalg.norm(rms) <= limit
            and not (declared.is_on_path and drifting > declared.drifting_rms[0])
        ]
        fewest = min((len(faults) for faults, _, _ in found), default=0)
        if fewest:
            alternatives = [each for each in found if len(each[0]) == fewest]
            raise SignalMapError(_text(declared, alternatives))
        return False

    def _holds(self, evidence: _Evidence) -> bool:
        return evidence.is_on_path and bool(self._may_hold(evidence)[0])

    def _may_hold(self, evidence: _Evidence) -> BoolArray:
        """Which changes (8,) of the velocities the tilt does not contradict; the first one is none."""
        best = evidence.velocity_rms.min(axis=0)
        limit = np.maximum(_CONTRADICTS * best, _MIN_STEPS * self.velocity_step_mps)
        return np.asarray((evidence.velocity_rms <= limit).all(axis=1))

    def _evidence(
        self,
        marks: DwellMarks,
        navigation: NavigationData,
        hemisphere: float = 1.0,
        table: TwoAxisTable | None = None,
    ) -> _Evidence | None:
        """How the data fit table and gravity; None without data for it.

        ``hemisphere``: -1 for the other. ``table``: in place of that of the station.
        """
        table = table or self.table
        off_table = 0.0
        unexplained: list[FloatArray] = []
        drifting: list[FloatArray] = []
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
            off = _angles_to(C_nb[:1], table.attitude(mark.outer_deg, mark.inner_deg)[np.newaxis])
            off_table = max(off_table, float(off[0]))
            rotation = rotation_vector_enu(C_nb, C_nb[0])
            for parts, degree in ((unexplained, 1), (drifting, 2)):
                parts.append(self._unexplained(time_s[::every], velocity, rotation, hemisphere, degree))
        off_path = max(
            (_off_path(table, navigation, *pair) for pair in itertools.pairwise(marks.windows)), default=0.0
        )
        *left, tilt, displacement = np.concatenate(unexplained, axis=1)
        # The rotation of least squares; 0 + 1j turns East to North.
        turned, level = (each @ np.array([1.0, 1.0j]) for each in (left[0] + tilt, tilt))
        turn = np.vdot(turned, level)
        away = turned * turn / max(abs(turn), _TINY) - level
        turned_rms = math.sqrt(float(np.mean(np.abs(away) ** 2)))
        *of_drifting, _, moved = np.concatenate(drifting, axis=1)
        drifting_rms = np.linalg.norm(_rms([*of_drifting, moved]), axis=1)
        return _Evidence(off_table, off_path, _rms([*left, displacement]), turned_rms, drifting_rms)

    def _unexplained(
        self, time_s: FloatArray, velocity: FloatArray, rotation: FloatArray, hemisphere: float, degree: int
    ) -> FloatArray:
        """What tilt does not explain of the velocities (n, 2) of a window, shape (10, n, 2).

        One for each change of the velocities, then what the tilt leads to, and last their integral, all less
        polynomials of this degree in time.
        """
        integrals = [
            integral(each, time_s)
            for each in (self.site.gravity * np.stack([rotation[:, 1], -rotation[:, 0]], axis=-1), velocity)
        ]
        line = np.linalg.qr(np.vander((time_s - time_s.mean()) / np.ptp(time_s), degree + 1))[0]
        velocity_left, tilt, displacement = (each - line @ (line.T @ each) for each in (velocity, *integrals))
        _, _, rate_up = earth_rate_enu(hemisphere * self.site.latitude)
        coriolis = 2.0 * rate_up * np.array([[0.0, -1.0], [1.0, 0.0]])
        changes = [each.matrix for each in _VELOCITY_CHANGES]
        return np.stack(
            [
                *(velocity_left @ each - tilt - displacement @ each @ coriolis for each in changes),
                tilt,
                displacement,
            ]
        )


def _rms(unexplained: Sequence[FloatArray]) -> FloatArray:
    """Sizes (8, 2) of what is unexplained of the velocities; declared ones may be damped by the INS."""
    *left, displacement = unexplained
    damping = (displacement * left[0]).sum() / max(float((displacement**2).sum()), _TINY)
    left[0] = left[0] - displacement * np.clip(damping, -_MAX_DAMPING, 0.0)
    return np.asarray(np.sqrt(np.mean(np.square(left), axis=1)))


def _off_path(
    table: TwoAxisTable, navigation: NavigationData, before: WindowMark, after: WindowMark
) -> float:
    """Largest angle between the attitude in a turn and the nearest that the table may have had."""
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
    """What may be wrong with the map of the attitude, and the map without it."""

    def changed(kind: str, **fields: object) -> SignalMap:
        form = getattr(signals.attitude, kind).model_copy(update=fields)
        attitude = signals.attitude.model_copy(update={kind: form})
        return signals.model_copy(update={"attitude": attitude})

    def mirrored(form: EulerMap | QuaternionMap, names: Iterable[str]) -> dict[str, object]:
        sources = {name: getattr(form, name) for name in names}
        return {name: source.model_copy(update={"sign": -source.sign}) for name, source in sources.items()}

    euler, quaternion = signals.attitude.euler, signals.attitude.quaternion
    if euler is not None:
        prefix, other = "ins.signals.attitude.euler", "down" if euler.yaw_positive == "up" else "up"
        yield (
            (f"{prefix}.yaw_positive is '{euler.yaw_positive}' in place of '{other}'",),
            changed("euler", yaw_positive=other),
        )
        for names in (("roll",), ("pitch",), ("roll", "pitch")):
            faults = tuple(_wrong_sign(f"{prefix}.{name}") for name in names)
            yield faults, changed("euler", **mirrored(euler, names))
        exchanged = changed("euler", roll=euler.pitch, pitch=euler.roll)
        yield (_exchanged(f"{prefix}.roll", f"{prefix}.pitch"),), exchanged
    if quaternion is not None:
        prefix = "ins.signals.attitude.quaternion"
        frames = "frd_to_ned" if quaternion.frames == "rfu_to_enu" else "rfu_to_enu"
        yield (
            (f"{prefix}.frames is '{quaternion.frames}' in place of '{frames}'",),
            changed("quaternion", frames=frames),
        )
        yield (
            (f"{prefix} leads from navigation to body axes: give x, y and z the other sign",),
            changed("quaternion", **mirrored(quaternion, "xyz")),
        )
        for name in "xyz":
            yield (_wrong_sign(f"{prefix}.{name}"),), changed("quaternion", **mirrored(quaternion, name))
        exchanged = changed("quaternion", x=quaternion.y, y=quaternion.x)
        yield (_exchanged(f"{prefix}.x", f"{prefix}.y"),), exchanged
        signals_of = [getattr(quaternion, name) for name in "wxyz"]
        for where, moved in (
            ("first", signals_of[1:] + signals_of[:1]),
            ("last", signals_of[-1:] + signals_of[:-1]),
        ):
            wrong, right = signals_of[0].signal, moved[0].signal
            yield (
                (f"{prefix}.w is {wrong} in place of {right}, the scalar sent {where}",),
                changed("quaternion", **dict(zip("wxyz", moved, strict=True))),
            )


def _text(declared: _Evidence, alternatives: list[tuple[tuple[str, ...], _Evidence, FloatArray]]) -> str:
    what = "; or ".join(" and ".join(faults) for faults, _, _ in alternatives)
    _, other, rms = alternatives[0]
    if declared.is_on_path:
        axis = int(np.argmax(declared.velocity_rms[0] / rms))
        why = (
            f"at rest the velocity {('East', 'North')[axis]} differs by "
            f"{1e3 * declared.velocity_rms[0, axis]:.2g} mm/s from what the tilt of the INS leads to, and by "
            f"{1e3 * rms[axis]:.2g} mm/s otherwise"
        )
    else:
        off, otherwise = (
            max(evidence.off_table, evidence.off_path) * 180.0 / np.pi for evidence in (declared, other)
        )
        why = f"the attitude lies {off:.0f} deg off that of the table, and {otherwise:.1f} deg otherwise"
    return f"{what}: {why}. Correct the station file"
