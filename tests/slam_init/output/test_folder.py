"""A command writes to a folder that is new, empty or its own; the results in it are those of one run, and whole."""

import errno
import json
import os
import signal
import sys

import pytest
from written import contents

from slam_init.errors import OutputError
from slam_init.output import folder as output_folder
from slam_init.output.folder import OutputFolder, chosen_folder

FILES = ("a.txt", "sub/b.txt", "summary.json")


def fill(out, text="1", names=FILES, command="run"):
    with OutputFolder(out, command) as folder:
        folder.write({name: text.encode() for name in names})
        folder.publish("summary.json")


def test_a_new_an_empty_and_an_own_folder_are_taken_and_only_the_new_results_stay(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/below"):
        for text, names in (("1", FILES), ("2", FILES[1:])):
            fill(tmp_path / name, text, names)
            assert contents(tmp_path / name) == dict.fromkeys(names, text.encode())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "new"]


def test_a_folder_that_received_nothing_is_as_before(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/below"):
        with pytest.raises(ZeroDivisionError), OutputFolder(tmp_path / name, "run") as folder:
            folder.write({"a.txt": b"unfinished"})
            raise ZeroDivisionError
    assert list(tmp_path.rglob("*")) == [tmp_path / "empty"]


def test_a_folder_that_holds_anything_of_others_is_refused_and_not_changed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "note").write_text("mine")
    for k, (own, name) in enumerate((own, name) for own in (False, True) for name in ("n.md", "deep/er", ".h", "link")):
        out = tmp_path / str(k)
        if own:
            fill(out)
        place = out / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(tmp_path / "mine") if name == "link" else place.write_text("mine")
        before = contents(out, hidden=True)
        with pytest.raises(OutputError, match=name.partition("/")[0]):
            fill(out, "2")
        assert contents(out, hidden=True) == before
    assert contents(tmp_path / "mine") == {"note": b"mine"}


def test_results_of_another_command_and_a_damaged_marker_are_refused(tmp_path):
    fill(tmp_path / "out")
    with pytest.raises(OutputError, match="holds results of slam-init run"):
        fill(tmp_path / "out", command="synth")
    marker = tmp_path / "out" / ".slam-init" / "files.json"
    for text in ('{"sch', 100_000 * "[", "", "[]", json.dumps({"command": "run", "files": [3]})):
        marker.write_text(text)
        with pytest.raises(OutputError, match="damaged"):
            fill(tmp_path / "out", "2")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / ".slam-init").symlink_to(marker.parent)
    with pytest.raises(OutputError, match="is not a folder of slam-init"):
        fill(tmp_path / "linked")
    assert (tmp_path / "out" / "summary.json").read_text() == "1"


def test_an_input_is_no_target(tmp_path):
    fill(tmp_path / "out")
    (tmp_path / "link").symlink_to(tmp_path / "out" / "a.txt")
    for given, words in (("out/a.txt", "a.txt"), ("link", "link"), ("out", "out"), ("out/sub", "sub")):  # fmt: skip
        with pytest.raises(OutputError, match=f"would replace .*{words}"):
            chosen_folder(str(tmp_path / "out"), "run", [tmp_path / given])
    chosen_folder(str(tmp_path / "out"), "run", [tmp_path, "synth:room", "a\0b"])


def test_a_folder_behind_a_link_is_replaced_and_the_link_stays(tmp_path):
    fill(tmp_path / "out")
    (tmp_path / "latest").symlink_to("out")
    fill(tmp_path / "latest", "2")
    assert (tmp_path / "latest").is_symlink() and (tmp_path / "out" / "a.txt").read_text() == "2"


def killed_at(line, out):
    """Whether a process that replaces the results was killed when it reached a line of the module."""
    if (child := os.fork()) == 0:
        left = [line]

        def trace(frame, event, _):
            if frame.f_code.co_filename != output_folder.__file__:
                return None
            left[0] -= event == "line"
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return trace

        sys.settrace(trace)
        fill(out, "2")
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


@pytest.mark.slow
def test_a_command_that_is_killed_at_any_line_leaves_the_old_results_or_the_new_ones(tmp_path):
    out, line, seen = tmp_path / "out", 1, set()
    fill(out)
    while killed_at(line, out):
        found = contents(out)
        assert found in (dict.fromkeys(FILES, b"1"), dict.fromkeys(FILES, b"2"))
        seen.add(found["a.txt"])
        line += 1
    assert seen == {b"1", b"2"} and line > 50
    fill(out, "3")
    # What killed commands have left beside the folder is gone.
    assert list(tmp_path.iterdir()) == [out] and contents(out) == dict.fromkeys(FILES, b"3")


def test_the_staged_files_of_a_living_command_stay_and_the_last_one_that_ends_has_the_folder(tmp_path):
    with OutputFolder(tmp_path / "out", "run") as folder:
        folder.write({"a.txt": b"1"})
        fill(tmp_path / "out", "2")
        folder.publish()
    assert contents(tmp_path / "out") == {"a.txt": b"1"}


def test_a_full_disk_at_any_file_leaves_the_old_results(tmp_path, monkeypatch):
    out = tmp_path / "out"
    fill(out)
    for step in ("write_bytes", "write_text", "mkdir"):

        def full(*_, **__):
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch, pytest.raises(OutputError, match="make room"):
            patch.setattr(output_folder.Path, step, full)
            fill(out, "2")
        assert contents(out) == dict.fromkeys(FILES, b"1") and list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("why", ["mount", "current"])
def test_a_folder_that_cannot_change_its_place_gets_the_files(tmp_path, monkeypatch, why):
    out = tmp_path / "out"
    fill(out)
    inode = out.stat().st_ino
    if why == "mount":
        monkeypatch.setattr(output_folder.os.path, "ismount", lambda path: path == out)
    else:
        monkeypatch.chdir(out)
    fill(out, "2", FILES[1:])
    assert contents(out) == dict.fromkeys(FILES[1:], b"2")
    assert out.stat().st_ino == inode
    fill(out, "3", FILES[:1])
    assert contents(out) == {"a.txt": b"3"} and not (out / "sub").exists()


def test_a_file_system_without_an_exchange_takes_two_steps_between_which_the_earlier_results_are_whole(
    tmp_path, monkeypatch
):
    out = tmp_path / "out"
    monkeypatch.setattr(output_folder, "_EXCHANGE", 1 << 10)
    for content in "12":
        fill(out, content)
        assert contents(out) == dict.fromkeys(FILES, content.encode()) and list(tmp_path.iterdir()) == [out]
    rename = output_folder.Path.rename

    def killed(path, target):
        if target == out:
            raise KeyboardInterrupt
        return rename(path, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(output_folder.Path, "rename", killed)
        fill(out, "3")
    (earlier,) = tmp_path.glob("earlier-*")
    assert contents(earlier) == dict.fromkeys(FILES, b"2")
    fill(out, "4")
    assert contents(out) == dict.fromkeys(FILES, b"4") and earlier.exists()


def test_one_file_is_kept_beside_earlier_results_or_alone_and_the_next_results_replace_it(tmp_path):
    out = tmp_path / "out"
    for earlier in ({}, dict.fromkeys(FILES, b"2")):
        with OutputFolder(out, "run") as folder:
            folder.write({"interrupted.rrd": b"x", "recording.rrd": b"y"})
            folder.keep("interrupted.rrd")
        assert contents(out) == earlier | {"interrupted.rrd": b"x"}
        fill(out, "2")
        assert contents(out) == dict.fromkeys(FILES, b"2")


def test_a_file_that_a_command_writes_itself_stays_beside_its_results(tmp_path):
    for k in range(2):
        with OutputFolder(tmp_path / "out", "compare", own="trials.jsonl") as folder:
            with (tmp_path / "out" / "trials.jsonl").open("a") as file:
                file.write("x")
            folder.write({f"{k}.html": b""})
            folder.publish()
        assert contents(tmp_path / "out") == {"trials.jsonl": (k + 1) * b"x", f"{k}.html": b""}
