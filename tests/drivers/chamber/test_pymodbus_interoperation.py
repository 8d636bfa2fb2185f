"""An independent implementation of Modbus on the other side, over pseudo-terminals."""

import asyncio
import threading

import pytest
from pymodbus.simulator import DataType, SimData, SimDevice

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.serial_line import SerialLine

REGISTERS = {
    0: [5270],
    100: [0x10000 - 123, 0, 0, 0, 0, 0, 0, 0],
    300: [230],
    311: [0, 0],
    602: [0x10000 - 700, 1200],
    606: [1],
    901: [1],
    1100: [0, 1000, 0],
    **{1990 + 10 * number: [0] for number in range(1, 9)},
}


class Server(threading.Thread):
    """pymodbus's serial server, holding plain registers."""

    def __init__(self, port: str, registers: dict[int, list[int]]) -> None:
        super().__init__(daemon=True)
        blocks = [
            SimData(address, values=values, datatype=DataType.REGISTERS)
            for address, values in registers.items()
        ]
        self._device = SimDevice(1, blocks)
        self._port = port
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()

    def run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        from pymodbus.server import ModbusSerialServer  # here: with it comes a web server, in every worker

        self._server = ModbusSerialServer(self._device, port=self._port)
        await self._server.serve_forever(background=True)
        self._ready.set()
        await self._server.serving

    def __enter__(self) -> "Server":
        self.start()
        assert self._ready.wait(120)
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop)
        self.join(120)
        assert not self.is_alive()

    def register(self, address: int) -> int:
        future = asyncio.run_coroutine_threadsafe(self._server.async_getValues(1, 3, address), self._loop)
        return future.result(120)[0]


def test_the_driver_talks_to_pymodbus_server(crossed_ports):
    near, far = crossed_ports
    with Server(far, REGISTERS) as server, SerialLine("chamber", near, WallClock()) as line:
        chamber = WatlowF4(line, reply_timeout_s=120.0)
        assert chamber.identify().startswith("Watlow F4, model number 5270")
        assert chamber.read() == ChamberReading(-12.3, set_point_c=23.0, is_on=False, alarms=())
        assert chamber.limits_c() == (-70.0, 120.0)
        chamber.set_temperature(-40.0, 0.25)
        assert chamber.set_point_c() == -40.0
        assert [server.register(address) for address in (300, 1100, 1101, 1102)] == [0x10000 - 400, 2, 150, 1]
        chamber.switch(True)
        chamber.switch_event(2, True)
        assert [server.register(address) for address in (2000, 2010, 2020)] == [1, 1, 0]


def test_the_driver_understands_pymodbus_exceptions(crossed_ports):
    near, far = crossed_ports
    without_ramp = {address: values for address, values in REGISTERS.items() if address not in (1100, 2070)}
    with Server(far, without_ramp), SerialLine("chamber", near, WallClock()) as line:
        chamber = WatlowF4(line, reply_timeout_s=120.0)
        assert chamber.identify().endswith("ramps by profiles only")
        with pytest.raises(RefusedError, match="exception 02"):
            chamber.switch_event(8, True)
