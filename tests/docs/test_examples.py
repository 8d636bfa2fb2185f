"""What a reader types from the pages works, in the order in which it stands."""

import re
import shutil
import textwrap

import pytest

from gyrobench.bench.procedure.procedure_file import load_procedure
from tests.bench.command_line import gyrobench
from tests.docs.pages import DOCS, ROOT, blocks, pages

#: Pages with commands that a reader types as they stand.
TYPED = [page for page in pages() if any(block.language == "console" for block in blocks(page))]
#: Pages whose commands take less than a second; others run or read a campaign.
SHORT = ("bring_up_a_bench",)
#: Finished runs that commands read, with their seeds.
FINISHED = {"first-001": "1", "second-001": "2", "six_position_fig7-001": "1"}


@pytest.fixture(scope="session")
def finished_runs(made_once):
    """Short campaigns, searched, by their seeds."""

    def make(folder):
        for seed in sorted(set(FINISHED.values())):
            world = ("--station", "quick", "--world", "quick", "--seed", seed, "--out", seed)
            for command in (("run", "quick_campaign", *world), ("close", seed)):
                result = gyrobench(*command, cwd=folder)
                assert result.returncode == 0, (command, result.stderr)

    return made_once("searched-campaigns", make)


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[] if page.stem in SHORT else [pytest.mark.long]) for page in TYPED],
    ids=lambda page: page.stem,
)
def test_the_commands_of_a_page_work_one_after_the_other(page, tmp_path, request):
    typed = "".join(block.text for block in blocks(page) if block.language == "console")
    for name, seed in FINISHED.items():
        if f"runs/{name}" in typed or " runs" in typed:
            finished = request.getfixturevalue("finished_runs")
            shutil.copytree(finished / seed, tmp_path / "runs" / name)
    for block in blocks(page):
        if block.deed == "file":
            (tmp_path / block.name).write_text(block.text, encoding="utf-8")
        elif block.deed == "append":
            with (tmp_path / block.name).open("a", encoding="utf-8") as file:
                file.write(block.text)
        elif block.language == "console":
            for command, *arguments in block.commands():
                assert command == "gyrobench"
                result = gyrobench(*arguments, cwd=tmp_path)
                assert result.returncode == 0, (arguments, result.stdout[-2000:], result.stderr)


def test_the_tutorial_s_hidden_effect_is_found_under_its_name(tmp_path_factory):
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    assert "thermal_hysteresis" in page
    assert "The search names hysteresis" in page


@pytest.mark.long
def test_the_session_of_the_python_page_runs_from_top_to_bottom(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(block.text for block in blocks(DOCS / "python.md") if block.language == "python")
    exec(compile(code, "python.md", "exec"), {})  # noqa: S102 - our own page
    assert "deg/h" in capsys.readouterr().out
    assert (tmp_path / "temperature.png").stat().st_size > 10_000


def test_the_effect_of_the_page_is_one(tmp_path):
    from gyrobench.bench.closure.effects.effect import Effect

    [block] = [block for block in blocks(DOCS / "extend/effect.md") if block.language == "python"]
    names = {}
    exec(compile(block.text, "effect.md", "exec"), names)  # noqa: S102 - our own page
    assert isinstance(names["EFFECT"], Effect)


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.stem)
def test_procedures_shown_on_a_page_are_right(page, tmp_path):
    for number, block in enumerate(blocks(page)):
        if block.language == "yaml" and "\nsteps:" in block.text:
            path = tmp_path / f"{number}.yaml"
            path.write_text(block.text, encoding="utf-8")
            load_procedure(path)


def test_the_step_of_the_page_stands_so_in_the_code():
    page = (DOCS / "extend/step.md").read_text(encoding="utf-8")
    examples = re.findall(r"^   ```python\n(.*?)^   ```$", page, re.MULTILINE | re.DOTALL)
    for example, module in zip(examples, ("procedure/steps.py", "engine/actions.py"), strict=True):
        assert textwrap.dedent(example) in (ROOT / "bench" / module).read_text(encoding="utf-8")
