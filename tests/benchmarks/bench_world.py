"""Processor time of the emulated INS for a second of the clock, up to the frames in the driver's hands."""

import time

import can

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at

SECONDS, REPEATS = 100, 20


def least_us_per_s(bus, clock):
    """Least processor time over some repeats, and frames received each second."""
    times_s = []
    for _ in range(REPEATS):
        frames, begin_s = 0, time.process_time()
        for _ in range(SECONDS):
            clock.sleep(1.0)
            frames += len(bus.recv_block())
        times_s.append(time.process_time() - begin_s)
    return 1e6 * min(times_s) / SECONDS, frames / SECONDS


def test_emulated_second():
    clock = VirtualClock()
    bench = bench_at(BenchAddress(clock.name, "gyro_a", 0))
    print(f"\n{'mode of the INS':<18}{'us per s':>9}{'frames/s':>10}")
    with can.Bus(interface="emulator", channel="ins", clock=clock.name, ignore_config=True) as bus:
        bench.world.power_unit(True)
        bench.world.air.set_point_c, bench.world.air.running = 50.0, True
        clock.sleep(20.0)
        for mode, command in (
            ("standby", bench.world.unit.standby),
            ("align", bench.world.unit.align),
            ("navigate", bench.world.unit.navigate),
        ):
            command()
            clock.sleep(300.0)
            bus.recv_block()
            us_per_s, frames = least_us_per_s(bus, clock)
            print(f"{mode:<18}{us_per_s:>9.1f}{frames:>10.0f}")
            assert bench.world.unit.mode.name.lower() == mode
        bench.world.axes[1].turn_at(0.1, clock.now())
        us_per_s, _ = least_us_per_s(bus, clock)
        print(f"{'navigate, turning':<18}{us_per_s:>9.1f}")
