"""What an emulated INS sends in the frames of others, the driver reads back through DBC and shipped map."""

from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations import packages
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.can_formats.sbg import SbgFormat
from gyrobench.drivers.emulators.can_ins import SHIPPED_FORMATS, CanInsEmulator
from gyrobench.drivers.emulators.world.inertial_unit import AlignmentQuality, Epochs, Mode
from gyrobench.drivers.frames import FRAME_DTYPE
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.navigation_data import decode_navigation
from gyrobench.drivers.ins.readout import InsMode
from tests.drivers.ins.euler_reference import euler_angles

#: Largest errors by the resolution of each: velocity, m/s, and attitude, rad. A 32-bit float has steps of
#: 2^-20 from 8 m/s on.
RESOLUTION = {"sbg": (0.0051, 1e-4), "canaerospace": (2.0**-21, 5e-7)}
EPOCHS = 40


def states():
    """Attitudes all over the sphere, velocities up to 10 m/s."""
    random = np.random.default_rng(3)
    attitudes = Rotation.random(EPOCHS, random)
    result = np.zeros((EPOCHS, 8))
    result[:, :4] = attitudes.as_quat(scalar_first=True)
    result[:, 4:6] = random.uniform(-10.0, 10.0, (EPOCHS, 2))
    return result, attitudes.as_matrix()


def epochs_of(samples, result, mode=Mode.NAVIGATE, alignment=AlignmentQuality.FINE):
    seconds = np.count_nonzero(samples % 100 == 0)
    return Epochs(samples, result, mode, alignment, np.zeros(seconds), np.full((seconds, 7), 23.0))


def sent(make_world, name, mode=Mode.NAVIGATE, alignment=AlignmentQuality.FINE):
    """The station of that name, the frames of some epochs, and the states behind them."""
    emulator = CanInsEmulator(make_world(), epoch_unix_s=0.0)
    emulator.use_format(name)
    blocks = []
    emulator.listeners.append(blocks.append)
    result, matrices = states()
    samples = np.arange(500, 500 + 10 * EPOCHS, 10)
    emulator._send_epochs(epochs_of(samples, result, mode, alignment))
    station = Station(find_document("stations", f"emulated_{name}"))
    data = decode_navigation(blocks[0], station.file.ins.signals, DbcCodec(load_dbc(station.dbc_path)))
    return data, result, matrices


@pytest.mark.parametrize("name", RESOLUTION)
def test_velocities_and_attitudes_come_back_to_the_resolution_of_the_frames(make_world, name):
    data, result, matrices = sent(make_world, name)
    of_velocity, of_attitude = RESOLUTION[name]
    assert len(data.ins_time_s) == EPOCHS
    assert np.abs(data.velocity_enu_mps[:, :2] - result[:, 4:6]).max() < of_velocity
    turned = Rotation.from_matrix(data.attitude @ matrices.transpose(0, 2, 1))
    assert turned.magnitude().max() < 2.0 * of_attitude


@pytest.mark.parametrize("name", SHIPPED_FORMATS)
def test_blocks_have_the_layout_of_every_block(make_world, name):
    emulator, blocks = CanInsEmulator(make_world()), []
    emulator.use_format(name)
    emulator.listeners.append(blocks.append)
    emulator._send_epochs(epochs_of(np.arange(10, 101, 10), states()[0][:10]))
    assert blocks[0].rows.dtype == FRAME_DTYPE
    assert blocks[0].rows.flags.c_contiguous


@pytest.mark.parametrize("name", RESOLUTION)
def test_epochs_are_a_tenth_of_a_second_apart(make_world, name):
    data, _, _ = sent(make_world, name)
    assert np.diff(data.ins_time_s) == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize("name", RESOLUTION)
@pytest.mark.parametrize(
    ("mode", "expected"), [(Mode.ALIGN, InsMode.ALIGN), (Mode.NAVIGATE, InsMode.NAVIGATE)]
)
def test_the_mode_is_sent(make_world, name, mode, expected):
    data, _, _ = sent(make_world, name, mode)
    assert set(data.mode.tolist()) == {expected}


@pytest.mark.parametrize("name", RESOLUTION)
def test_gyro_temperatures_are_in_degc(make_world, name):
    data, _, _ = sent(make_world, name)
    assert data.temperatures.optics_c == pytest.approx(23.0, abs=0.5)


@pytest.mark.parametrize("name", RESOLUTION)
def test_shipped_dbc_and_map_fit_together(name):
    Station(find_document("stations", f"emulated_{name}")).check_dbc()


def test_the_error_for_unknown_frames_names_the_available_ones(make_world):
    with pytest.raises(DocumentError, match="gyrobench_ins, sbg, canaerospace"):
        CanInsEmulator(make_world()).use_format("nmea2000")


@pytest.fixture
def offered(monkeypatch):
    """Offer an object as the frames `theirs` of another package."""

    def offer(thing):
        monkeypatch.setitem(globals(), "OFFERED", thing)
        entries = (EntryPoint("theirs", f"{__name__}:OFFERED", packages.CAN_FORMATS),)
        monkeypatch.setattr(packages, "_entries", lambda group: entries)

    return offer


def test_a_package_adds_the_frames_of_its_ins(make_world, offered):
    offered(SbgFormat)
    emulator = CanInsEmulator(make_world())
    emulator.use_format("theirs")
    assert isinstance(emulator.format, SbgFormat)
    with pytest.raises(DocumentError, match=r"'thiers' \(did you mean 'theirs'\?\); available: .*, theirs\."):
        emulator.use_format("thiers")


def test_a_mistake_in_the_frames_of_a_package_is_no_error_of_the_bus(make_world, offered):
    class Broken(SbgFormat):
        def frames(self, epochs):
            raise IndexError("too many indices")

    offered(Broken)
    emulator = CanInsEmulator(make_world())
    emulator.use_format("theirs")
    with pytest.raises(RuntimeError, match=r"Broken\.frames failed: too many indices"):
        emulator._send_epochs(epochs_of(np.arange(500, 500 + 10 * EPOCHS, 10), states()[0]))


def test_frames_of_a_package_that_are_no_format_are_refused(make_world, offered):
    offered(dict)
    with pytest.raises(DocumentError, match="'theirs' is dict, no subclass of CanFormat"):
        CanInsEmulator(make_world()).use_format("theirs")


def test_every_set_of_frames_has_a_dbc_file_of_its_name():
    folder = Path(find_document.__code__.co_filename).parents[2] / "drivers" / "ins"
    assert all((folder / f"{name}.dbc").is_file() for name in SHIPPED_FORMATS)


def test_the_aircraft_angles_of_canaerospace_are_those_of_the_attitude(make_world):
    _, _, matrices = sent(make_world, "canaerospace")
    roll, pitch, _ = euler_angles(EulerSequence.RPY_321, matrices)
    assert np.abs(pitch).max() <= np.pi / 2
    assert np.abs(roll).max() > np.pi / 2
