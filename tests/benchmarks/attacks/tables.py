"""Attacks on the readers by tables, calibrations and configurations."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.attacks.attack import Attack, Seen, command, one_line
from tests.benchmarks.attacks.hostile_files import CAMERA, folder_of_images, tum_folder, written

_LINE = "exit code 2, one line that says so"
_SENSOR = "resolution: [64, 48]\nintrinsics: [60, 60, 31, 23]\nT_BS: {}\n"


def _calibration(content: str | bytes, *words: str, name: str = "camera.yaml") -> Callable[[Path], Seen]:
    """The calibration that the user names."""

    def run(folder: Path) -> Seen:
        data, file = folder_of_images(folder / "data"), written(folder / name, content)
        return one_line(command("info", data, "--camera", file, folder=folder), 2, name, *words)

    return run


def _no_file(make: Callable[[Path], object], word: str, *option: str) -> Callable[[Path], Seen]:
    """A file of an option is no regular file."""

    def run(folder: Path) -> Seen:
        data = folder_of_images(folder / "data")
        make(folder / "file")
        return one_line(command(option[0], data, option[1], folder / "file", folder=folder), 2, "file", word)

    return run


def _table(name: str, content: str | bytes, *words: str) -> Callable[[Path], Seen]:
    """A table of a TUM folder."""

    def run(folder: Path) -> Seen:
        data = tum_folder(folder / "data")
        written(data / name, content)
        return one_line(command("info", data, folder=folder), 2, name, *words)

    return run


def _long_name(folder: Path) -> Seen:
    data = tum_folder(folder / "data")
    written(data / "rgb.txt", "0 " + "x" * 5_000_000)
    ended = command("info", data, folder=folder)
    seen = one_line(ended, 2, "cannot be read")
    return Seen(
        seen.holds and len(ended.err) < 11_000, f"{len(ended.err)} characters: {seen.text[:60]} ... {ended.err[-60:]}"
    )


def _sparse_list(folder: Path) -> Seen:
    data = tum_folder(folder / "data")
    os.truncate(data / "rgb.txt", 10**12)
    return one_line(command("info", data, folder=folder), 2, "rgb.txt", "200 MB")


def _sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 10**9)


def _kitti(name: str, content: str, *words: str) -> Callable[[Path], Seen]:
    def run(folder: Path) -> Seen:
        data = folder / "data"
        folder_of_images(data / "image_0")
        written(data / name, content)
        return one_line(command("info", data, folder=folder), 2, name, *words)

    return run


def _euroc(matrix: str, *words: str) -> Callable[[Path], Seen]:
    def run(folder: Path) -> Seen:
        cam0 = folder / "data" / "mav0" / "cam0"
        folder_of_images(cam0 / "data")
        written(cam0 / "data.csv", "".join(f"{10**18 + 10**7 * i},{i}.png\n" for i in range(3)))
        written(cam0 / "sensor.yaml", _SENSOR.format(matrix))
        return one_line(command("info", folder / "data", folder=folder), 2, "sensor.yaml", *words)

    return run


_ALIASES = "a: &a [x, x, x]\n" + "".join(
    f"{k}: &{k} [*{p}, *{p}, *{p}]\n" for p, k in zip("abcdefgh", "bcdefghi", strict=True)
)
_CALIBRATIONS = (
    (
        "a calibration that runs a command when it is loaded",
        "fx: !!python/object/apply:os.system ['touch owned']\n",
        "refused YAML",
    ),
    ("a calibration of 3^9 aliases", _ALIASES, "aliases"),
    ("a calibration nested 100,000 deep", "K: " + "[" * 100_000, "nested"),
    ("a calibration with two values of fx", CAMERA + "fx: 61\n", "twice"),
    ("a calibration of 10 MB", "fx: 60\n" * 1_400_000, "200 kB"),
    ("a focal length that is NaN", CAMERA.replace("fx: 60", "fx: .nan"), "fx"),
    ("a focal length of 1e999", CAMERA.replace("fx: 60", "fx: 1e999"), "fx"),
    ("an image size of 10^30", CAMERA.replace("width: 64", f"width: {10**30}"), ""),
    ("a calibration with null bytes", CAMERA + "\0", "not a text file"),
)

_FILES = (
    ("a named pipe as a calibration", os.mkfifo, "named pipe", "info", "--camera"),
    ("a link to /dev/zero as a calibration", lambda path: path.symlink_to("/dev/zero"), "device", "info", "--camera"),
    ("a named pipe as a configuration", os.mkfifo, "named pipe", "run", "--config"),
    ("a configuration of 1 GB", _sparse, "200 kB", "run", "--config"),
    ("a configuration nested 10,000 deep", lambda path: path.write_text("a = " + "[" * 10_000), "", "run", "--config"),
)

_TABLES = (
    ("a list of images that is binary", _table("rgb.txt", bytes(range(256)), "not a text file")),
    ("a list of images of 1 TB", _sparse_list),
    ("a list with a name of 5 MB", _long_name),
    ("a true pose whose quaternion is zero", _table("groundtruth.txt", "0 0 0 0 0 0 0 0\n", "not of unit norm")),
    ("a true pose of 1e308", _table("groundtruth.txt", "0 0 0 0 1e308 1e308 1e308 1e308\n", "not of unit norm")),
    ("a KITTI pose of 1e308", _kitti("poses.txt", "1e308 0 0 0 0 1e308 0 0 0 0 1e308 0\n" * 3, "not a rotation")),
    ("a KITTI pose that mirrors", _kitti("poses.txt", "1 0 0 0 0 1 0 0 0 0 -1 0\n" * 3, "not a rotation")),
    ("a KITTI projection that is singular", _kitti("calib.txt", "P0: 60 0 31 0 0 60 23 0 60 0 31 1\n", "P0")),
    ("a KITTI projection of 1e308", _kitti("calib.txt", "P0: 1e308 0 31 0 0 60 23 0 0 0 1e-308 0\n", "P0")),
    ("a EuRoC body_from_cam that is no rotation", _euroc(str([2.0] * 16), "not a rotation")),
    ("a EuRoC body_from_cam of words", _euroc("[a, b]", "T_BS")),
)

#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    *(Attack("readers", name, _LINE, _calibration(content, word)) for name, content, word in _CALIBRATIONS),
    Attack(
        "readers",
        "a COLMAP camera with a huge size",
        _LINE,
        _calibration("1 PINHOLE 1e300 48 1 1 1 1\n", "", name="cameras.txt"),
    ),
    Attack(
        "readers",
        "an XML calibration that is cut off",
        _LINE,
        _calibration("<?xml?><opencv_storage><K>", "", name="camera.xml"),
    ),
    *(Attack("readers", name, _LINE, _no_file(make, word, *option)) for name, make, word, *option in _FILES),
    *(Attack("readers", name, _LINE, run) for name, run in _TABLES),
)
