"""The tutorials run as they stand, every file that a command writes and every name of the reference is documented."""

import inspect
import pkgutil
import re
import shlex
from contextlib import chdir

import pytest
from makers import maker
from paths import ROOT

from slam_init.cli.main import main

pytestmark = pytest.mark.docs

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


def pages():
    """The pages that people read: names and texts."""
    for page in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "SECURITY.md",
        ROOT / "quest" / "README.md",
        *sorted(DOCS.rglob("*.md")),
    ):
        yield page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")


def of_this_commit(text):
    """The lines of a page that name no commit: a program of an earlier one may be gone."""
    return "\n".join(line for line in text.splitlines() if "commit" not in line.lower())


def test_each_file_and_each_program_that_a_page_names_is_there():
    for page, text in pages():
        named = re.findall(r"`((?:slam_init|quest|sequences_synth|tests|docs)/[\w./-]+)`", text)
        programs = re.findall(r"python -m (tests\.[a-z_.]*[a-z_])\b", of_this_commit(text))
        for place in [*named, *(program.replace(".", "/") for program in programs)]:
            assert (ROOT / place).exists() or (ROOT / f"{place}.py").exists(), f"{place} on {page}"


def test_the_page_of_the_numbers_is_that_of_the_code_and_every_number_of_the_decision_has_a_class():
    numbers = maker("numbers_page")
    assert numbers.PAGE.read_text(encoding="utf-8") == numbers.page(), "run python docs/make/numbers_page.py"
    found = [number for file in numbers.files() for number in numbers.numbers(file)]
    assert {number.kind for number in found} == {"", *numbers.CLASSES}
    named = {name for number in found for name in number.names}
    assert {name for more in numbers.MORE.values() for name in more} <= named, "correct MORE of docs/make"
    decide = [number for number in found if number.file.startswith(("slam_init/decision/", numbers.LEVELS))]
    assert [number.names for number in decide if not number.kind] == []
    assert len(decide) > 50 and all(len(number.reason) > 20 for number in found if number.kind)


def test_the_python_of_all_pages_is_python():
    for page in DOCS.rglob("*.md"):
        for language, line, text in blocks(page):
            if language == "python":
                compile("\n" * line + text, str(page), "exec")


def shown_in_the_reference():
    """The functions and classes that the pages of the reference name, with the members of the classes that they show.

    A page shows all public members of a class, or those of its option ``members``.
    """
    pages = "".join(page.read_text(encoding="utf-8") for page in sorted((DOCS / "reference").glob("*.md")))
    for name, members in re.findall(r"^::: (\S+)$(?:\n    options: { members: (\[.*?\]|false))?", pages, re.MULTILINE):
        thing = pkgutil.resolve_name(name)
        if inspect.ismodule(thing):
            continue
        yield name
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                shown = not member.startswith("_") and (not members or member in re.findall(r"\w+", members))
                if shown and inspect.isroutine(getattr(value, "__func__", value)):
                    yield f"{name}.{member}"


def test_the_docstrings_of_the_reference_describe_parameters_and_results():
    pytest.importorskip("numpydoc")
    from numpydoc.validate import validate

    for name in shown_in_the_reference():
        checks = ["GL03", "GL06", "GL07", "GL08", "SS01", "SS03"]
        if not inspect.isclass(pkgutil.resolve_name(name)):
            checks += ["PR01", "PR02", "PR03", "PR04", "RT01", "RT04", "YD01"]
        assert [error for error in validate(name)["errors"] if error[0] in checks] == [], name
