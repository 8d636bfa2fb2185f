"""Exceptions of gyrobench.

::

    GyrobenchError
    ├── DocumentError (ValueError)        a procedure, station, world or DBC file is wrong
    ├── InstrumentError                   a problem with one instrument
    │   ├── ConnectionFailedError (OSError)   its port can't be opened or is gone
    │   ├── NoReplyError (TimeoutError)   it did not reply in time
    │   ├── ReplyError                    its reply is invalid
    │   ├── RefusedError                  it refused a request
    │   └── FaultError                    it reports a fault: trip, interlock, broken sensor
    ├── InterlockError                    a limit of the station is exceeded, or a value too old
    ├── BenchInUseError                   another process holds the bench or the run folder
    ├── StepTimeoutError (TimeoutError)   a step of the procedure exceeded its time limit
    ├── InvalidDwellError                 a dwell in progress can no longer give a result
    ├── UnitsLostError                    every unit of a run was dropped
    ├── RunStoppedError                   a command or an answer stops the run
    ├── MeasurementError (ValueError)     measured data that can't give a result
    │   └── SignalMapError                they contradict the signal map or the latitude
    ├── RunFolderError (OSError)          a run folder that can't be written or read
    │   ├── RunFinishedError              there is nothing to resume
    │   ├── MissingRunError               there is no run where one was named
    │   └── UnusablePathError             a path that was named can't be written, or is in use
    └── MissingPackageError (ImportError) an optional package is not installed

A message states what happened, where, and what to do about it. Subclasses that a single package uses are
defined there.
"""


class GyrobenchError(Exception):
    """Base class of all exceptions of gyrobench."""


class DocumentError(GyrobenchError, ValueError):
    """A YAML or DBC file is wrong.

    Example scenarios: an unknown key, a temperature outside the station's limits, a signal
    whose unit can't be converted. The message lists every problem with file, line and column.
    """


class InstrumentError(GyrobenchError):
    """A problem with one instrument.

    ``instrument`` is its name: "rate table", "chamber" or "INS". ``message`` states what happened and what to
    do; the text of the error is the instrument's name and the message.
    """

    def __init__(self, instrument: str, message: str) -> None:
        super().__init__(f"{instrument}: {message}")
        self.instrument, self.message = instrument, message


class ConnectionFailedError(InstrumentError, OSError):
    """The instrument's port can't be opened, or is gone (cable, power, wrong name)."""


class NoReplyError(InstrumentError, TimeoutError):
    """The instrument did not reply within the time limit."""


class ReplyError(InstrumentError):
    """The instrument's reply is invalid: wrong CRC, wrong length, not a number."""


class RefusedError(InstrumentError):
    """The instrument refused a valid request: exception code, parameter out of range.

    A driver also raises it if it refuses a command itself, or the instrument does not hold a written value.
    """


class FaultError(InstrumentError):
    """The instrument reports a fault: rate trip, open interlock, broken sensor."""


class InterlockError(GyrobenchError):
    """A limit of the station is exceeded, or the value to compare with it is missing or too old."""


class BenchInUseError(GyrobenchError):
    """Another process holds the bench or the run folder; the message names it, its user and the start."""


class StepTimeoutError(GyrobenchError, TimeoutError):
    """A step of the procedure exceeded its time limit."""


class InvalidDwellError(GyrobenchError):
    """A dwell in progress can no longer give a result, as when the INS did not align; it is repeated."""


class UnitsLostError(GyrobenchError):
    """Every unit of a run was dropped."""


class RunStoppedError(GyrobenchError):
    """A command or an answer of the operator stops the run, or it was held for too long."""


class MeasurementError(GyrobenchError, ValueError):
    """Measured data that can't give a result: a window too short, gaps, not a number."""


class SignalMapError(MeasurementError):
    """Measured data contradict the station file: its signal map, mounting or latitude."""


class RunFolderError(GyrobenchError, OSError):
    """A run folder can't be written, or its contents can't be read."""


class RunFinishedError(RunFolderError):
    """The run has finished and has its report, so there is nothing to resume."""


class MissingRunError(RunFolderError):
    """The named folder contains no run, or does not exist."""


class UnusablePathError(RunFolderError):
    """A path can't be written: it exists, its folder does not exist, or permission is missing."""


class MissingPackageError(GyrobenchError, ImportError):
    """An optional package is not installed; the message names the extra that installs it."""
