"""The reference pages are those that the models and the command line give."""

import re
import subprocess
import sys

from tests.docs.pages import DOCS


def test_the_committed_reference_is_the_generated_one():
    command = [sys.executable, str(DOCS / "make_reference.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_it_reads_as_plain_markdown():
    text = (DOCS / "reference" / "procedure.md").read_text(encoding="utf-8")
    assert "| `procedure` | name: letters, digits, underscore, hyphen | text | required |" in text


def test_commands_show_the_values_of_a_choice_and_no_empty_default():
    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    assert "or lines as in a file. Values: live, lines. | `live` |" in text
    assert "Command to the run. Values: pause, continue, hold, skip, finish, abort. | required |" in text
    assert "| `` |" not in text


def test_keys_that_are_alike_have_one_table_on_their_page():
    for page in ("import_map", "station", "world"):
        text = (DOCS / "reference" / f"{page}.md").read_text()
        tables = [part.partition("\n")[2].strip() for part in text.split("\n**`")[1:]]
        assert len(tables) == len(set(tables)) > 5, page


def test_no_page_has_words_of_the_code_that_made_it():
    for page in (DOCS / "reference").glob("*.md"):
        assert not re.findall(r"<class|:\w+:`|1e\+(?:09|12)", page.read_text(encoding="utf-8")), page
