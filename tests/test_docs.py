"""The tutorials run as they stand, every file that a command writes and every name of the reference is documented."""

import dataclasses
import inspect
import pkgutil
import re
import shlex
import subprocess
import tomllib
from contextlib import chdir

import pytest
from makers import maker
from paths import ROOT

from slam_init.cli.main import main, make_parser
from slam_init.config import Config
from slam_init.datasets.layouts import LAYOUTS
from slam_init.output.names import CALIBRATION_FILES, COMPARE_FILES, RUN_FILES
from slam_init.types.reasons import REASONS

pytestmark = pytest.mark.docs

DOCS = ROOT / "docs"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
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


def test_each_measured_table_names_its_command_and_a_commit_of_the_history():
    measured = (DOCS / "results.md").read_text(encoding="utf-8").partition("### Public sequences")[0].splitlines()
    tables = [k for k, line in enumerate(measured) if re.match(r"\|[-:| ]+\|$", line)]
    heads = [re.fullmatch(r"Command: `(?:slam-init|python -m) .+`\. Commit: (\w+)\.", measured[k - 3]) for k in tables]
    assert tables and all(heads), [measured[k - 1] for k, head in zip(tables, heads, strict=True) if not head]
    shallow = git("rev-parse", "--is-shallow-repository")
    if shallow.stdout.strip() != "false":
        pytest.skip("no git, or no whole history")
    unknown = {head[1] for head in heads if git("merge-base", "--is-ancestor", head[1], "HEAD").returncode}
    assert not unknown


def git(*words):
    try:
        return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True)
    except FileNotFoundError:
        return subprocess.CompletedProcess(words, 1, "", "")


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


def test_a_tutorial_names_an_extra_before_the_step_that_needs_it():
    extras = {
        re.match(r"[\w-]+", requirement)[0]: extra
        for extra in ("colmap", "ros", "poselib", "dask")
        for requirement in PROJECT["project"]["optional-dependencies"][extra]
    }
    for page in TUTORIALS:
        text = page.read_text(encoding="utf-8")
        for name, extra in extras.items():
            if step := re.search(rf"^(import|from) {name}\b", text, re.MULTILINE):
                assert f'pip install ".[{extra}]"' in text[: step.start()], (page.name, name)


def test_the_quick_start_tells_what_to_do_without_a_display():
    text = (DOCS / "quick-start.md").read_text(encoding="utf-8")
    after = text[text.index("slam-init view my-run") :]
    assert "Without a display" in after and "--screenshot" in after and "--web" in after


def lines_without_figures(text):
    return [re.sub(r"[-+]?\d[\d.e-]*|\bfirst/?|slam-init-out/?", "#", line) for line in text.strip().splitlines()]


@pytest.mark.slow
def test_the_pages_show_what_the_first_command_prints(tmp_path, monkeypatch, capsys):
    """But for the figures, whose last digits depend on the machine."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", "synth:room", "--out", "first", "--no-overview"]) == 0
    printed = lines_without_figures(capsys.readouterr().out)
    for page in (ROOT / "README.md", DOCS / "tutorials" / "first-map.md", DOCS / "quick-start.md"):
        shown = re.search(r"^initialized after .*?(?=^```)", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        assert shown, page
        lines = lines_without_figures(shown[0])  # all of them, or some
        assert lines == [line for line in printed if line in lines], page


def test_each_tutorial_has_blocks_that_run():
    assert len(TUTORIALS) >= 7
    for page in TUTORIALS:
        assert {language for language, _, _ in blocks(page)} >= {"python"}, page


@pytest.mark.parametrize("name", sorted({*RUN_FILES, *COMPARE_FILES, *CALIBRATION_FILES}))
def test_every_file_of_a_command_is_on_the_page_of_the_files(name):
    text = (DOCS / "reference" / "files.md").read_text(encoding="utf-8")
    assert f"`{name}`" in text or f"`{name.partition('/')[0]}/`" in text


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


def test_every_extra_is_on_the_page_of_the_installation_and_is_installed_in_one_way():
    extras = PROJECT["project"]["optional-dependencies"]
    listed = re.findall(r"^\| (`[^|]*`) \|", (DOCS / "install.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert {name for row in listed for name in re.findall(r"`([\w-]+)`", row)} == set(extras)
    for name, text in pages():
        assert "slam-init[" not in text, name
        assert set(re.findall(r"pip install [-\w ]*[\"']\.\[(\w+)", text)) <= {*extras, "NAME"}, name


def of_this_commit(text):
    """The lines of a page that name no commit: a program of an earlier one may be gone."""
    return "\n".join(line for line in text.splitlines() if "commit" not in line.lower())


def test_each_file_and_each_program_that_a_page_names_is_there():
    for page, text in pages():
        named = re.findall(r"`((?:slam_init|quest|sequences_synth|tests|docs)/[\w./-]+)`", text)
        programs = re.findall(r"python -m (tests\.[a-z_.]*[a-z_])\b", of_this_commit(text))
        for place in [*named, *(program.replace(".", "/") for program in programs)]:
            assert (ROOT / place).exists() or (ROOT / f"{place}.py").exists(), f"{place} on {page}"


def test_no_page_names_a_package_that_is_no_module():
    for name, text in pages():
        assert "-m slam_init" not in text, name
        for program in re.findall(r"python -m (tests\.[\w.]+)", of_this_commit(text)):
            found = ROOT.joinpath(*program.split("."))
            assert "NAME" in program or found.with_suffix(".py").exists() or (found / "__main__.py").exists(), program


def test_the_times_of_the_project_are_on_one_page():
    """Other pages link to it: a time that stands twice is wrong once."""
    time = re.compile(
        r"\b(takes?|took|judges [\w ]+ in) (up to |about |at most )?[\d.]+( to [\d.]+)? (ms|us|s|seconds)\b"
    )
    for name, text in pages():
        assert name == "docs/speed.md" or time.search(text) is None, f"{name}: {time.search(text)[0]}"


CONTRACTS = PROJECT["tool"]["importlinter"]["contracts"]


@pytest.mark.parametrize("package", ["slam_init", "quest"])
def test_contributing_lists_the_layers_in_their_order(package):
    contract = next(one for one in CONTRACTS if one.get("containers") == [package])
    level = {part: k for k, layer in enumerate(contract["layers"]) for part in re.findall(r"\w+", layer)}
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    block = re.search(rf"^{package}\b.*\n((?:^ .*\n)+)", text, re.MULTILINE)[1]
    # The names stand in the first column, which goes on in the next line where a layer has many.
    named = re.findall(r"[a-z_]+", " ".join(line[2:28] for line in block.splitlines()))
    assert set(named) == set(level) - {"__main__", "display"}
    assert [level[name] for name in named] == sorted(level[name] for name in named)


def test_contributing_names_the_importers_of_gtsam():
    contract = next(one for one in CONTRACTS if one.get("forbidden_modules") == ["gtsam"])
    importers = {pair.split(" -> ")[0] for pair in contract["ignore_imports"]}
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    sentence = re.search(r"Only (`slam_init[^.]*\.[^\n]*\n.*?) import gtsam", text, re.DOTALL)[1]
    assert set(re.findall(r"`(slam_init\.[\w.]+)`", sentence)) == importers


def test_the_answers_of_contributing_name_what_their_files_hold():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = text.partition("## Six questions")[2].partition("## ")[0].splitlines()[4:]
    for row in filter(None, rows):
        named = re.findall(r"`([^`]+)`", row)
        files = [ROOT / name for name in named if "/" in name]
        assert files and all(file.exists() for file in files), row
        code = "".join(file.read_text(encoding="utf-8") for file in files if file.suffix == ".py")
        for name in set(named) - {name for name in named if "/" in name}:
            assert re.search(rf"^\s*(def |class )?{name}\b", code, re.MULTILINE), name


def test_the_page_of_the_data_sets_has_every_layout_in_the_order_in_which_they_are_tried():
    table = (DOCS / "datasets.md").read_text(encoding="utf-8")
    assert len(LAYOUTS) >= 7
    rows = re.findall(r"^\| `([\w-]+)`", table, re.MULTILINE)
    assert [kind for kind in rows if kind != "kind"] == [layout.kind for layout in LAYOUTS]


@pytest.fixture(scope="module")
def reference_pages():
    """What makes the pages of the reference."""
    return maker("reference_pages")


@pytest.fixture(scope="module")
def numbers():
    """What makes the page of the numbers that decide."""
    return maker("numbers_page")


def test_the_page_of_the_numbers_is_that_of_the_code(numbers):
    assert numbers.PAGE.read_text(encoding="utf-8") == numbers.page(), "run python docs/make/numbers_page.py"


def test_every_number_of_the_decision_has_a_class_and_no_other_class_is_used(numbers):
    found = [number for file in numbers.files() for number in numbers.numbers(file)]
    assert {number.kind for number in found} == {"", *numbers.CLASSES}
    named = {name for number in found for name in number.names}
    assert {name for more in numbers.MORE.values() for name in more} <= named, "correct MORE of docs/make"
    decide = [number for number in found if number.file.startswith(("slam_init/decision/", numbers.LEVELS))]
    assert [number.names for number in decide if not number.kind] == []
    assert len(decide) > 50 and all(len(number.reason) > 20 for number in found if number.kind)


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
    for key, value in dataclasses.asdict(Config()).items():
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
        described = "".join(str(base.__doc__) for base in thing.__mro__)  # a base has an entry of its own
        described += inspect.getsource(thing) if "Config" in name else ""
        assert [item.name for item in dataclasses.fields(thing) if not re.search(rf"\b{item.name}\b", described)] == []
