"""gyrobench: bench controller for calibrating the gyros of inertial navigation systems.

The parts of the package are folders at the top of the repository: :mod:`gyrobench.bench` and
:mod:`gyrobench.drivers`, and the YAML files for people beside them.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("gyrobench")
except PackageNotFoundError:  # a source tree that was not installed
    __version__ = "0+unknown"
