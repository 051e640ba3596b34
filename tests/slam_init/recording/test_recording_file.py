"""A recording is complete, or its failure is an error: no hang, no silent loss."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import rerun as rr

from slam_init.errors import OutputError
from slam_init.recording import rerun_recorder
from slam_init.recording.layout import blueprint
from slam_init.recording.rerun_recorder import RecordingFile


@pytest.fixture
def stream():
    return rr.RecordingStream("test", recording_id="1", send_properties=False)


def log(stream, megabytes):
    for frame in range(megabytes):
        stream.set_time("frame", sequence=frame)
        stream.log("noise", rr.Tensor(np.random.default_rng(frame).integers(0, 255, 1 << 20, np.uint8)))


def test_a_disk_that_fails_is_an_error_and_leaves_no_file(tmp_path, stream, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    file = RecordingFile(tmp_path / "a.rrd", stream, blueprint())
    log(stream, 3)
    with monkeypatch.context() as patched, pytest.raises(OutputError, match="No space left on device: make room"):
        patched.setattr(rerun_recorder.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
        file.check()
    monkeypatch.setattr(type(tmp_path), "replace", full)
    with pytest.raises(OutputError, match="No space left on device: make room"):
        file.complete()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_gone_is_an_error_at_the_next_frame_and_a_discarded_one_stays_away(tmp_path, stream):
    file = RecordingFile(tmp_path / "a.rrd", stream, blueprint())
    file.check()
    (tmp_path / "a.partial.rrd").unlink()
    with pytest.raises(OutputError, match="the file is gone"):
        file.check()
    log(stream, 1)
    file.discard()
    file.complete()
    assert list(tmp_path.iterdir()) == []
