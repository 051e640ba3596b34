"""Earlier results stay whole until new ones are, whatever ends the command."""

import os
import signal
from pathlib import Path

import pytest
from written import contents

from slam_init.errors import OutputError
from slam_init.output.folder import OutputFolder

OLD = {"a.txt": b"old", "sub/b.txt": b"old", "gone.txt": b"old", "summary.json": b"old"}
NEW = {"a.txt": b"new", "sub/b.txt": b"new", "sub/c.txt": b"new", "summary.json": b"new"}
TARGETS = {*OLD, *NEW}


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    """The death of a process loses nothing that is not synced, and syncs take most of the time."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


def publish(out, files):
    with OutputFolder(out, "run", TARGETS) as folder:
        for name, content in files.items():
            path = folder.staging / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        folder.publish(list(files), remove=folder.files)


def dying_at(step):
    """Let this process die at its Nth change of a file system, as if it was killed."""
    count = 0

    def counted(function):
        def changed(*arguments, **keywords):
            nonlocal count
            count += 1
            if count == step:
                os._exit(77)
            return function(*arguments, **keywords)

        return changed

    for owner, name in ((Path, "replace"), (Path, "unlink"), (Path, "mkdir"), (Path, "rmdir"), (Path, "write_bytes")):
        setattr(owner, name, counted(getattr(owner, name)))


def died(action, step):
    child = os.fork()
    if child == 0:
        dying_at(step)
        try:
            action()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 77


def test_a_command_that_dies_at_any_step_leaves_the_old_results_or_the_next_command_has_the_new_ones(tmp_path):
    outcomes = []
    for step in range(1, 200):
        out = tmp_path / str(step)
        publish(out, OLD)
        if not died(lambda out=out: publish(out, NEW), step):
            break
        seen = contents(out)
        if "summary.json" in seen:  # a summary says that all is there
            assert seen in (OLD, NEW)
        with OutputFolder(out, "run", TARGETS):
            assert contents(out) in (OLD, NEW)
            outcomes.append(contents(out) == NEW)
        publish(out, OLD)
        assert contents(out) == OLD
        assert set(contents(out, hidden=True)) - set(OLD) == {".slam-init/files.json", ".slam-init/lock"}
    assert outcomes == sorted(outcomes)
    assert 5 < sum(outcomes) < len(outcomes) - 5


def test_a_first_command_that_dies_at_any_step_is_followed_by_another(tmp_path):
    for step in range(1, 200):
        out = tmp_path / str(step)
        dead = died(lambda out=out: publish(out, NEW), step)
        publish(out, OLD)
        assert contents(out) == OLD
        if not dead:
            break
    assert step > 10


@pytest.mark.parametrize("failing", range(1, 30))
def test_a_disk_that_fails_at_any_rename_leaves_the_old_results_or_all_new_ones(tmp_path, monkeypatch, failing):
    publish(tmp_path, OLD)
    replace, count = Path.replace, 0

    def full(self, target):
        nonlocal count
        count += 1
        if count == failing:
            raise OSError(28, "No space left on device")
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full)
        try:
            publish(tmp_path, NEW)
        except OutputError as error:
            assert "No space left on device: make room" in str(error)
            assert contents(tmp_path) == OLD
        else:
            assert count < failing
            assert contents(tmp_path) == NEW
    publish(tmp_path, NEW)
    assert contents(tmp_path) == NEW


def test_a_file_that_appears_in_the_place_of_a_result_is_not_replaced(tmp_path):
    with OutputFolder(tmp_path / "out", "run", TARGETS) as folder:
        (folder.staging / "a.txt").write_bytes(b"new")
        (tmp_path / "out" / "a.txt").write_bytes(b"mine")
        with pytest.raises(OutputError, match="is not a file that slam-init wrote"):
            folder.publish(["a.txt"])
    assert contents(tmp_path / "out") == {"a.txt": b"mine"}


def test_files_that_a_command_writes_in_place_are_its_own(tmp_path):
    with OutputFolder(tmp_path, "run", TARGETS) as folder:
        folder.claim(["a.txt"])
        (tmp_path / "a.txt").write_bytes(b"old")
    publish(tmp_path, NEW)
    assert contents(tmp_path) == NEW


def test_an_interrupt_during_the_renames_comes_after_them(tmp_path, monkeypatch):
    publish(tmp_path, OLD)
    replace = Path.replace

    def interrupted(self, target):
        signal.raise_signal(signal.SIGINT)
        return replace(self, target)

    outside = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with OutputFolder(tmp_path, "run", TARGETS) as folder:
            (folder.staging / "a.txt").write_bytes(b"new")
            monkeypatch.setattr(Path, "replace", interrupted)
            with pytest.raises(KeyboardInterrupt):
                folder.publish(["a.txt"], remove=folder.files)
            monkeypatch.undo()
    finally:
        signal.signal(signal.SIGINT, outside)
    assert contents(tmp_path) == {"a.txt": b"new"}


def test_a_journal_that_names_files_outside_the_folder_is_refused(tmp_path):
    out = tmp_path / "out"
    publish(out, OLD)
    (tmp_path / "mine.txt").write_text("mine")
    journal = '{"put": [], "remove": ["../mine.txt"], "command": "run", "version": "0", "files": []}'
    (out / ".slam-init" / "journal.json").write_text(journal)
    with pytest.raises(OutputError, match="damaged"):
        publish(out, NEW)
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert contents(out) == OLD
