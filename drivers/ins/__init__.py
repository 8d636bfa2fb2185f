"""The INS on CAN: any INS that a DBC file describes, read and commanded.

:mod:`can_bus` receives frames in blocks, also from the bytes of slcan and socketcand;
:mod:`dbc_codec` decodes them, :mod:`signal_map` says which signal is which quantity, :mod:`readout` gives the
quantities at given frames, and :mod:`navigation_data` finds the epochs: live and from the raw log with the
same result.
"""
