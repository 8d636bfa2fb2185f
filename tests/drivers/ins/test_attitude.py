import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrobench.drivers.ins.attitude import (
    EulerSequence,
    QuaternionFrames,
    attitude_matrices,
    quaternion_matrices,
)
from tests.drivers.ins.euler_reference import euler_angles

RPY, PRY = EulerSequence.RPY_321, EulerSequence.PRY_231
EAST, NORTH, UP = np.eye(3)
angles = st.floats(-np.pi, np.pi)
middle_angles = st.floats(-1.5, 1.5)


@given(roll=angles, pitch=angles, yaw=angles)
def test_sequences_are_intrinsic_rotations_about_the_axes_they_name(roll, pitch, yaw):
    rpy = Rotation.from_euler("ZXY", [yaw, pitch, roll]).as_matrix()
    pry = Rotation.from_euler("ZYX", [yaw, roll, pitch]).as_matrix()
    assert attitude_matrices(RPY, roll, pitch, yaw) == pytest.approx(rpy, abs=1e-12)
    assert attitude_matrices(PRY, roll, pitch, yaw) == pytest.approx(pry, abs=1e-12)


def test_each_sequence_is_singular_where_the_other_is_regular():
    y_up = np.column_stack([EAST, UP, -NORTH])
    x_up = np.column_stack([UP, EAST, NORTH])
    quarter = np.pi / 2
    assert attitude_matrices(PRY, 0.0, quarter, 0.0) == pytest.approx(y_up)
    assert attitude_matrices(RPY, -quarter, 0.0, -quarter) == pytest.approx(x_up)
    # A turn about Up is a turn of yaw in the regular sequence alone.
    turned = attitude_matrices(RPY, 0.0, 0.0, 0.3) @ y_up
    assert euler_angles(PRY, turned)[2] == pytest.approx(0.3)
    assert abs(euler_angles(RPY, y_up)[1]) == pytest.approx(quarter)


def test_positive_yaw_turns_from_east_towards_north_and_pitch_raises_the_nose():
    assert attitude_matrices(RPY, 0.0, 0.0, np.pi / 2) @ EAST == pytest.approx(NORTH)
    assert (attitude_matrices(RPY, 0.0, 0.1, 0.0) @ NORTH)[2] == pytest.approx(np.sin(0.1))


@given(roll=angles, pitch=middle_angles, heading=angles)
def test_a_quaternion_of_aerospace_frames_gives_the_attitude_of_its_angles(roll, pitch, heading):
    x, y, z, w = Rotation.from_euler("ZYX", [heading, pitch, roll]).as_quat()
    found = quaternion_matrices(QuaternionFrames.FRD_TO_NED, w, x, y, z)
    assert found == pytest.approx(attitude_matrices(RPY, roll, pitch, -heading), abs=1e-12)


def test_a_quaternion_of_the_projects_frames_needs_no_unit_length_and_zero_gives_nan():
    rotation = Rotation.from_rotvec([0.1, -0.2, 0.3])
    x, y, z, w = (np.array([component * 0.99, 0.0]) for component in rotation.as_quat())
    found = quaternion_matrices(QuaternionFrames.RFU_TO_ENU, w, x, y, z)
    assert found[0] == pytest.approx(rotation.as_matrix())
    assert np.isnan(found[1]).all()
