"""Order of the tests, which of them one worker runs, what workers compile and share, and where locks are.

What it needs of gyrobench is imported where a worker uses it: the process that hands out the tests has none.
"""

import atexit
import contextlib
import gc
import importlib
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import hypothesis
import pytest
from xdist.scheduler import LoadFileScheduling

# A shell that starts the tests in the background leaves these ignored, for every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# No deadline: a busy machine must not make a test fail. Fixtures of a function serve all its examples.
COMMON = {"deadline": None, "suppress_health_check": [hypothesis.HealthCheck.function_scoped_fixture]}
hypothesis.settings.register_profile("quick", max_examples=15, **COMMON)
hypothesis.settings.register_profile("thorough", max_examples=200, **COMMON)
hypothesis.settings.load_profile("quick")

#: Tests that look at figures, beside those marked so. In all others a figure is an empty file: drawing takes
#: a tenth of their time.
DRAWN = ("tests/bench/report/figures/", "tests/docs/", "tests/test_accessibility.py")

#: These look at the same runs of a shift.
SHIFT_RUNS = {
    "tests/bench/engine/test_whole_procedure.py",
    "tests/bench/engine/test_whole_procedure_results.py",
    "tests/bench/dwells/test_run_dwells.py",
}
#: These wait in real time for most of their duration, or fork processes that have loaded the emulated bench:
#: a worker takes seconds to have the first.
WAITING = {
    "tests/bench/cli/test_emulate.py",
    "tests/bench/cli/test_jog.py",
    "tests/bench/engine/preflight/test_wall_time.py",
    "tests/bench/engine/test_resumption.py",
    "tests/bench/engine/test_wall_time.py",
    "tests/bench/guard/test_abandoned_bench.py",
    "tests/bench/guard/test_guard.py",
    "tests/bench/guard/test_process.py",
    "tests/bench/guard/test_rescue.py",
    "tests/bench/guard/test_watching.py",
    "tests/bench/investigation/test_external_bench.py",
    "tests/bench/jog/test_jog_session.py",
    "tests/bench/runs/index/test_index.py",
    "tests/bench/station/test_bench_lock.py",
    "tests/bench/station/test_instruments.py",
    "tests/bench/station/test_safe_state.py",
    "tests/drivers/chamber/test_watlow_f4.py",
    "tests/drivers/emulators/test_clients.py",
    "tests/drivers/emulators/test_serve.py",
    "tests/drivers/ins/test_can_bus.py",
    "tests/drivers/ins/test_text_buses.py",
    "tests/drivers/rate_table/test_acutrol3000.py",
    "tests/drivers/test_protocol_rfc2217.py",
    "tests/drivers/test_serial_line.py",
}
#: What takes long comes next, so that no worker has it left over at the end.
LONG = SHIFT_RUNS | {
    "tests/bench/closure/test_whole_campaigns.py",
    "tests/bench/engine/test_several_units.py",
    "tests/bench/investigation/test_investigation.py",
    "tests/bench/monitor/test_browser.py",
}


class WaitingApartScheduling(LoadFileScheduling):
    """One worker runs all tests of a file, and all files that share runs.

    Workers beyond the number of cores collect and run the files that wait, and no others: they would only be
    in the way of those that compute.
    """

    def _split_scope(self, nodeid):
        path = super()._split_scope(nodeid)
        return "runs of a shift" if path in SHIFT_RUNS else path

    def schedule(self):
        """All tests are those that the workers collected that compute; without work, these end last."""
        for by_worker in (self.registered_collections, self.assigned_work):
            for node in [each for each in by_worker if waits(each.workerinput)]:
                by_worker[node] = by_worker.pop(node)
        super().schedule()

    def _check_nodes_have_same_collection(self):
        collected = self.registered_collections
        self.registered_collections = {
            node: tests for node, tests in collected.items() if not waits(node.workerinput)
        }
        try:
            return super()._check_nodes_have_same_collection()
        finally:
            self.registered_collections = collected

    def _assign_work_unit(self, node):
        """Files that wait come last for a worker that computes."""
        is_waiting_one = waits(node.workerinput)
        if is_waiting_one and not WAITING & self.workqueue.keys():
            node.shutdown()
            return
        for scope in [each for each in self.workqueue if (each in WAITING) != is_waiting_one]:
            self.workqueue.move_to_end(scope)
        super()._assign_work_unit(node)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    """State how many workers of ``--dist loadfile`` run the files that wait, and no others."""
    if node.config.getvalue("dist") == "loadfile":
        node.workerinput["waiting"] = node.workerinput["workercount"] - len(os.sched_getaffinity(0))


def waits(workerinput):
    """Whether a worker collects and runs only files that wait."""
    return int(workerinput["workerid"].removeprefix("gw")) < workerinput.get("waiting", 0)


def pytest_ignore_collect(collection_path, config):
    """Leave out, where a worker runs the files that wait, all others."""
    if collection_path.suffix == ".py" and waits(getattr(config, "workerinput", {"workerid": "0"})):
        return str(collection_path.relative_to(config.rootpath)) not in WAITING or None
    return None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep tests that share runs together with ``--dist loadfile``; other ways are xdist's own."""
    return WaitingApartScheduling(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests that wait in real time first, then what takes long."""

    def order(item: pytest.Item) -> tuple[bool, bool]:
        path = item.nodeid.partition("::")[0]
        is_waiting = path in WAITING or item.get_closest_marker("wall_time") is not None
        return not is_waiting, path not in LONG

    items.sort(key=order)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Share the compiling: one worker the simulated bench, each other a part of the tests.

    Without that, and without caches from an earlier time, every worker would compile all.
    """
    config = session.config
    if not hasattr(config, "workerinput"):
        return
    atexit.register(os._exit, 0)  # after all others: freeing each object of all tests takes seconds
    gc.disable()  # importing hardly leaves anything to free
    number, count = int(config.workerinput["workerid"][2:]), config.workerinput["workercount"]
    if number == 0:
        importlib.import_module("gyrobench.drivers.emulators.bench").compile_world()
    if number == 0 or waits(config.workerinput):
        return
    first = max(1, config.workerinput.get("waiting", 0))
    paths = [path for arg in config.args for path in sorted((config.rootpath / arg).rglob("test_*.py"))]
    for path in paths[number - first :: count - first]:
        with contextlib.suppress(Exception, pytest.skip.Exception):  # collecting reports it
            importlib.import_module(".".join(path.relative_to(config.rootpath).with_suffix("").parts))


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Leave what was imported out of garbage collection, which is as seldom as on the command line."""
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 10, 10)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Leave all objects out of the collections with which pytest ends a worker."""
    if hasattr(session.config, "workerinput"):
        gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Draw figures, and free memory after each, for tests that look at them alone."""
    from gyrobench.bench.foundations import memory
    from gyrobench.bench.report import page

    with pytest.MonkeyPatch.context() as patch:
        # A command sets it in this process, for those that it starts; it ends with the test.
        patch.delenv("PYTHONSAFEPATH", raising=False)
        if not item.nodeid.startswith(DRAWN) and not item.get_closest_marker("draws"):
            patch.setattr(page, "_with_figure_file", empty_figure)
            for module in (memory, page):
                patch.setattr(module, "free_memory", int)
        return (yield)


def empty_figure(folder, figure, *_):
    """In place of drawing a figure into a folder."""
    if figure.figure is None or isinstance(figure.figure, Path):
        return figure
    path = folder / f"{figure.name}.png"
    path.write_bytes(b"\x89PNG")
    return replace(figure, figure=path)


@pytest.fixture(scope="session", autouse=True)
def lock_folder_of_this_worker(tmp_path_factory):
    """Locks of the tests stay among those of one worker."""
    from gyrobench.bench.runs.locks import LOCK_DIR_VARIABLE

    with pytest.MonkeyPatch.context() as environment:
        environment.setenv(LOCK_DIR_VARIABLE, str(tmp_path_factory.mktemp("locks")))
        yield


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_the_disk():
    """`os.fsync` only checks the descriptor: no test cuts the power. Those that simulate it replace this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)
        yield


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """``made_once(name, make)``: a folder that ``make(folder)`` fills for all workers, which only read."""
    import fcntl

    folder = tmp_path_factory.getbasetemp()
    shared = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder

    def made(name, make):
        path = shared / name
        with (shared / f"{name}.lock").open("a+") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            lock.seek(0)
            if not lock.read():
                shutil.rmtree(path, ignore_errors=True)
                path.mkdir()
                make(path)
                lock.write("made")
        return path

    return made
