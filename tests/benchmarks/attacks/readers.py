"""Attacks on the readers: sources that are no sources, links, hostile sizes, names and tables."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.benchmarks.attacks.attack import Attack, Seen, command, one_line
from tests.benchmarks.attacks.hostile_files import (
    CAMERA,
    encoded,
    folder_of_images,
    huge_png,
    picture,
    tum_folder,
    written,
)

_LINE = "exit code 2, one line that says so"
_WORKS = "works"


def _info(source: str | os.PathLike[str], folder: Path, *words: str) -> Seen:
    """``slam-init info`` has to refuse the source in one line that holds these words."""
    return one_line(command("info", source, folder=folder), 2, "error: ", *words)


def _works(source: str | os.PathLike[str], folder: Path, *words: str) -> Seen:
    """``slam-init info`` has to describe the source, with these words."""
    ended = command("info", source, folder=folder)
    text = " ".join(ended.out.split())
    return Seen(
        ended.code == 0 and not ended.err and all(word in text for word in words), text[:200] or ended.err[:200]
    )


def _image_row(name: str, make: Callable[[Path], object], word: str) -> Attack:
    """The first image of a folder is something else."""

    def run(folder: Path) -> Seen:
        data = folder_of_images(folder / "data", ["1.png", "2.png"])
        make(data / "0.png")
        return _info(data, folder, "0.png", word)

    return Attack("readers", name, _LINE, run)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        os.chdir(path.parent)  # the name of a socket has 107 characters at most
        server.bind(path.name)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2 * 10**12)


def _long_chunk(path: Path) -> None:
    data = encoded(".png")
    path.write_bytes(data[:33] + b"\xff" * 4 + data[37:])


def _outside(path: Path) -> None:
    written(path.parent.parent / "outside" / "0.png", encoded(".png"))
    path.symlink_to(path.parent.parent / "outside" / "0.png")


_IMAGES = (
    _image_row("a named pipe with the name of an image", os.mkfifo, "named pipe"),
    _image_row("a socket with the name of an image", _socket, "socket"),
    _image_row("a link to /dev/zero with the name of an image", lambda path: path.symlink_to("/dev/zero"), "leads out"),
    _image_row("a folder with the name of an image", Path.mkdir, "a folder"),
    _image_row("a dangling link", lambda path: path.symlink_to(path.parent / "none"), "does not exist"),
    _image_row("a link to itself", lambda path: path.symlink_to(path), "back to itself"),
    _image_row("a link to an image of another folder", _outside, "leads out"),
    _image_row(
        "a PNG whose header states 100000x100000",
        lambda path: path.write_bytes(huge_png(100_000, 100_000)),
        "134 million",
    ),
    _image_row(
        "a PNG whose header states 2^31-1 squared",
        lambda path: path.write_bytes(huge_png(2**31 - 1, 2**31 - 1)),
        "134 million",
    ),
    _image_row(
        "a PGM whose header states 100000x100000",
        lambda path: path.write_bytes(b"P5\n100000 100000\n255\n" + bytes(99)),
        "134 million",
    ),
    _image_row("a sparse file of 2 TB", _sparse, "1073 MB"),
    _image_row("an empty image", Path.touch, "not a readable image"),
    _image_row("a text as an image", lambda path: path.write_text("no image\n" * 99), "not a readable image"),
    _image_row("a PNG cut off after its header", lambda path: path.write_bytes(encoded(".png")[:60]), "cut off"),
    _image_row(
        "a JPEG cut off in the middle",
        lambda path: path.write_bytes(encoded(".jpg", picture(0, (480, 640)))[:9000]),
        "cut off",
    ),
    _image_row(
        "a TIFF of floating-point pixels",
        lambda path: path.write_bytes(encoded(".tiff", np.ones((48, 64), np.float32))),
        "float32",
    ),
    _image_row("a PNG with a chunk of 4 GB", _long_chunk, "cut off"),
)


def _image_that_works(name: str, data: Callable[[], bytes], word: str) -> Attack:
    def run(folder: Path) -> Seen:
        source = folder_of_images(folder / "data", ["1.png", "2.png"])
        written(source / "0.png", data())
        return _works(source, folder, "64x48", word)

    return Attack("readers", name, _WORKS, run)


def _deep(channels: int) -> bytes:
    shape = (48, 64) if channels == 1 else (48, 64, channels)
    return encoded(".png", np.random.default_rng(0).integers(0, 65535, shape, dtype=np.uint16))


def _several(suffix: str) -> bytes:
    import cv2

    return bytes(cv2.imencodemulti(suffix, [picture(k) for k in range(3)])[1].tobytes())


def _cmyk() -> bytes:
    """A JPEG of four channels: that of three, with a fourth component of the tables of the first."""
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture(0, (48, 64, 4)), "CMYK").save(buffer, "JPEG")
    return buffer.getvalue()


_WORKING_IMAGES = (
    _image_that_works("an image of 16 bits and three channels", lambda: _deep(3), "colour"),
    _image_that_works("an image of 16 bits and one channel", lambda: _deep(1), "grey"),
    _image_that_works("an image with transparency", lambda: encoded(".png", picture(0, (48, 64, 4))), "colour"),
    _image_that_works("a TIFF of three pages: the first is read", lambda: _several(".tiff"), "colour"),
    _image_that_works("an animated WebP: the first image is read", lambda: _several(".webp"), "colour"),
    _image_that_works("a JPEG of CMYK", _cmyk, "colour"),
)


def _named(name: str, shown: str) -> Callable[[Path], Seen]:
    """A broken image has a hostile name: the message is one plain line."""

    def run(folder: Path) -> Seen:
        data = folder_of_images(folder / "data", ["1.png"])
        (data / os.fsdecode(os.fsencode(name))).write_bytes(b"broken")
        return _info(data, folder, shown)

    return run


def _hostile_folder_name(folder: Path) -> Seen:
    name = "seq\nslam-init: error: forged\x1b[2J\u202e"
    return _works(folder_of_images(folder / name), folder, r"seq\nslam-init: error: forged\x1b[2J\u202e")


def _size_of_another(folder: Path) -> Seen:
    data = folder_of_images(folder / "data")
    written(data / "0.png", encoded(".png", picture(0, (24, 32))))
    return _info(data, folder, "camera.yaml", "64x48", "32x24")


def _changing_size(folder: Path) -> Seen:
    data = folder_of_images(folder / "data")
    written(data / "1.png", encoded(".png", picture(0, (24, 32))))
    return one_line(command("run", data, "--out", folder / "out", "--quiet", folder=folder), 2, "1.png", "32x24")


def _million_files(folder: Path) -> Seen:
    data = folder / "data"
    data.mkdir()
    for index in range(1_000_001):
        os.mknod(data / f"{index}.png")
    return _info(data, folder, "more than 1000000 images")


_NAMES = (
    Attack(
        "readers",
        "an image name with line breaks and a forged message",
        _LINE,
        _named("0\nslam-init: ok\n.png", r"0\nslam-init: ok\n.png"),
    ),
    Attack("readers", "an image name with a right-to-left mark", _LINE, _named("0\u202egnp.png", r"0\u202egnp.png")),
    Attack("readers", "an image name that is no Unicode", _LINE, _named("0\udcff.png", r"0\udcff.png")),
    Attack("readers", "an image name with terminal codes", _LINE, _named("0\x1b[31m.png", r"0\x1b[31m.png")),
    Attack("readers", "a folder whose name forges a message", "works, escaped", _hostile_folder_name),
    Attack("readers", "images of another size than their calibration", _LINE, _size_of_another),
    Attack("readers", "images of changing size", _LINE, _changing_size),
    Attack("readers", "10^6 + 1 images in a folder", _LINE, _million_files, 300.0),
    Attack(
        "readers",
        "the home folder of nobody",
        _LINE,
        lambda folder: _info("~no-such-user/data", folder, "no such file"),
    ),
    Attack("readers", "a device as the source", _LINE, lambda folder: _info("/dev/zero", folder, "device")),
)


def _pipe_as_source(folder: Path) -> Seen:
    os.mkfifo(folder / "video.mp4")
    return _info(folder / "video.mp4", folder, "named pipe")


def _linked_kitti(folder: Path) -> Seen:
    folder_of_images(folder / "elsewhere")
    (folder / "00").mkdir()
    (folder / "00" / "image_0").symlink_to(folder / "elsewhere")
    return _info(folder / "00", folder, "leads out of the folder")


def _named_link(folder: Path) -> Seen:
    folder_of_images(folder / "data")
    (folder / "link").symlink_to(folder / "data")
    return _works(folder / "link", folder, "frames 3")


def _list_that_names(name: str) -> Callable[[Path], Seen]:
    def run(folder: Path) -> Seen:
        written(folder / "secret.png", encoded(".png"))
        data = tum_folder(folder / "data")
        written(data / "rgb.txt", f"0 {name}\n")
        return _info(data, folder, "leads out of the folder")

    return run


def _linked_file(name: str) -> Callable[[Path], Seen]:
    """A file beside the images is a link to one outside."""

    def run(folder: Path) -> Seen:
        data = tum_folder(folder / "data")
        (data / name).unlink(missing_ok=True)
        (data / name).symlink_to(written(folder / "secret", CAMERA))
        return _info(data, folder, name, "leads out of the folder")

    return run


def _pipe_beside(name: str) -> Callable[[Path], Seen]:
    def run(folder: Path) -> Seen:
        data = tum_folder(folder / "data")
        os.mkfifo(data / name)
        return _info(data, folder, name, "named pipe")

    return run


_LINKS = (
    Attack("readers", "a named pipe as a video", _LINE, _pipe_as_source),
    Attack("readers", "a KITTI folder whose image_0 is a link elsewhere", _LINE, _linked_kitti),
    Attack("readers", "the source itself is a link", _WORKS, _named_link),
    Attack("readers", "rgb.txt names ../secret.png", _LINE, _list_that_names("../secret.png")),
    Attack("readers", "rgb.txt names /etc/passwd", _LINE, _list_that_names("/etc/passwd")),
    Attack("readers", "rgb.txt is a link elsewhere", _LINE, _linked_file("rgb.txt")),
    Attack("readers", "camera.yaml is a link elsewhere", _LINE, _linked_file("camera.yaml")),
    Attack("readers", "groundtruth.txt is a link elsewhere", _LINE, _linked_file("groundtruth.txt")),
    Attack("readers", "groundtruth.txt is a named pipe", _LINE, _pipe_beside("groundtruth.txt")),
)

#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (*_IMAGES, *_WORKING_IMAGES, *_NAMES, *_LINKS)
