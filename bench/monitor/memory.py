"""What has been made of a folder, kept until something in it changes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Generic, TypeVar

Value = TypeVar("Value")


class FolderMemory(Generic[Value]):
    """Values made of folders, each made again only when its folder has changed.

    Safe for several threads; they wait for each other, so that nothing is made twice.

    Parameters
    ----------
    make : callable
        Makes the value of a folder.
    signature : callable
        Gives something of a folder that is another whenever its value may be.
    most : int
        How many values are kept; the one that was asked for longest ago goes first.
    """

    def __init__(
        self, make: Callable[[Path], Value], signature: Callable[[Path], Hashable], most: int
    ) -> None:
        self._make, self._signature, self._most = make, signature, most
        self._values: OrderedDict[Path, tuple[Hashable, Value]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, folder: Path) -> Value:
        """Value of a folder; errors of making it are passed on."""
        with self._lock:
            signature = self._signature(folder)
            known = self._values.pop(folder, None)
            if known is None or known[0] != signature:
                known = (signature, self._make(folder))
            self._values[folder] = known
            if len(self._values) > self._most:
                self._values.popitem(last=False)
            return known[1]
