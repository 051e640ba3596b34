"""The tutorials run as they stand, every file that a command writes and every name of the reference is documented."""

import dataclasses
import importlib.util
import inspect
import pkgutil
import re
import shlex
import tomllib
from contextlib import chdir

import pytest
from paths import ROOT

from slam_init.cli.main import main, make_parser
from slam_init.config import Config, config_toml
from slam_init.output.names import COMPARE_FILES, RUN_FILES
from slam_init.types.reasons import REASONS

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


@pytest.fixture(scope="module")
def reference_pages():
    """What makes the pages of the reference."""
    spec = importlib.util.spec_from_file_location("reference_pages", DOCS / "make" / "reference_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_the_command_line_has_every_option(reference_pages):
    page = reference_pages.command_line()
    assert {"run", "compare", "synth", "info"} <= set(re.findall(r"^## slam-init ([\w-]+)", page, re.MULTILINE))
    for _, command in reference_pages.commands(make_parser()):
        for action in command._actions:
            assert action.dest == "help" or not action.option_strings or action.option_strings[-1] in page
    assert not re.search(r"^\| `[^|]*` \|  \|$", page, re.MULTILINE), "an option without help"


def test_the_page_of_the_options_has_every_option_with_a_reason(reference_pages):
    rows = dict(re.findall(r"^\| `([\w.]+)` \| `[^|]*` \| (.*) \|$", reference_pages.options(), re.MULTILINE))
    wanted = set()
    for key, value in tomllib.loads(config_toml(Config())).items():
        wanted |= {f"{key}.{option}" for option in value} if isinstance(value, dict) else {key}
    assert set(rows) == wanted
    assert all(len(reason) > 20 for reason in rows.values())


def test_the_page_of_the_reasons_has_every_reason_with_its_advice(reference_pages):
    page = reference_pages.reasons()
    assert all(f"| `{reason}` | {reason.advice} |" in page for reason in REASONS)


def test_the_page_of_the_summary_has_every_record(reference_pages):
    page = reference_pages.summary()
    links = set(re.findall(r"\]\(#(\w+)\)", page))
    assert links <= {heading.lower() for heading in re.findall(r"^## (\w+)$", page, re.MULTILINE)}


def test_the_python_of_all_pages_is_python():
    for page in DOCS.rglob("*.md"):
        for language, line, text in blocks(page):
            if language == "python":
                compile("\n" * line + text, str(page), "exec")


def shown_in_the_reference():
    """The functions and classes that the pages of the reference name, with the public members of the classes."""
    pages = "".join(page.read_text(encoding="utf-8") for page in sorted((DOCS / "reference").glob("*.md")))
    for name in re.findall(r"^::: (\S+)$", pages, re.MULTILINE):
        thing = pkgutil.resolve_name(name)
        if inspect.ismodule(thing):
            continue
        yield name
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                if not member.startswith("_") and inspect.isroutine(getattr(value, "__func__", value)):
                    yield f"{name}.{member}"


@pytest.mark.parametrize("name", list(shown_in_the_reference()))
def test_the_docstrings_of_the_reference_describe_parameters_results_and_errors(name):
    pytest.importorskip("numpydoc")
    from numpydoc.validate import validate

    thing = pkgutil.resolve_name(name)
    checks = ["GL03", "GL06", "GL07", "GL08", "SS01", "SS03"]
    if not inspect.isclass(thing):
        checks += ["PR01", "PR02", "PR03", "PR04", "RT01", "RT04", "YD01"]
    assert [error for error in validate(name)["errors"] if error[0] in checks] == []
    if dataclasses.is_dataclass(thing):  # its fields stand below Attributes, or a comment each in a section of options
        described = f"{thing.__doc__}{inspect.getsource(thing)}" if "Config" in name else thing.__doc__
        assert [item.name for item in dataclasses.fields(thing) if not re.search(rf"\b{item.name}\b", described)] == []
