"""Frames pass through a run as arrays: no Python object is made for each of them."""

import ctypes
from contextlib import contextmanager

import can
import numpy as np
import pytest
import yaml
from numba import carray, cfunc, types

from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.can_log import read_can_log

OBJECTS = 2  # PYMEM_DOMAIN_OBJ


class Allocator(ctypes.Structure):
    """PyMemAllocatorEx of Python's C interface."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("context", "malloc", "calloc", "realloc", "free")]


@contextmanager
def counted_objects():
    """Count each allocation of a Python object, also of one that lives for a moment only."""
    count = np.zeros(1, np.int64)
    usual, counting = Allocator(), Allocator()
    for each in (usual, counting):
        ctypes.pythonapi.PyMem_GetAllocator(OBJECTS, ctypes.byref(each))
    if usual.context:
        pytest.skip("another allocator is already in use")
    malloc = ctypes.CFUNCTYPE(ctypes.c_ssize_t, ctypes.c_ssize_t, ctypes.c_size_t)(usual.malloc)

    @cfunc(types.intp(types.CPointer(types.int64), types.uintp))
    def counting_malloc(counter, size):
        carray(counter, 1)[0] += 1
        return malloc(0, size)

    counting.malloc, counting.context = counting_malloc.address, count.ctypes.data
    ctypes.pythonapi.PyMem_SetAllocator(OBJECTS, ctypes.byref(counting))
    try:
        yield count
    finally:
        ctypes.pythonapi.PyMem_SetAllocator(OBJECTS, ctypes.byref(usual))


def test_each_allocation_is_counted():
    with counted_objects() as count:
        before = int(count[0])
        for _ in range(10_000):
            object()
        assert 10_000 <= count[0] - before < 30_000


def frames_and_objects(run_procedure, folder, epoch_period_s):
    """Frames and allocated objects of one run with epochs that often."""
    folder.mkdir()
    world = read_document(find_document("worlds", "gyro_a")).data
    world["ins"]["epoch_period_s"] = epoch_period_s
    station = read_document(find_document("stations", "emulated")).data
    station["ins"]["signals"]["epoch_period_s"] = epoch_period_s
    paths = {name: folder / f"{name}.yaml" for name in ("world", "station")}
    for path, data in zip(paths.values(), (world, station), strict=True):
        path.write_text(yaml.safe_dump(data))
    with counted_objects() as count:
        run_folder, _, _ = run_procedure("ten_minute_check", folder / "run", **paths)
        objects = int(count[0])
    return sum(len(part) for _, part in read_can_log(run_folder.can)), objects


def test_a_run_makes_less_than_one_object_for_each_frame(run_procedure, tmp_path, monkeypatch):
    frames_and_objects(run_procedure, tmp_path / "first", 0.1)  # imports and compiles
    made, make = [], can.Message.__init__
    monkeypatch.setattr(
        can.Message, "__init__", lambda self, *a, **options: made.append(1) or make(self, *a, **options)
    )
    few, objects_of_few = frames_and_objects(run_procedure, tmp_path / "few", 0.1)
    many, objects_of_many = frames_and_objects(run_procedure, tmp_path / "many", 0.02)
    per_frame = (objects_of_many - objects_of_few) / (many - few)
    assert many > 4 * few
    assert per_frame < 1.0
    assert len(made) < 100  # commands to the INS
