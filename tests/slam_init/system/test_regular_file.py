"""Only regular files of bounded size are read, and none that a link in a source's folder leads out to."""

import os
import socket

import pytest

from slam_init.errors import SourceError, plain_line
from slam_init.system import regular_file
from slam_init.system.regular_file import check_inside, kind_problem, read_regular, user_path


@pytest.fixture
def others(tmp_path):
    """Paths that are no regular files, by what they are."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(tmp_path / "socket"))  # such names have 107 characters at most
        yield {
            "named pipe": tmp_path / "pipe",
            "folder": tmp_path / "folder",
            "does not exist": tmp_path / "dangling",
            "symbolic links": tmp_path / "circle",
            "socket": tmp_path / "socket",
            "device": "/dev/zero",
        }


@pytest.mark.parametrize("kind", ["named pipe", "folder", "does not exist", "symbolic links", "socket", "device"])
def test_what_is_no_regular_file_is_refused_by_its_kind(others, kind):
    assert kind in kind_problem(others[kind])
    with pytest.raises(SourceError, match=kind):
        read_regular(others[kind], 10, "a table", SourceError)


def test_a_pipe_that_takes_the_place_of_a_file_is_refused_without_a_wait_for_its_writer(others, monkeypatch):
    monkeypatch.setattr(regular_file, "kind_problem", lambda path: None)  # as it was looked up before
    with pytest.raises(SourceError, match="named pipe"):
        read_regular(others["named pipe"], 10, "a table", SourceError)


def test_no_more_is_read_than_the_bound_allows(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"0123456789")
    assert read_regular(path, 10, "a table", SourceError) == b"0123456789"
    with pytest.raises(SourceError, match="not a table"):
        read_regular(path, 9, "a table", SourceError)
    with path.open("wb") as file:
        file.truncate(10**13)  # a sparse file, larger than the memory
    with pytest.raises(SourceError, match="1000 MB"):
        read_regular(path, 10**9, "a table", SourceError)


def test_a_link_is_followed_inside_of_the_folder_and_as_the_folder_itself(tmp_path):
    data, outside = tmp_path / "data", tmp_path / "outside"
    for folder in (data, outside):
        folder.mkdir()
        (folder / "a.png").write_bytes(b"")
    (data / "inside.png").symlink_to(data / "a.png")
    (data / "out.png").symlink_to(outside / "a.png")
    (tmp_path / "named").symlink_to(data)
    for fine in (data / "inside.png", data / "missing.png"):
        check_inside(fine, data)
    check_inside(tmp_path / "named" / "a.png", tmp_path / "named")
    for bad in (data / "out.png", data / ".." / "outside" / "a.png", "/etc/passwd"):
        with pytest.raises(SourceError, match="leads out"):
            check_inside(bad, data)


def test_a_message_is_one_plain_line_whatever_a_name_holds():
    name = "a\nb\r\x1b[2J\u202egnp.exe\udcff\u2028é✓"
    assert str(SourceError(name)) == plain_line(name) == r"a\nb\r\x1b[2J\u202egnp.exe\udcff\u2028é✓"


def test_a_home_of_nobody_stands_for_itself():
    assert str(user_path("~no-such-user-here/data")) == "~no-such-user-here/data"


def test_a_long_message_keeps_its_start_and_its_remedy():
    message = str(SourceError("start" + "x" * 10**6 + "remedy"))
    assert message.startswith("start") and message.endswith("remedy") and len(message) < 10**5
