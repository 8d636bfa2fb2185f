import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrobench.bench.navigation.attitude import (
    UP,
    angle_between,
    euler_rpy321,
    rotation_matrix,
    rotation_vector_enu,
)
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.navigation.euler_sequences import euler_pry231

X, Y, Z = np.eye(3)
angles = st.floats(-3.1, 3.1)
regular = st.floats(-1.5, 1.5)


@given(angles, regular, angles)
def test_rpy_undoes_yaw_then_pitch_then_roll(roll, pitch, yaw):
    C_nb = rotation_matrix(Z, yaw) @ rotation_matrix(X, pitch) @ rotation_matrix(Y, roll)
    np.testing.assert_allclose(euler_rpy321(C_nb), [roll, pitch, yaw], atol=1e-12)


@given(regular, angles, angles)
def test_pry_undoes_yaw_then_roll_then_pitch(roll, pitch, yaw):
    C_nb = rotation_matrix(Z, yaw) @ rotation_matrix(Y, roll) @ rotation_matrix(X, pitch)
    np.testing.assert_allclose(euler_pry231(C_nb), [roll, pitch, yaw], atol=1e-12)


@given(st.tuples(regular, regular, regular))
def test_rotation_vector_undoes_a_rotation_from_the_reference(vector):
    reference = POSITIONS["y_up"].C_nb(0.3)
    C_nb = Rotation.from_rotvec(vector).as_matrix() @ reference
    np.testing.assert_allclose(rotation_vector_enu(C_nb[np.newaxis], reference), [vector], atol=1e-12)


def test_tiny_rotations_keep_their_digits():
    vector = np.array([1e-9, -2e-9, 3e-9])
    C_nb = Rotation.from_rotvec([vector, 0.0 * vector]).as_matrix()
    np.testing.assert_allclose(rotation_vector_enu(C_nb, np.eye(3)), [vector, 0.0 * vector], atol=1e-15)


@pytest.mark.parametrize("name", POSITIONS)
def test_heading_moves_as_the_yaw_of_the_regular_sequence(name):
    sequence = euler_pry231 if name.startswith("y") else euler_rpy321
    start = POSITIONS[name].C_nb(0.2)
    vectors = 1e-5 * np.random.default_rng(1).normal(size=(50, 3))
    C_nb = Rotation.from_rotvec(vectors).as_matrix() @ start
    yaw = sequence(C_nb)[:, 2] - sequence(start)[2]
    np.testing.assert_allclose(rotation_vector_enu(C_nb, start)[:, 2], yaw, atol=1e-9)


def test_rpy_is_singular_with_y_up_and_pry_with_x_up():
    assert euler_rpy321(POSITIONS["y_up"].C_nb())[1] == pytest.approx(np.pi / 2)
    assert euler_pry231(POSITIONS["x_up"].C_nb())[0] == pytest.approx(-np.pi / 2)


@given(st.floats(0.0, np.pi))
def test_angle_between_two_attitudes(angle):
    reference = POSITIONS["x_down"].C_nb(0.7)
    turned = rotation_matrix([0.6, 0.0, 0.8], angle) @ reference
    assert angle_between(turned, reference) == pytest.approx(angle, abs=1e-12)


def test_a_positive_turn_about_up_takes_east_to_north():
    np.testing.assert_allclose(rotation_matrix(UP, np.pi / 2) @ X, Y, atol=1e-15)
