"""Mutated files of every kind that gyrobench reads, given to the code that reads them.

``python -m tests.fuzz --count 10000 --seed 0`` prints a table: inputs, refused, accepted, problems.
Every input is either refused with an error of :mod:`gyrobench.bench.foundations.errors` that names the file,
or accepted with
a result that an independent reading confirms. Anything else is a problem: another exception, a warning,
a hang, memory beyond the limit, something written outside the input's own folder, a process or a
connection started.

:mod:`.mutations` damages a file, :mod:`.targets` gives it to the code under test and checks the result,
:mod:`.sandbox` watches, and ``__main__`` runs it all in processes of limited memory.
"""
