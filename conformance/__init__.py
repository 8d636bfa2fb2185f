"""Conformance tests of dialects: they run the driver of a table or chamber against its emulator.

    pytest --pyargs gyrobench.conformance --dialect NAME

tests the installed dialects of that name in virtual time; without ``--dialect``, all installed dialects.
"""
