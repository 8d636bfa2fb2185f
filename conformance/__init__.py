"""What every dialect of a table or chamber has to do, as tests that run its driver against its emulator.

    pytest --pyargs gyrobench.conformance --dialect NAME

tests the dialects of that name that installed packages offer, in virtual time; without ``--dialect``
all of them.
"""
