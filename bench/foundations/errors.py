"""Every error that gyrobench raises on purpose.

::

    GyrobenchError
    ├── DocumentError (ValueError)        a procedure, station, world or DBC file is wrong
    ├── InstrumentError                   something about one instrument
    │   ├── ConnectionFailedError (OSError)   its port can't be opened or went away
    │   ├── NoReplyError (TimeoutError)   it did not answer in time
    │   ├── ReplyError                    it answered something that can't be understood
    │   ├── RefusedError                  it refused
    │   └── FaultError                    it reports a fault: trip, interlock, broken sensor
    ├── InterlockError                    a limit of the station is exceeded, or a value too old
    ├── BenchInUseError                   another process holds the bench or the run folder
    ├── StepTimeoutError (TimeoutError)   a step of the procedure did not end in its time
    ├── InvalidDwellError                 a dwell in progress can't give a result any more
    ├── UnitsLostError                    every unit of a run was dropped
    ├── RunStoppedError                   a command or an answer stops the run
    ├── MeasurementError (ValueError)     measured data that can't give a result
    │   └── SignalMapError                they contradict the signal map or the latitude
    ├── RunFolderError (OSError)          a run folder that can't be written or read
    │   ├── MissingRunError               there is no run where one was named
    │   └── UnusablePathError             a path that was named can't be written, or is in use
    └── MissingPackageError (ImportError) an optional package is not installed

A message says what happened, where, and what to do about it. Kinds that only the engine
distinguishes are in ``bench/engine/interlocks/watch.py`` and ``bench/engine/operator.py``.
"""


class GyrobenchError(Exception):
    """Root of all errors raised on purpose."""


class DocumentError(GyrobenchError, ValueError):
    """A YAML or DBC file is wrong.

    Example scenarios: an unknown key, a temperature outside the station's limits, a signal
    whose unit can't be converted. The message lists every problem with file, line and column.
    """


class InstrumentError(GyrobenchError):
    """Something went wrong with one instrument.

    ``instrument``: which one, as the station file names it ("rate table", "chamber", "INS"). ``message``:
    what happened and what to do; the text of the error has the instrument before it.
    """

    def __init__(self, instrument: str, message: str) -> None:
        super().__init__(f"{instrument}: {message}")
        self.instrument, self.message = instrument, message


class ConnectionFailedError(InstrumentError, OSError):
    """The instrument's port can't be opened, or went away (cable, power, wrong name)."""


class NoReplyError(InstrumentError, TimeoutError):
    """The instrument did not answer within its time."""


class ReplyError(InstrumentError):
    """The instrument's answer can't be understood: wrong CRC, wrong length, not a number."""


class RefusedError(InstrumentError):
    """The instrument understood and refused: exception code, parameter out of range."""


class FaultError(InstrumentError):
    """The instrument reports a fault: rate trip, open interlock, broken sensor."""


class InterlockError(GyrobenchError):
    """A limit of the station is exceeded, or the value to compare with it is missing or too old."""


class BenchInUseError(GyrobenchError):
    """Another process holds the bench or the run folder; the message says which, whose and since when."""


class StepTimeoutError(GyrobenchError, TimeoutError):
    """A step of the procedure did not reach its end in its time."""


class InvalidDwellError(GyrobenchError):
    """A dwell in progress can't give a result any more, as when the INS did not align; it is repeated."""


class UnitsLostError(GyrobenchError):
    """Every unit of a run was dropped."""


class RunStoppedError(GyrobenchError):
    """The run stops: by a command or an answer, or because it was held for too long."""


class MeasurementError(GyrobenchError, ValueError):
    """Measured data that can't give a result: a window too short, gaps, not a number."""


class SignalMapError(MeasurementError):
    """Measured data contradict the station file: its signal map, mounting or latitude."""


class RunFolderError(GyrobenchError, OSError):
    """A run folder can't be written, or what it holds can't be read."""


class RunFinishedError(RunFolderError):
    """The run has finished and has its report: nothing is left to do."""


class MissingRunError(RunFolderError):
    """No run is in the folder that was named, or there is no such folder."""


class UnusablePathError(RunFolderError):
    """A path to write to is taken, in a folder that does not exist, or may not be written."""


class MissingPackageError(GyrobenchError, ImportError):
    """An optional package is not installed; the message names the extra that installs it."""
