"""The INS on CAN: any INS that a DBC file describes, read and commanded.

:mod:`can_bus` receives frames, :mod:`dbc_codec` decodes them, :mod:`signal_map` says which signal is
which quantity, :mod:`readout` gives the quantities at given frames, and :mod:`navigation_data` finds the
epochs: live and from the raw log with the same result.
"""

from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.can_bus import FrameBlock, concatenate, open_bus
from gyrobench.drivers.ins.can_ins import CanIns, InsHealth
from gyrobench.drivers.ins.command_map import CommandMap, Compensation, check_commands
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.navigation_data import NavigationData, Temperatures, decode_navigation
from gyrobench.drivers.ins.readout import Alignment, InsMode
from gyrobench.drivers.ins.resolution import ResolutionLimit, resolution_report
from gyrobench.drivers.ins.signal_map import SignalMap, bind_signals, check_signals

__all__ = [
    "Alignment",
    "CanIns",
    "CommandMap",
    "Compensation",
    "DbcCodec",
    "EulerSequence",
    "FrameBlock",
    "InsHealth",
    "InsMode",
    "InsStatus",
    "NavigationData",
    "ResolutionLimit",
    "SignalMap",
    "Temperatures",
    "bind_signals",
    "check_commands",
    "check_signals",
    "concatenate",
    "decode_navigation",
    "load_dbc",
    "open_bus",
    "resolution_report",
]
