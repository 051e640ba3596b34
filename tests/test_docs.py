"""The README and the tutorials run as they stand, links lead somewhere, the documents stay within their bounds."""

import ast
import importlib
import inspect
import pkgutil
import re
import shlex
from contextlib import chdir

import cv2
import pytest
from make_video import write_mp4
from makers import maker
from paths import ROOT

from slam_init.cli.main import main, make_parser

pytestmark = pytest.mark.docs

DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def blocks(page):
    """The fenced blocks of Python and of commands, in order: (language, first line, text)."""
    text = page.read_text(encoding="utf-8")
    for block in re.finditer(r"^```(python|sh)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield block[1], text[: block.start(2)].count("\n"), block[2]


def run_command(line, monkeypatch):
    """Run a line of a shell block; ``# exit code N`` at its end states what it should return."""
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
    """The lines of a page that name no program of the history: such a program is gone."""
    return "\n".join(line for line in text.splitlines() if "in the history" not in line)


def test_each_file_and_each_program_that_a_page_names_is_there():
    for page, text in pages():
        named = re.findall(r"`((?:slam_init|quest|sequences_synth|tests|docs)/[\w./-]+)`", text)
        programs = re.findall(r"python -m (tests\.[a-z_.]*[a-z_])\b", of_this_commit(text))
        for place in [*named, *(program.replace(".", "/") for program in programs)]:
            assert (ROOT / place).exists() or (ROOT / f"{place}.py").exists(), f"{place} on {page}"


#: A commit as pages name it.
HEX = re.compile(r"\b(?=[0-9a-f]*[0-9])(?=[0-9a-f]*[a-f])[0-9a-f]{7,8}\b")


def anchors(text):
    """The anchors of the headings of a page, as GitHub and the site make them."""
    plain = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    for heading in re.findall(r"^#+ (.*)$", plain, re.MULTILINE):
        shown = re.sub(r"[^\w\s-]", "", heading.replace("`", ""))
        yield re.sub(r"\s", "-", shown.strip().lower())


def test_each_link_leads_to_a_file_and_to_a_heading_of_it():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for page, text in (*pages(), ("CHANGELOG.md", changelog)):
        plain = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)\)", plain):
            place, _, anchor = target.partition("#")
            if re.match(r"[a-z]+:", target):
                continue
            file = ((ROOT / page).parent / place).resolve() if place else ROOT / page
            assert file.exists(), f"{target} on {page}"
            if anchor and file.suffix == ".md":
                assert anchor in set(anchors(file.read_text(encoding="utf-8"))), f"{target} on {page}"


def test_the_documents_stay_within_their_bounds():
    words = {page: len(text.split()) for page, text in pages() if page.startswith("docs/")}
    assert len(words) <= 30 and sum(words.values()) <= 30_000 and max(words.values()) <= 3_000
    assert words["docs/explanation/risk.md"] <= 2_500 and words["docs/measurements/tried.md"] <= 1_500
    terms = (DOCS / "reference" / "terms.md").read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("| ") for line in terms) - 2 <= 40
    assert 450 <= len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 600


def test_each_measurement_states_command_data_and_commit_and_no_other_page_names_a_commit():
    for page, text in pages():
        if not page.startswith("docs/measurements/"):
            assert HEX.findall(text) == [], page
        elif page != "docs/measurements/tried.md":
            head = r"^\* Command: .+\n\* Data: .+\n\* Commit: [0-9a-f]{8}, 2\d{3}-\d\d-\d\d"
            heads = re.findall(head, text, re.MULTILINE)
            assert heads and len(heads) == text.count("* Commit:"), page


def test_every_number_of_the_decision_is_on_its_page_and_has_a_class():
    numbers = maker("numbers_page")
    page = numbers.page()
    found = [number for file in numbers.files() for number in numbers.numbers(file)]
    assert {number.kind for number in found} == {"", *numbers.CLASSES}
    named = {name for number in found for name in number.names}
    assert all(f"`{name}`" in page for number in found if number.kind for name in number.names)
    assert {name for more in numbers.MORE.values() for name in more} <= named, "correct MORE of docs/make"
    decide = [number for number in found if number.file.startswith(("slam_init/decision/", numbers.LEVELS))]
    assert [number.names for number in decide if not number.kind] == []
    assert len(decide) > 50 and all(len(number.reason) > 20 for number in found if number.kind)


def test_the_python_of_all_pages_is_python_and_imports_what_is_there():
    for page in DOCS.rglob("*.md"):
        for language, line, text in blocks(page):
            if language == "python":
                for node in ast.walk(ast.parse("\n" * line + text, str(page))):
                    if isinstance(node, ast.ImportFrom) and str(node.module).startswith(("slam_init", "quest")):
                        module = importlib.import_module(str(node.module))
                        assert all(hasattr(module, name.name) for name in node.names), f"{node.module} on {page}"


def test_the_commands_of_all_pages_are_commands():
    parser = make_parser()
    for page, text in pages():
        for block in re.findall(r"^```(?:sh|console)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line.removeprefix("$ "), comments=True)
                if words[:1] == ["slam-init"] and "&&" not in words:
                    try:
                        parser.parse_args(words[1:])
                    except SystemExit as end:
                        assert end.code in (0, None), f"{line} on {page}"


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


# -- the READMEs -----------------------------------------------------------------------------------

COMMANDS = ["python -m pip install . && slam-init run", 'python -m pip install ".[test]" && python -m pytest']


def set_up(text):
    """The commands of the one fenced block below the heading ``Set up``."""
    section = re.search(r"^## Set up\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert section, "no heading '## Set up'"
    found = re.findall(r"^```sh\n(.*?)^```$", section[1], re.MULTILINE | re.DOTALL)
    assert len(found) == 1, "one fenced sh block below '## Set up'"
    return found[0].splitlines()


def test_the_readme_holds_exactly_the_two_commands():
    assert set_up((ROOT / "README.md").read_text(encoding="utf-8")) == COMMANDS


def python_of(name):
    """The one fenced block of Python in a file."""
    (code,) = [text for language, _, text in blocks(ROOT / name) if language == "python"]
    return code


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(python_of("README.md"), {})
    printed = capsys.readouterr().out
    assert "initialized after" in printed and re.search(r"^frame 1: static_camera: ", printed, re.MULTILINE)
    assert (tmp_path / "start" / "handover.npz").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["video", "images"])
def test_the_python_of_the_readme_runs_on_frames_without_calibration(kind, tmp_path, monkeypatch, capsys, room):
    frames = [frame.image for frame in room.frames(0, 12)]
    if kind == "video":
        place = write_mp4(tmp_path / "room.mp4", frames)
    else:
        place = tmp_path / "images"
        place.mkdir()
        for k, image in enumerate(frames):
            cv2.imwrite(str(place / f"{k:03d}.png"), image)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(python_of("README.md").replace("synth:room", str(place)), names)
    assert names["initializer"].camera.source in ("prior", "estimated")
    assert "initialized" in capsys.readouterr().out  # or not, where the focal length is not known
    assert names["result"].camera.width == frames[0].shape[1]


def test_the_python_of_the_readme_of_quest_runs(capsys):
    exec(python_of("quest/README.md"), {})
    assert capsys.readouterr().out.startswith("general")
