"""A command writes to a folder that is new, empty or its own, and to no other."""

import json

import pytest
from written import contents

from slam_init.errors import OutputError
from slam_init.output.folder import OutputFolder, check_folder

FILES = ("a.txt", "sub/b.txt", "summary.json")


def fill(out, text="1", names=FILES, command="run"):
    with OutputFolder(out, command, FILES) as folder:
        for name in names:
            path = folder.staging / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        folder.publish(names, remove=folder.files)


def test_a_new_an_empty_and_an_own_folder_are_taken(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/below"):
        for text in ("1", "2"):
            fill(tmp_path / name, text)
            assert contents(tmp_path / name) == dict.fromkeys(FILES, text.encode())


def test_a_folder_that_received_nothing_is_as_before(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/below"):
        with pytest.raises(ZeroDivisionError), OutputFolder(tmp_path / name, "run", FILES) as folder:
            (folder.staging / "a.txt").write_text("unfinished")
            raise ZeroDivisionError
    assert list(tmp_path.rglob("*")) == [tmp_path / "empty"]


@pytest.mark.parametrize("name", ["notes.md", "summary.json", "a.txt", "deep/er/file", ".hidden"])
def test_a_folder_with_files_of_others_is_refused_and_not_changed(tmp_path, name):
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("{}")
    with pytest.raises(OutputError, match="not empty"):
        fill(tmp_path)
    assert contents(tmp_path, hidden=True) == {name: b"{}"}


def test_files_of_others_stay_in_an_own_folder(tmp_path):
    fill(tmp_path)
    (tmp_path / "sub" / "mine.txt").write_text("mine")
    (tmp_path / "notes.md").write_text("mine")
    fill(tmp_path, "2", ("summary.json",))
    assert contents(tmp_path) == {"summary.json": b"2", "sub/mine.txt": b"mine", "notes.md": b"mine"}


def test_results_of_another_command_are_refused(tmp_path):
    fill(tmp_path)
    with pytest.raises(OutputError, match="holds results of slam-init run"):
        fill(tmp_path, command="compare")


@pytest.mark.parametrize("kind", ["link to a folder", "link to a file", "file"])
def test_results_are_not_written_through_links(tmp_path, kind):
    out, outside = tmp_path / "out", tmp_path / "outside"
    fill(out, names=("summary.json",))
    outside.mkdir()
    (outside / "b.txt").write_text("mine")
    if kind == "file":
        (out / "sub").write_text("mine")
    elif kind == "link to a folder":
        (out / "sub").symlink_to(outside)
    else:
        (out / "a.txt").symlink_to(outside / "b.txt")
    with pytest.raises(OutputError, match="give another --out"):
        fill(out, "2")
    assert contents(outside) == {"b.txt": b"mine"}
    assert (out / "summary.json").read_text() == "1"


def test_a_result_that_became_a_link_is_replaced_and_its_aim_is_not(tmp_path):
    fill(tmp_path / "out")
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "out" / "a.txt").unlink()
    (tmp_path / "out" / "a.txt").symlink_to(tmp_path / "mine.txt")
    fill(tmp_path / "out", "2")
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert not (tmp_path / "out" / "a.txt").is_symlink()


@pytest.mark.parametrize(
    "name", ["../mine.txt", "/mine.txt", "sub/../../mine.txt", "", ".", 3, "a\0", ".slam-init/lock"]
)
def test_a_marker_that_lists_files_outside_its_folder_is_refused(tmp_path, name):
    out = tmp_path / "out"
    (tmp_path / "mine.txt").write_text("mine")
    fill(out)
    marker = out / ".slam-init" / "files.json"
    marker.write_text(json.dumps(json.loads(marker.read_text()) | {"files": [name]}))
    with pytest.raises(OutputError, match="damaged"):
        fill(out, "2")
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("text", ['{"sch', 100_000 * "[", ""])
def test_a_marker_that_is_damaged_is_refused(tmp_path, text):
    out = tmp_path / "out"
    fill(out)
    (out / ".slam-init" / "files.json").write_text(text)
    before = contents(out, hidden=True)
    with pytest.raises(OutputError, match="damaged"):
        fill(out)
    assert contents(out, hidden=True) == before


def test_a_hidden_folder_that_is_a_link_is_refused(tmp_path):
    fill(tmp_path / "other")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".slam-init").symlink_to(tmp_path / "other" / ".slam-init")
    with pytest.raises(OutputError, match="is not a folder of slam-init"):
        fill(tmp_path / "out")


def test_an_input_is_no_target(tmp_path):
    fill(tmp_path / "out")
    (tmp_path / "link").symlink_to(tmp_path / "out" / "a.txt")
    for given in (tmp_path / "out" / "a.txt", tmp_path / "link"):
        with pytest.raises(OutputError, match="results would replace"):
            check_folder(tmp_path / "out", "run", FILES, [given])
    for given in (tmp_path / "out", tmp_path / "out" / "sub"):
        with pytest.raises(OutputError, match="folder of the data"):
            check_folder(tmp_path / "out", "run", FILES, [given])
    check_folder(tmp_path / "out", "run", FILES, [tmp_path, "synth:room", "a\0b"])


RUN_SUMMARY = {"schema": 2, "method": "quest", "seed": 0, "camera": {}, "attempts": [], "frames_read": 2}
COMPARE_SUMMARY = {"schema": 4, "seed": 0, "trials": 1, "methods": [], "sources": [], "parts": {}}
TRIALS = json.dumps({"schema": 2, "seed": 0, "limit_frames": 150, "limit_s": 5.0, "options": {}}) + "\n"


@pytest.mark.parametrize(
    ("command", "files"),
    [
        ("run", {"summary.json": json.dumps(RUN_SUMMARY), "recording.rrd": "", "colmap/images.txt": ""}),
        ("compare", {"summary.json": json.dumps(COMPARE_SUMMARY), "trials.jsonl": TRIALS, "recordings/a-0/b.rrd": ""}),
        ("compare", {"trials.jsonl": TRIALS}),
    ],
)
def test_a_folder_of_version_0_1_is_marked(tmp_path, command, files):
    for name, content in (files | {"notes.md": "mine"}).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    assert check_folder(tmp_path, command).files == set(files)
    with pytest.raises(OutputError, match="holds results of"):
        check_folder(tmp_path, "synth")


def test_a_second_command_is_refused_while_the_first_lives(tmp_path):
    with OutputFolder(tmp_path / "out", "run") as folder:
        (folder.staging / "a.txt").write_text("1")
        with pytest.raises(OutputError, match="in use by another slam-init"), OutputFolder(tmp_path / "out", "run"):
            pass
        folder.publish(["a.txt"])
    fill(tmp_path / "out", "2")
