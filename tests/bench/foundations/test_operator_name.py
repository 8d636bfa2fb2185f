import pytest

from gyrobench.bench.foundations.operator_name import TERMINAL, describe_source


@pytest.mark.parametrize(
    ("by", "words"),
    [
        ("SIGINT", "the operator (Ctrl-C)"),
        ("SIGUSR1", "another program (SIGUSR1)"),
        (TERMINAL, "the operator (terminal)"),
        ("anna (SIGTERM)", "anna (gyrobench control)"),
        ("anna (night shift)", "anna (night shift)"),
        ("the guard", "the guard"),
    ],
)
def test_the_source_of_a_command_is_given_in_words(by, words):
    assert describe_source(by) == words
