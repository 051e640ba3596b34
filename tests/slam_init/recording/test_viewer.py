"""Starting the viewer: what it says where it fails, and that no process is left. A stand-in is the viewer."""

import socket
import urllib.request
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

import slam_init.recording.viewer as viewer_module
from slam_init.errors import SourceError, ViewerError
from slam_init.recording.viewer import check_recording, screenshots, serve, show

SERVER = """
import sys, http.server
port = int(sys.argv[sys.argv.index("--web-viewer-port") + 1])
assert sys.argv[sys.argv.index("--bind") + 1] == "127.0.0.1"
http.server.HTTPServer(("127.0.0.1", port), http.server.SimpleHTTPRequestHandler).serve_forever()
"""


@pytest.fixture
def viewer(tmp_path, monkeypatch):
    """Puts a program in the place of the viewer."""

    def put(code):
        (tmp_path / "rerun.py").write_text(code)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.chdir(tmp_path)

    return put


def test_a_viewer_that_does_not_start_is_one_line_with_its_cause(tmp_path, viewer):
    for code, words in (
        ("raise SystemExit('thread panicked: No graphics adapter was found')", "mesa-vulkan-drivers"),
        ("raise SystemExit('something else\\n')", "something else"),
        ("import rerun_cli_that_is_missing", "not installed"),
    ):
        viewer(code)
        with pytest.raises(ViewerError, match=words) as raised:
            screenshots(tmp_path / "a.rrd", [-1])
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("end", ["raise SystemExit('out of memory')", "import time; time.sleep(60)"])
def test_a_viewer_that_is_lost_in_between_is_one_line(tmp_path, viewer, end):
    viewer(
        "import socket, sys\nport = int(sys.argv[sys.argv.index('--port') + 1])\n"
        "server = socket.create_server(('127.0.0.1', port))\nserver.accept()[0].close()\n"
        f"server.accept()[0].close()\nserver.close()\n{end}"
    )
    with pytest.raises(ViewerError, match=r"out of memory|took no screenshot.*try again") as raised:
        screenshots(tmp_path / "a.rrd", [-1])
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
        assert screenshots(tmp_path / "a.rrd", [3, 9, 5]) == {frame: bytes([frame]) for frame in (3, 9, 5)}
    monkeypatch.setattr(viewer_module, "_PAINT_S", 0.1)
    monkeypatch.setattr(viewer_module, "_client", lambda port: Client(10**9))
    with pytest.raises(ViewerError, match="did not go to frame 3"):
        screenshots(tmp_path / "a.rrd", [3])


def test_a_window_that_fails_is_told_and_one_that_is_closed_is_not(tmp_path, viewer):
    viewer("raise SystemExit(0)")
    show(tmp_path / "a.rrd")
    viewer("raise SystemExit('no screen')")
    with pytest.raises(ViewerError, match=r"code 1 \(no screen\)"):
        show(tmp_path / "a.rrd")


def test_served_recordings_answer_on_ports_of_their_own_and_their_processes_end_with_the_block(tmp_path, viewer):
    viewer(SERVER)  # it takes its web port alone, as a viewer does that has not opened the others yet
    with serve(tmp_path / "a.rrd") as one, serve(tmp_path / "b.rrd") as two:
        assert one.url.split("%3A")[-1] != two.url.split("%3A")[-1]
        address = urlsplit(one.url)
        assert urllib.request.urlopen(f"http://{address.netloc}/", timeout=10).status == 200
    with socket.socket() as probe:
        probe.settimeout(1)
        assert probe.connect_ex((address.hostname, address.port)) != 0


def test_only_a_recording_is_opened(tmp_path):
    (tmp_path / "good.rrd").write_bytes(b"RRF2 and so on")
    check_recording(tmp_path / "good.rrd")
    for name, content in (("empty", b""), ("text", b"text")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SourceError, match="not a rerun recording"):
            check_recording(tmp_path / name)
    with pytest.raises(SourceError, match="a folder"):
        check_recording(tmp_path)
