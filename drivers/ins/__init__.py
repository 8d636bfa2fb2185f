"""The INS on CAN: reads and commands any INS that a DBC file describes.

:mod:`can_bus` receives frames in blocks, also from slcan and socketcand adapters; :mod:`read_ahead_bus` reads
other adapters before their buffers overflow; :mod:`dbc_codec` decodes frames; :mod:`signal_map` assigns
signals to quantities; :mod:`readout` reads the quantities at given frames; :mod:`navigation_data` finds the
epochs. Live data and the raw log give the same result.
"""
