"""The tutorials run as they stand, and every file that a command writes is documented."""

import re
import shlex
from contextlib import chdir

import pytest
from paths import ROOT

from slam_init.cli.main import main
from slam_init.output.names import COMPARE_FILES, RUN_FILES

DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def blocks(page):
    """The fenced blocks of Python and of commands, in order: (language, first line, text)."""
    text = page.read_text(encoding="utf-8")
    for block in re.finditer(r"^```(python|sh)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield block[1], text[: block.start(2)].count("\n"), block[2]


def run_command(line, monkeypatch):
    """Run a line of a shell block; ``# exit code N`` at its end tells what it should return."""
    words = shlex.split(line, comments=True)
    if words[0] == "PYTHONPATH=.":
        monkeypatch.syspath_prepend(".")
        monkeypatch.setenv("PYTHONPATH", ".")
        del words[0]
    assert words[0] == "slam-init", line
    wanted = re.search(r"# exit code (\d)$", line)
    assert main(words[1:]) == (int(wanted[1]) if wanted else 0), line


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_the_tutorials_run(page, tmp_path, monkeypatch):
    names = {}
    if "import pycolmap" in page.read_text(encoding="utf-8"):
        pytest.importorskip("pycolmap")
    with chdir(tmp_path):
        for language, line, text in blocks(page):
            if language == "python":
                exec(compile("\n" * line + text, str(page), "exec"), names)
            else:
                for command in text.splitlines():
                    run_command(command, monkeypatch)


def test_each_tutorial_has_blocks_that_run():
    assert len(TUTORIALS) >= 7
    for page in TUTORIALS:
        assert {language for language, _, _ in blocks(page)} >= {"python"}, page


@pytest.mark.parametrize("name", [*RUN_FILES, *COMPARE_FILES])
def test_every_file_of_a_command_is_documented(name):
    text = "".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    assert f"`{name}`" in text or f"`{name.partition('/')[0]}/`" in text


def test_the_python_of_all_pages_is_python():
    for page in DOCS.rglob("*.md"):
        for language, line, text in blocks(page):
            if language == "python":
                compile("\n" * line + text, str(page), "exec")
