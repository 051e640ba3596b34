"""The README's two set-up commands, and that the integration script runs these and no others, word for word."""

import os
import re
import shutil
import subprocess

import cv2
import pytest
from make_video import write_mp4
from paths import ROOT

pytestmark = pytest.mark.docs

COMMANDS = ["python -m pip install . && slam-init run", 'python -m pip install ".[test]" && python -m pytest']

#: Stands in for every program that the script may start: notes how it was called, makes what ``-m venv`` would.
STAND_IN = """#!/bin/sh
echo "$(basename "$0")${1:+ $*}" >> "$CALLS"
if [ "$2" = venv ]; then mkdir -p "$3/bin"; : > "$3/bin/activate"; fi
case "$(basename "$0") $*" in $FAILING) exit 1;; esac
"""


def readme_of(*commands):
    lines = "\n".join(commands)
    return f"# slam-init\n\n```sh\nnot run\n```\n\n## Set up\n\n```sh\n{lines}\n```\n\n## Use\n\n```sh\nnot run\n```\n"


def set_up(text):
    """The commands of the one fenced block below the heading ``Set up``."""
    section = re.search(r"^## Set up\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert section, "no heading '## Set up'"
    blocks = re.findall(r"^```sh\n(.*?)^```$", section[1], re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1, "one fenced sh block below '## Set up'"
    return blocks[0].splitlines()


@pytest.fixture
def integrate(tmp_path):
    """Run the script on a README, with stand-ins for all programs: its exit code, and what it called in order."""

    def call(readme, failing=""):
        project = tmp_path / "project"
        for folder in (project / ".ci", tmp_path / "bin", tmp_path / "temporary"):
            folder.mkdir(parents=True)
        shutil.copy(ROOT / ".ci" / "run", project / ".ci" / "run")
        (project / "README.md").write_text(readme, encoding="utf-8")
        for program in ("python", "python3", "slam-init", "ruff", "lint-imports", "git", "mypy", "mkdocs"):
            stand_in = tmp_path / "bin" / program
            stand_in.write_text(STAND_IN)
            stand_in.chmod(0o755)
        calls = tmp_path / "calls"
        calls.touch()
        environment = os.environ | {
            "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
            "TMPDIR": str(tmp_path / "temporary"),
            "CALLS": str(calls),
            "FAILING": failing,
        }
        done = subprocess.run([project / ".ci" / "run"], env=environment, capture_output=True, text=True, check=False)
        assert list((tmp_path / "temporary").iterdir()) == []
        return done.returncode, calls.read_text().splitlines()

    return call


def called_by(command):
    """What a command line calls, as the stand-ins note it."""
    return [part.strip().replace('"', "") for part in command.split("&&")]


def test_the_readme_holds_exactly_the_two_commands():
    assert set_up((ROOT / "README.md").read_text(encoding="utf-8")) == COMMANDS


def test_the_readme_is_read_in_five_minutes():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 1200


def test_the_script_runs_the_two_commands_of_the_readme_and_lint_layers_types_and_documents(integrate):
    code, calls = integrate((ROOT / "README.md").read_text(encoding="utf-8"))
    assert code == 0
    first, second = map(called_by, COMMANDS)
    # The checks run beside the commands, in an environment of their own.
    assert [call for call in calls if call in first + second] == first + second
    assert len({call for call in calls if call.startswith("python3 -m venv ")}) == 2
    assert {"ruff", "lint-imports", "mypy", "mkdocs"} <= {call.split()[0] for call in calls}
    assert [call for call in calls if call.startswith("slam-init")] == first[1:]


def test_the_script_runs_what_the_readme_says_and_not_what_it_said_before(integrate):
    code, calls = integrate(readme_of("slam-init run elsewhere", "python -m pytest -x"))
    assert code == 0
    commands = ["slam-init run elsewhere", "python -m pytest -x", "python -m pytest -m process or docs or slow"]
    assert [call for call in calls if call.startswith(("slam-init", "python -m pytest"))] == commands
    assert not any("not run" in call for call in calls)


@pytest.mark.parametrize("commands", [COMMANDS[:1], [*COMMANDS, "slam-init info"], []])
def test_the_script_refuses_a_readme_with_any_other_number_of_commands(integrate, commands):
    code, calls = integrate(readme_of(*commands))
    assert code != 0
    assert calls == []


@pytest.mark.parametrize(
    "failing",
    ["slam-init run", "python -m pytest", "ruff check .", "lint-imports --no-cache", "mypy ", "mkdocs build*"],
)
def test_the_script_fails_where_a_step_fails(integrate, failing):
    code, _ = integrate(readme_of(*COMMANDS), failing)
    assert code != 0


def python_of(readme):
    """The one fenced block of Python in a file."""
    blocks = re.findall(r"^```python\n(.*?)^```$", readme.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    return compile(blocks[0], str(readme), "exec")


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(python_of(ROOT / "README.md"), {})
    printed = capsys.readouterr().out
    assert "initialized after" in printed and re.search(r"^world_from_cam \(\d+, 4, 4\) points", printed, re.MULTILINE)
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
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    snippet = re.search(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)[1]
    names = {}
    exec(snippet.replace("synth:room", str(place)), names)
    assert names["initializer"].camera.source in ("prior", "estimated")
    assert "initialized" in capsys.readouterr().out  # or not, where the focal length is not known
    assert names["result"].camera.width == frames[0].shape[1]


def test_the_python_of_the_readme_of_quest_runs(capsys):
    exec(python_of(ROOT / "quest" / "README.md"), {})
    assert capsys.readouterr().out.startswith("general")


@pytest.mark.parametrize("readme", ["README.md", "quest/README.md"])
def test_the_links_of_the_readmes_lead_somewhere(readme):
    file = ROOT / readme
    links = re.findall(r"\]\(([^)#\s]+)\)", file.read_text(encoding="utf-8"))
    assert links
    for link in links:
        assert link.startswith("https://") or (file.parent / link).exists(), link
