"""The address of a viewer, and a recording that goes to a viewer and to a file."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time

import pytest
import rerun as rr
from process_tree import MARK, left_over, new_mark, processes_with
from read_recording import column

from slam_init.errors import OutputError
from slam_init.recording.layout import blueprint
from slam_init.recording.live_viewer import SPAWN, viewer_url
from slam_init.recording.recording_file import RecordingFile


@pytest.mark.parametrize(
    "text", ["", "viewer", "http://127.0.0.1:9876", "rerun+http://", "rerun+http://[", "rerun+http://h:x"]
)
def test_a_text_that_is_no_address_is_refused(text):
    with pytest.raises(OutputError, match="give the address of a viewer"):
        viewer_url(text)


def test_an_address_where_nobody_answers_is_refused():
    with pytest.raises(OutputError, match="no viewer answers there"):
        viewer_url("rerun+http://127.0.0.1:1/proxy")


def test_a_viewer_that_does_not_start_is_an_error(monkeypatch):
    monkeypatch.setattr("slam_init.recording.live_viewer.VIEWER_PORT", 1)
    monkeypatch.setattr("slam_init.recording.live_viewer.shutil.which", lambda _: "/bin/false")  # as without a display
    with pytest.raises(OutputError, match="the viewer does not start here"):
        viewer_url(SPAWN)


#: Stands in for a viewer: listens on the port that it is given.
LISTENER = """#!/bin/sh
exec "$PYTHON" -c "import socket, sys, time
s = socket.create_server(('127.0.0.1', int(sys.argv[1].split('=')[1])))
time.sleep(100)" "$@"
"""
#: A program that starts a viewer, and then goes on or ends.
USER = """
import os, signal, sys, time
signal.signal(signal.SIGQUIT, signal.SIG_DFL)  # a shell ignores it for what runs in its background
from slam_init.recording import live_viewer
live_viewer.VIEWER_PORT = int(sys.argv[1])
live_viewer.shutil.which = lambda _: sys.argv[2]
live_viewer.viewer_url("spawn")
print("started", flush=True)
if sys.argv[3] == "stay":
    time.sleep(100)
if sys.argv[3] == "end while the guard waits":
    os.kill(live_viewer._viewer.pid, signal.SIGSTOP)
live_viewer.leave_open()
"""


@pytest.fixture
def user(tmp_path):
    """Starts the program, waits for the viewer; returns process and mark. All of its processes end with the test."""
    listener = tmp_path / "viewer"
    listener.write_text(LISTENER)
    listener.chmod(0o755)
    mark = new_mark()

    def start(what):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        words = [sys.executable, "-c", USER, str(port), str(listener), what]
        process = subprocess.Popen(
            words, env=os.environ | {MARK: mark, "PYTHON": sys.executable}, stdout=subprocess.PIPE
        )
        assert process.stdout.readline() == b"started\n"
        return process

    yield start, mark
    for left in processes_with(mark):
        os.kill(left, signal.SIGKILL)


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes by their environment")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGQUIT])
def test_a_viewer_ends_with_the_process_that_was_killed(user, number):
    start, mark = user
    process = start("stay")
    assert len(processes_with(mark)) >= 3  # the program, the guard, the viewer
    process.send_signal(number)
    process.wait(timeout=10)
    assert left_over(mark, within_s=10) == []


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes by their environment")
@pytest.mark.parametrize("what", ["end", "end while the guard waits"])
def test_a_viewer_stays_open_after_a_run_that_ended(user, what):
    start, mark = user
    assert start(what).wait(timeout=10) == 0
    for process in processes_with(mark):  # on a busy machine the guard learns late that it was released
        os.kill(process, signal.SIGCONT)
    time.sleep(1.2)  # the guard asks for its parent twice a second
    assert len(processes_with(mark)) >= 2


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
