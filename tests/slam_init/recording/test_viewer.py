"""Starting the viewer: what it says where it fails, and that no process is left. A stand-in is the viewer."""

import socket
import time
from types import SimpleNamespace

import pytest
import rerun as rr
from make_map import CAMERAS
from read_recording import column

import slam_init.recording.viewer as viewer_module
from slam_init.errors import OutputError, ViewerError
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.recording.viewer import SPAWN, screenshots, serve, show, viewer_url


@pytest.fixture
def viewer(tmp_path, monkeypatch):
    """Puts a program in the place of the viewer."""

    def put(code):
        (tmp_path / "rerun.py").write_text(code)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")  # two programs of one size in one second are one to python
        monkeypatch.chdir(tmp_path)

    return put


def test_a_viewer_that_does_not_start_is_one_line_with_its_cause(tmp_path, viewer):
    for code, words in (
        ("raise SystemExit('thread panicked: No graphics adapter was found')", "mesa-vulkan-drivers"),
        ("raise SystemExit('something else\\n')", "something else"),
    ):
        viewer(code)
        with pytest.raises(ViewerError, match=words) as raised:
            screenshots(tmp_path / "a.rrd", [-1], "1280x720")
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("end", ["raise SystemExit('out of memory')", "import time; time.sleep(60)"])
def test_a_viewer_that_is_lost_in_between_is_one_line(tmp_path, viewer, end):
    viewer(
        "import socket, sys\nport = int(sys.argv[sys.argv.index('--port') + 1])\n"
        "server = socket.create_server(('127.0.0.1', port))\nserver.accept()[0].close()\n"
        f"server.accept()[0].close()\nserver.close()\n{end}"
    )
    with pytest.raises(ViewerError, match=r"out of memory|took no screenshot.*try again") as raised:
        screenshots(tmp_path / "a.rrd", [-1], "1280x720")
    assert "\n" not in str(raised.value)


LISTENS = """
import socket, sys, time
server = socket.create_server(("127.0.0.1", int(sys.argv[sys.argv.index("--port") + 1])))
time.sleep(60)
"""


class Client:
    """A client of a viewer whose first layouts of a recording of 10 frames move the cursor to the last frame."""

    def __init__(self, moves):
        self.moves, self.time = moves, None

    def open(self, path):
        pass

    def set_time(self, timeline, sequence):
        self.time = sequence

    def take_screenshot(self):
        self.moves -= 1
        self.time = 9 if self.moves >= 0 else self.time
        return bytes([self.time])

    def get_state(self):
        frames = SimpleNamespace(name="frame", start=0, end=9)
        return SimpleNamespace(loading=[], recordings=[SimpleNamespace(timelines=[frames], current_time=self.time)])


def test_each_picture_is_that_of_its_frame_also_where_the_viewer_moves_the_cursor(tmp_path, viewer, monkeypatch):
    viewer(LISTENS)
    monkeypatch.setattr(viewer_module, "_POLL_S", 0.0)
    for moves in range(4):
        monkeypatch.setattr(viewer_module, "_client", lambda port, moves=moves: Client(moves))
        assert screenshots(tmp_path / "a.rrd", [3, 9, 5], "1280x720") == {frame: bytes([frame]) for frame in (3, 9, 5)}
    monkeypatch.setattr(viewer_module, "_PAINT_S", 0.1)
    monkeypatch.setattr(viewer_module, "_client", lambda port: Client(10**9))
    with pytest.raises(ViewerError, match="did not go to frame 3"):
        screenshots(tmp_path / "a.rrd", [3], "1280x720")


@pytest.fixture
def port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def test_a_viewer_that_fails_is_reported_and_one_that_is_closed_is_not(tmp_path, viewer):
    viewer("raise SystemExit(0)")
    show(tmp_path / "a.rrd")
    viewer("raise SystemExit(3)")
    with pytest.raises(ViewerError, match="code 3: try --web"):
        show(tmp_path / "a.rrd")
    with pytest.raises(ViewerError, match="another --port"):
        serve(tmp_path / "a.rrd", 9090)


def test_a_viewer_of_a_file_ends_with_its_block_and_so_do_its_processes(viewer, port):
    viewer(f"import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', {LISTENS!r}, *sys.argv[1:]])")
    with viewer_module._viewer("--port", str(port)):
        assert viewer_module._answers("127.0.0.1", port, 10.0)
    end = time.monotonic() + 10.0
    while viewer_module._answers("127.0.0.1", port):
        assert time.monotonic() < end


def test_a_text_that_is_no_address_and_one_where_nobody_answers_are_refused():
    for text in ("", "viewer", "http://127.0.0.1:9876", "rerun+http://", "rerun+http://[", "rerun+http://h:x"):
        with pytest.raises(OutputError, match="give the address of a viewer"):
            viewer_url(text)
    with pytest.raises(OutputError, match="no viewer answers there"):
        viewer_url("rerun+http://127.0.0.1:1/proxy")


def test_a_viewer_that_does_not_start_is_an_error_and_one_that_runs_is_used(viewer, port, monkeypatch):
    monkeypatch.setattr(viewer_module, "VIEWER_PORT", port)
    viewer("raise SystemExit('no display')")
    with pytest.raises(OutputError, match="the viewer does not start here"):
        viewer_url(SPAWN)
    with socket.create_server(("127.0.0.1", port)):
        assert viewer_url(SPAWN) == f"rerun+http://127.0.0.1:{port}/proxy"


def test_a_recording_goes_to_a_viewer_and_to_its_file(tmp_path, port):
    server = rr.RecordingStream("viewer")  # the server ends with it
    address = rr.serve_grpc(grpc_port=port, recording=server)
    assert viewer_module._answers("127.0.0.1", port, 30.0)  # its thread may listen later than its address is known
    url = viewer_url(address)
    with RerunRecorder(tmp_path / "a.rrd", CAMERAS["pinhole"], "arc", viewer=url) as recorder:
        recorder.frame_time(3.0)
    assert column(tmp_path / "a.rrd", "/stats/time/frame", "Scalars:scalars") == [[3.0]]
