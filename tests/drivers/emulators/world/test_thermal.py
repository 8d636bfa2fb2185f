import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.world.thermal import ThermalNetwork
from gyrobench.drivers.emulators.world.world_file import GyroThermal, Thermal, load_world

HOUR = 3600
UPS = {
    "x_up": (1, 0, 0),
    "x_down": (-1, 0, 0),
    "y_up": (0, 1, 0),
    "y_down": (0, -1, 0),
    "z_up": (0, 0, 1),
    "z_down": (0, 0, -1),
}
GYRO_A = load_world(find_document("worlds", "gyro_a")).thermal


def network(thermal=GYRO_A, start_c=23.0, powered=True):
    result = ThermalNetwork(thermal, start_c)
    result.powered = powered
    return result


def run(net, seconds, air_c, up=(0, 0, 1)):
    net.step(1.0, np.full(seconds, air_c, dtype=float), np.array(up, dtype=float))
    return net.course.nodes_c


def power_w(thermal):
    return sum(g.optics_power_w + g.electronics_power_w for g in (thermal.x, thermal.y, thermal.z))


@pytest.mark.parametrize("air_c", [-40.0, 23.0, 60.0])
@pytest.mark.parametrize("up", UPS.values(), ids=UPS)
def test_electronics_are_ten_degrees_hotter_than_the_optics_before_the_hardware_change(air_c, up):
    net = network(start_c=air_c)
    run(net, 5 * HOUR, air_c, up)
    assert (net.electronics_c - net.optics_c).min() > 10.0
    assert (net.optics_c > net.nodes_c[0]).all()
    assert net.nodes_c[0] > air_c


@pytest.mark.parametrize("name", ["gyro_a", "gyro_b", "ideal"])
def test_at_the_steady_state_the_air_takes_what_the_unit_dissipates(name):
    thermal = load_world(find_document("worlds", name)).thermal
    net = network(thermal, start_c=40.0)
    run(net, 8 * HOUR, -10.0, (0.6, 0.0, 0.8))
    into_air_w = thermal.case_to_air_w_per_k * (net.nodes_c[0] - -10.0)
    assert into_air_w == pytest.approx(power_w(thermal), rel=1e-5)


@given(
    nodes_c=st.lists(st.floats(-60.0, 100.0), min_size=7, max_size=7),
    air_c=st.floats(-60.0, 100.0),
    up=st.sampled_from(sorted(UPS)),
    powered=st.booleans(),
)
def test_no_step_makes_or_destroys_heat(nodes_c, air_c, up, powered):
    net = network(powered=powered)
    net.nodes_c[:] = nodes_c
    gyros = (GYRO_A.x, GYRO_A.y, GYRO_A.z)
    capacities = [
        GYRO_A.case_j_per_k,
        *(gyro.optics_j_per_k for gyro in gyros),
        *(gyro.electronics_j_per_k for gyro in gyros),
    ]
    net.step(1.0, air_c, np.array(UPS[up], dtype=float))
    stored_j = np.dot(capacities, net.nodes_c - nodes_c)
    lost_j = GYRO_A.case_to_air_w_per_k * (nodes_c[0] - air_c)
    assert stored_j == pytest.approx(powered * power_w(GYRO_A) - lost_j, abs=1e-8)


def test_the_steady_state_does_not_depend_on_where_it_came_from():
    cold, hot = network(start_c=-50.0), network(start_c=90.0)
    for net in (cold, hot):
        run(net, 8 * HOUR, 20.0)
    np.testing.assert_allclose(cold.nodes_c, hot.nodes_c, atol=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_heat_flow_that_depends_on_attitude_changes_sign_with_gravity(axis):
    path = np.array((GYRO_A.x, GYRO_A.y, GYRO_A.z)[axis].heat_path)
    flows_w = []
    for up in (path, -path, np.cross(path, np.roll(path, 1))):
        net = network()
        run(net, 5 * HOUR, 0.0, up / np.linalg.norm(up))
        flows_w.append(net.course.convected_w[-1, axis])
    helped, hindered, across = flows_w
    # Warm air rises from the electronics to the optics, and then also cools them more.
    assert helped > 0.1
    assert hindered < -0.1
    assert abs(hindered) > helped
    assert across == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("scale", [0.1, 7.0])
def test_only_the_direction_of_a_heat_path_counts(scale):
    plain = Thermal.model_validate({axis: {"heat_path": [0.0, -0.8, 0.6]} for axis in "xyz"})
    scaled = GyroThermal(heat_path=[0.0, -0.8 * scale, 0.6 * scale])
    nets = network(plain), network(Thermal(x=scaled, y=scaled, z=scaled))
    for net in nets:
        run(net, HOUR, 0.0)
    np.testing.assert_allclose(nets[0].nodes_c, nets[1].nodes_c, atol=1e-9)


def test_the_optics_follow_the_air_in_some_tens_of_minutes():
    net = network()
    before_c = run(net, 8 * HOUR, 20.0)[-1]
    after_c = run(net, 8 * HOUR, 30.0)
    share = (after_c - before_c) / 10.0
    time_to_63_percent_s = (share < 1 - np.exp(-1)).sum(axis=0)
    case_s, optics_s, electronics_s = time_to_63_percent_s[[0, 1, 4]]
    assert 10 * 60 < case_s < 30 * 60
    assert 25 * 60 < optics_s < 60 * 60
    assert case_s < electronics_s < optics_s
    np.testing.assert_allclose(share[-1], 1.0, atol=1e-3)


def test_the_unit_warms_up_from_power_on():
    net = network(powered=False)
    run(net, HOUR, 23.0)
    net.powered = True
    temperatures_c = run(net, 4 * HOUR, 23.0)
    assert (np.diff(temperatures_c[:, 1:4], axis=0) > -1e-9).all()
    assert 5.0 < temperatures_c[-1, 1] - 23.0 < 25.0


@pytest.mark.parametrize("air_c", [-40.0, 70.0])
def test_an_unpowered_unit_takes_the_temperature_of_the_air(air_c):
    net = network(powered=False)
    run(net, 8 * HOUR, air_c)
    np.testing.assert_allclose(net.nodes_c, air_c, atol=1e-2)
    np.testing.assert_allclose(net.course.convected_w[-1], 0.0, atol=1e-3)


def test_an_unpowered_unit_in_air_of_its_temperature_stays_exactly_there():
    net = network(powered=False)
    assert (run(net, 100, 23.0) == 23.0).all()
