"""Processes forked from one that has loaded the emulated bench, which takes a second."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from multiprocessing import forkserver, get_context
from pathlib import Path

import pytest

from gyrobench.drivers.emulators.serve import main

CONTEXT = get_context("forkserver")
CONTEXT.set_forkserver_preload(["tests.drivers.emulators.loaded"])
_ROOT = Path(__file__).parents[3]
#: Time in which a process ends at SIGTERM, s.
_END_S = 2.0


def start(function, *arguments):
    """Start a forked process that calls a function of a module; it ends with this one."""
    with contextlib.chdir(_ROOT), pytest.MonkeyPatch.context() as environment:
        environment.delenv("PYTHONSAFEPATH", raising=False)  # what to load is found in the current folder
        forkserver.ensure_running()
    process = CONTEXT.Process(target=function, args=arguments, daemon=True)
    process.start()
    return process


class ForkedProcess:
    """Calls a function of a module in a process of its own, with the interface of subprocess.Popen."""

    def __init__(self, function, *arguments):
        pipes = [CONTEXT.Pipe(duplex=False) for _ in range(2)]
        readers, writers = zip(*pipes, strict=True)
        surroundings = dict(os.environ), Path.cwd()
        self._process = start(_call, function, arguments, *surroundings, *writers)
        self.pid = self._process.pid
        self.stdout, self.stderr = (os.fdopen(os.dup(each.fileno())) for each in readers)
        for end in (*readers, *writers):
            end.close()

    @property
    def returncode(self):
        return self._process.exitcode

    poll = returncode.fget

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self):
        self.send_signal(signal.SIGTERM)

    def kill(self):
        self.send_signal(signal.SIGKILL)

    def wait(self, timeout=None):
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self.returncode

    def communicate(self, timeout=None):
        """Wait for its end; returns what it printed and complained since it was last read."""
        texts = self.stdout.read(), self.stderr.read()
        self.wait(timeout)
        return texts

    def close(self):
        """End it if it has not ended; a server of emulators then removes its folder. Kill it if it stays."""
        self.terminate()
        self._process.join(_END_S)
        self.kill()
        self.wait()
        self._process.close()
        self.stdout.close()
        self.stderr.close()


def served(*options):
    """Serve emulators; returns the process and where they are."""
    process = ForkedProcess(main, list(map(str, options)))
    return process, json.loads(process.stdout.readline())


def _call(function, arguments, environment, folder, output, complaints):
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    for end, number in ((output, 1), (complaints, 2)):
        os.dup2(end.fileno(), number)
        end.close()
    sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
    function(*arguments)
