"""The two set-up commands of the README, its Python, and the links of the READMEs."""

import re

import cv2
import pytest
from make_video import write_mp4
from paths import ROOT

pytestmark = pytest.mark.docs

COMMANDS = ["python -m pip install . && slam-init run", 'python -m pip install ".[test]" && python -m pytest']


def set_up(text):
    """The commands of the one fenced block below the heading ``Set up``."""
    section = re.search(r"^## Set up\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert section, "no heading '## Set up'"
    blocks = re.findall(r"^```sh\n(.*?)^```$", section[1], re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1, "one fenced sh block below '## Set up'"
    return blocks[0].splitlines()


def test_the_readme_holds_exactly_the_two_commands():
    assert set_up((ROOT / "README.md").read_text(encoding="utf-8")) == COMMANDS


def python_of(readme):
    """The one fenced block of Python in a file."""
    blocks = re.findall(r"^```python\n(.*?)^```$", readme.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    return compile(blocks[0], str(readme), "exec")


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(python_of(ROOT / "README.md"), {})
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
