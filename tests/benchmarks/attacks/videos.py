"""Attacks on the reader of videos: playlists, and containers that lie."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.attacks.attack import Attack, Seen, command, one_line
from tests.benchmarks.attacks.hostile_files import picture, written

_LINE = "exit code 2, one line that says so"


def _video(path: Path, frames: int = 6) -> bytearray:
    """Write a video, and return its bytes."""
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for seed in range(frames):
        writer.write(picture(seed))
    writer.release()
    return bytearray(path.read_bytes())


def _lying_header(field: str, value: int) -> Callable[[Path], bytes]:
    """An AVI whose main header and stream header state something else, without an index that tells the truth."""
    places = {"frames": (16, 32), "microseconds a frame": (0, 20), "width": (32, None)}

    def make(path: Path) -> bytes:
        data = _video(path)
        in_main, in_stream = places[field]
        main, stream = data.index(b"avih") + 8, data.index(b"strh") + 8
        data[main + in_main : main + in_main + 4] = value.to_bytes(4, "little")
        if in_stream is not None:
            data[stream + in_stream : stream + in_stream + 4] = value.to_bytes(4, "little")
        if field == "width":
            image = data.index(b"strf") + 8
            data[image + 4 : image + 12] = value.to_bytes(4, "little") * 2
        return bytes(data[: data.rindex(b"idx1")])

    return make


def _told(make: Callable[[Path], bytes], *words: str) -> Callable[[Path], Seen]:
    """The video is read, with these words; no more frames are told than there are."""

    def run(folder: Path) -> Seen:
        path = written(folder / "a.avi", b"")
        path.write_bytes(make(path))
        ended = command("info", path, folder=folder)
        text = " ".join(ended.out.split())
        frames = int(text.split("frames ")[1].split(",")[0].split()[0]) if "frames " in text else 99
        return Seen(
            ended.code == 0 and frames <= 6 and all(word in text for word in words), text[:200] or ended.err[:200]
        )

    return run


def _refused(content: bytes | Callable[[Path], bytes], word: str, name: str = "a.avi") -> Callable[[Path], Seen]:
    def run(folder: Path) -> Seen:
        path = written(folder / name, b"")
        path.write_bytes(content if isinstance(content, bytes) else content(path))
        return one_line(command("info", path, folder=folder), 2, word)

    return run


def _runs(folder: Path) -> Seen:
    """A run reads a video whose length is a lie to its real end."""
    path = written(folder / "a.avi", b"")
    path.write_bytes(_lying_header("frames", 2**31 - 1)(path))
    ended = command("run", path, "--camera", "guess", "--out", folder / "out", folder=folder)
    return Seen(ended.code == 3, f"exit code {ended.code}: {' '.join(ended.out.split())[:150]}")


#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    Attack("readers", "a video that states 2^31 frames", "the real number", _told(_lying_header("frames", 2**31 - 1))),
    Attack("readers", "a run on a video that states 2^31 frames", "ends at the real end", _runs),
    Attack("readers", "a video that states no frames", "the real number", _told(_lying_header("frames", 0))),
    Attack(
        "readers", "a video of 60000x60000 by its header", "read as it is, or one line", lambda folder: _either(folder)
    ),
    Attack("readers", "a playlist of other files as a video", _LINE, _refused(b"#EXTM3U\n/etc/passwd\n", "is a text")),
    Attack(
        "readers",
        "a list for FFmpeg as a video",
        _LINE,
        _refused(b"ffconcat version 1.0\nfile /etc/passwd\n", "is a text"),
    ),
    Attack(
        "readers",
        "a description of a network stream as a video",
        _LINE,
        _refused(b"v=0\r\nc=IN IP4 127.0.0.1\r\n", "is a text"),
    ),
    Attack("readers", "an empty video", _LINE, _refused(b"", "not a readable video")),
    Attack("readers", "a video of random bytes", _LINE, _refused(bytes(range(256)) * 99, "not a readable video")),
    Attack(
        "readers",
        "a video cut off in its header",
        _LINE,
        _refused(lambda path: bytes(_video(path)[:200]), "not a readable video"),
    ),
    Attack(
        "readers",
        "a video whose name is a pattern",
        _LINE,
        _refused(lambda path: bytes(_video(path)), "%", "a%03d.avi"),
    ),
)


def _either(folder: Path) -> Seen:
    path = written(folder / "a.avi", b"")
    path.write_bytes(_lying_header("width", 60_000)(path))
    ended = command("info", path, folder=folder)
    if ended.code == 0:
        return Seen("64x48" in ended.out, " ".join(ended.out.split())[:200])
    return one_line(ended, 2, "a.avi")
