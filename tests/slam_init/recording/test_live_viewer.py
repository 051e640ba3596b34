"""The address of a viewer, and a recording that goes to a viewer and to a file."""

from __future__ import annotations

import socket

import pytest
import rerun as rr
from read_recording import column

from slam_init.errors import OutputError
from slam_init.recording import live_viewer
from slam_init.recording.layout import blueprint
from slam_init.recording.live_viewer import SPAWN, viewer_url
from slam_init.recording.recording_file import RecordingFile


def test_a_text_that_is_no_address_and_one_where_nobody_answers_are_refused():
    for text in ("", "viewer", "http://127.0.0.1:9876", "rerun+http://", "rerun+http://[", "rerun+http://h:x"):
        with pytest.raises(OutputError, match="give the address of a viewer"):
            viewer_url(text)
    with pytest.raises(OutputError, match="no viewer answers there"):
        viewer_url("rerun+http://127.0.0.1:1/proxy")


def test_a_viewer_that_does_not_start_is_an_error_and_one_that_runs_is_used(monkeypatch):
    def fails(**_):
        raise RuntimeError("no executable")

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setattr(live_viewer, "VIEWER_PORT", free.getsockname()[1])
        monkeypatch.setattr(live_viewer, "_START_S", 0.1)
        for spawn, words in ((fails, "no executable"), (lambda **_: None, "the viewer does not start here")):
            monkeypatch.setattr(rr, "spawn", spawn)
            with pytest.raises(OutputError, match=words):
                viewer_url(SPAWN)
        free.listen()
        assert viewer_url(SPAWN) == f"rerun+http://127.0.0.1:{free.getsockname()[1]}/proxy"


def test_a_recording_goes_to_a_viewer_and_to_its_file(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = rr.RecordingStream("viewer")
    url = viewer_url(rr.serve_grpc(grpc_port=port, recording=server))
    stream = rr.RecordingStream("test", recording_id="1", send_properties=False)
    file = RecordingFile(tmp_path / "a.rrd", stream, blueprint(), viewer=url)
    stream.log("figure", rr.Scalars(3.0))
    file.complete()
    assert column(tmp_path / "a.rrd", "/figure", "Scalars:scalars") == [[3.0]]
