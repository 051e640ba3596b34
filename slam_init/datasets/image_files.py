"""Image files, and the sources that are made of them: a list of files with time stamps, or a plain folder of images."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias, cast

import numpy as np

from slam_init.calibration.metadata import TURNS, jpeg_head, photograph_facts, size_remedy
from slam_init.datasets.inertial import InertialSensor, of_sensor
from slam_init.datasets.text import image_times
from slam_init.errors import SourceError, check_type
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import Floats, Floats32, Image, Pairs, evenly_spaced
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory
from slam_init.types.time_stamps import TimeUnit

# -- grey levels of 16 bits ------------------------------------------------------------------------


# A thermal camera, or one with 12 bits, uses a small part of 65 536 grey levels: their upper eight bits may be four
# levels. So the range of the sequence is stretched, for all images alike. It is that of a few of its images and does
# not change: a track would take a change for one of the brightness. What lies beyond becomes black or white.

#: An image as it is stored.
Pixels: TypeAlias = Image | Pairs

#: Number of images that give the range.
SAMPLES = 9

# Percentiles of an image, so that hot and dead pixels do not count.
_TAILS = (0.1, 99.9)
# The range is widened by this share of itself at both ends, for images that were not looked at. The range that was seen
# keeps two thirds of the 256 levels.
_MARGIN = 0.25
_BLACK, _WHITE = 0, 65535


@dataclass(frozen=True)
class GreyLevels:
    """The levels that become black and white."""

    low: int = _BLACK
    high: int = _WHITE

    @classmethod
    def of(cls, images: Iterable[Pixels]) -> GreyLevels:
        """The range of some images. Those of 8 bits, and black and white ones, are no measurement."""
        ranges = [
            np.percentile(seen, _TAILS)
            for image in images
            if image.dtype == np.uint16 and len(seen := image[(image > _BLACK) & (image < _WHITE)])
        ]
        if not ranges:
            return cls()
        low, high = float(np.min(ranges)), float(np.max(ranges))
        # A level of the image is never spread over several: that would add no texture, and amplify the noise.
        margin = max(_MARGIN * (high - low), 0.5 * (255 - (high - low)))
        low = max(round(low - margin), _BLACK)
        return cls(low, min(max(round(high + margin), low + 255), _WHITE))

    @property
    def note(self) -> str:
        """Note for the user."""
        return f"the images have 16 bits: their grey levels {self.low} to {self.high} are stretched to 8 bits"

    def reduced(self, image: Pixels) -> Image:
        """The image with 8 bits; one that has 8 bits is returned as it is."""
        return cast(Image, image if image.dtype == np.uint8 else self._table[image])

    @cached_property
    def _table(self) -> Image:
        levels = np.clip(np.arange(_WHITE + 1), self.low, self.high) - self.low
        return np.round(levels * (255 / (self.high - self.low))).astype(np.uint8)


# -- files -----------------------------------------------------------------------------------------


#: Suffixes of image files, lower case.
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".webp", ".jp2"})

#: Most pixels of an image, for example 16384 x 8192. A coloured image of 16 bits has then 800 MB, decoded.
MAX_PIXELS = 2**27

_ALL_LEVELS = GreyLevels()
_PNG = b"\x89PNG\r\n\x1a\n"

# Largest file of an image: that of an image of MAX_PIXELS without compression, with four channels of 16 bits.
_MAX_BYTES = 8 * MAX_PIXELS


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Make a sort key under which ``img2`` comes before ``img10``."""
    return tuple(
        (0, int(part), part) if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name) if part
    )


def find_by_end(names: Iterable[str], known: Iterable[str]) -> list[list[int]]:
    """Find paths whose folders have another place: for each name the known paths with the longest common end."""
    by_end: dict[str, list[int]] = {}
    for i, path in enumerate(known):
        for end in _ends(path):
            by_end.setdefault(end, []).append(i)
    return [next((by_end[end] for end in _ends(name) if end in by_end), []) for name in names]


def _ends(path: str) -> list[str]:
    """A path, and what is left of it without its first folders."""
    parts = path.split("/")
    return ["/".join(parts[k:]) for k in range(len(parts))]


def list_images(folder: Path) -> list[Path]:
    """List the image files of a folder, without hidden files. What an entry is (a file, a pipe) is not looked up."""
    if names := sorted(_image_names(folder), key=natural_key):
        return [folder / name for name in names]
    raise SourceError(f"{folder}: holds no image")


def _image_names(folder: Path) -> Iterator[str]:
    with os.scandir(folder) as entries:
        for entry in entries:
            suffix = os.path.splitext(entry.name)[1]  # noqa: PTH122 (a Path for each of a million names takes seconds)
            if suffix.lower() in IMAGE_SUFFIXES and not entry.name.startswith("."):
                yield entry.name


def image_folder(folder: Path) -> Path | None:
    """Find the folder of the images: the folder itself, or its subfolder ``images``; None where neither holds one."""
    places = (place for place in (folder, folder / "images") if place.is_dir())
    return next((place for place in places if next(_image_names(place), None) is not None), None)


def read_image(
    path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None, levels: GreyLevels = _ALL_LEVELS
) -> Image:
    """Read one image with 8 bits.

    Shapes: returns (H, W).

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    * ``levels``: Of an image with 16 bits, the levels that become black and white.
    """
    return levels.reduced(read_pixels(path, root))


def read_pixels(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Pixels:
    """Read one image with 8 or 16 bits, as it is stored.

    A transparency channel is dropped, CMYK is converted to BGR. Of a file with several images, or an animated one, the
    first image is read. An EXIF orientation is not applied, since calibrations refer to pixels as stored. Nothing is
    decoded before the size in the header is known to be bounded.

    Shapes: returns (H, W).

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    path = Path(path)
    if root is not None:
        check_inside(path, root)
    return decode_image(str(path), read_regular(path, _MAX_BYTES, "an image", SourceError))


def decode_image(name: str, data: bytes) -> Pixels:
    """Decode the content of an image file; see :func:`read_pixels`.

    Shapes: returns (H, W).
    """
    import cv2

    _check_header(name, data)
    # Decoders fill the missing part of a JPEG with grey and only print a warning. The entropy-coded data of a JPEG
    # cannot hold a marker, so that an intact file has an end marker after its last scan marker.
    is_cut_jpeg = data.startswith(b"\xff\xd8") and data.find(b"\xff\xd9", data.rfind(b"\xff\xda")) < 0
    if is_cut_jpeg or (data.startswith(_PNG) and not _has_whole_chunks(data)):
        raise SourceError(f"{name}: the image is cut off")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        image = None
    if image is None:
        raise SourceError(f"{name}: not a readable image")
    if image.dtype not in (np.uint8, np.uint16):
        raise SourceError(f"{name}: pixels are {image.dtype}; convert the image to 8 or 16 bits")
    if image.ndim == 3:
        image = image[..., :3] if image.shape[2] >= 3 else image[..., 0]
    return cast(Pixels, np.ascontiguousarray(image))


def _has_whole_chunks(png: bytes) -> bool:
    """Whether each chunk of a PNG up to its end lies in the file. For one that states 4 GB OpenCV takes 20 s."""
    at = len(_PNG)
    while at + 12 <= len(png):
        if png[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + int.from_bytes(png[at : at + 4], "big")
    return False


def check_pixels(place: str, width: int, height: int, least: int = 1) -> None:
    """Refuse the size of an image that has none or too many pixels, before any is decoded.

    * ``least``: The shortest side; 0 for a header that may leave the size to the first image.
    """
    if min(width, height) < least or width * height > MAX_PIXELS:
        most = f"at most {MAX_PIXELS / 1e6:.0f} million"
        raise SourceError(f"{place}: {width}x{height} pixels: an image has at least one and {most}: shrink the images")


def _check_header(name: str, data: bytes) -> None:
    """Refuse an image by the size that its header states: a few bytes may state one of 40 GB."""
    from PIL import Image as Pillow

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            width, height = Pillow.open(io.BytesIO(jpeg_head(data) or data)).size
    except Pillow.DecompressionBombError:
        raise SourceError(f"{name}: more than {MAX_PIXELS / 1e6:.0f} million pixels: shrink the images") from None
    except Exception:  # the library raises what its parsers raise, for headers that are broken
        raise SourceError(f"{name}: not a readable image") from None
    check_pixels(name, width, height)


def image_size(path: str | os.PathLike[str], root: str | os.PathLike[str]) -> tuple[int, int]:
    """Read the width and height of an image, in pixels.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    height, width = read_pixels(path, root).shape[:2]
    return width, height


def check_size(
    what: str,
    size: tuple[int, ...],
    expected: tuple[int, int],
    of: str,
    path: Path | None = None,
    otherwise: str = "all sizes must be equal",
) -> None:
    """Check that an image has the expected size.

    * ``of``: Name of the thing that has the expected size, for the message.
    * ``path``: The file of the image, if there is one.
    * ``otherwise``: The remedy where the sizes show no cause.
    """
    if size != expected:
        orientation = 1 if path is None else photograph_facts(path).orientation
        remedy = size_remedy(size, expected, orientation, otherwise)
        raise SourceError(f"{what}: image is {size[0]}x{size[1]}, but {of} is {expected[0]}x{expected[1]}: {remedy}")


def frame_range(length: int, start: int, max_frames: int | None, name: str) -> range:
    """Compute the indices of the requested frames."""
    for what, number in (("start", start), ("max_frames", 1 if max_frames is None else max_frames)):
        check_type(number, (int, np.integer), what, "an integer", SourceError)
    if not 0 <= start < length:
        raise SourceError(f"{name}: start is {start}, but the source has frames 0 to {length - 1}")
    if max_frames is not None and max_frames < 1:
        raise SourceError(f"{name}: max_frames is {max_frames}: it must be at least 1")
    return range(start, length if max_frames is None else min(length, start + max_frames))


def stored_camera(folder: Path, first_image: Path, *names: str) -> Camera | None:
    """Read the calibration of a folder.

    * ``names``: Of the file, by default ``camera.yaml``. The first that exists is read.
    * Returns: None if none exists.
    """
    from slam_init.calibration.files import load_camera

    files = (folder / name for name in names or ("camera.yaml",))
    path = next((file for file in files if file.is_file()), None)
    if path is None:
        return None
    check_inside(path, folder)
    orientation = photograph_facts(first_image, folder).orientation
    return load_camera(path, image_size(first_image, folder), orientation)


@dataclass(frozen=True, eq=False)
class ImageFileSource:
    """A :class:`slam_init.types.frame.Source` over image files."""

    #: name, kind, camera, groundtruth: See :class:`slam_init.types.frame.Source`.
    name: str
    kind: str
    #: One image per frame.
    paths: tuple[Path, ...]
    #: (N,) Strictly increasing.
    timestamps_s: Floats
    camera: Camera | None = None
    groundtruth: Trajectory | None = None
    #: Notes about the files for the user, for example the unit of the time stamps.
    stated_notes: tuple[str, ...] = ()
    #: The folder that no image may lie outside of; None for any.
    root: Path | None = None
    #: Reads the inertial sensor that is fixed to the camera; None for a sequence without one.
    imu: Callable[[], InertialSensor] | None = None
    gyroscope, inertial = of_sensor("gyroscope"), of_sensor("record")
    _seen: set[str] = field(default_factory=set, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know, from the files and from the images that were read."""
        return (*self.stated_notes, *sorted(self._seen))

    @cached_property
    def _levels(self) -> GreyLevels:
        """The grey levels of images with 16 bits, by a few of all images: wherever a run starts, they are the same."""
        chosen = [self.paths[k] for k in evenly_spaced(len(self.paths), SAMPLES).tolist()]
        return GreyLevels.of(read_pixels(path, self.root) for path in chosen if path.is_file())

    @cached_property
    def _sensor(self) -> InertialSensor | None:
        return None if self.imu is None else self.imu()

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order; each file is read when its frame is requested."""
        # Names are relative to the folder that holds all images, as COLMAP requires.
        root = os.path.commonpath({path.parent for path in self.paths})
        expected = (self.camera.width, self.camera.height) if self.camera else None
        of = "the camera"
        for index in frame_range(len(self), start, max_frames, self.name):
            path = self.paths[index]
            pixels, levels = read_pixels(path, self.root), _ALL_LEVELS
            if pixels.dtype == np.uint16:
                levels = self._levels
                self._seen.add(levels.note)
            image = levels.reduced(pixels)
            size = (image.shape[1], image.shape[0])
            if expected is None:
                expected, of = size, f"the first ({path.name})"
            check_size(str(path), size, expected, of, path)
            yield Frame(index, float(self.timestamps_s[index]), os.path.relpath(path, root), image)


# -- a plain folder --------------------------------------------------------------------------------


_AS_STORED = "a calibration has to be that of the images as they are stored"

#: Nominal rate of a video without times.
NOMINAL_RATE_HZ = 30.0
#: Nominal rate of photographs: at the rate of a video, a rolling shutter would be looked for in them.
PHOTO_RATE_HZ = 1.0


def open_folder(folder: Path) -> ImageFileSource:
    """Open a folder of images in natural order of their names; they may lie in its subfolder ``images``.

    * ``folder``: If it holds ``camera.yaml``, this is the calibration.
    """
    paths = list_images(image_folder(folder) or folder)
    timestamps_s, notes = _times(paths, folder)
    if turn := TURNS.get(photograph_facts(paths[0], folder).orientation):
        notes += (f"by their EXIF orientation, which is not applied, the images are to be {turn}: {_AS_STORED}",)
    name, camera = folder.resolve().name, stored_camera(folder, paths[0])
    return ImageFileSource(name, "images", tuple(paths), timestamps_s, camera, stated_notes=notes, root=folder)


def _times(paths: list[Path], root: Path) -> tuple[Floats, tuple[str, ...]]:
    """Time stamps in seconds from the names of the images, else at a nominal rate; and notes on them.

    A name is a time stamp if it is a number with a decimal point, or a whole number of at least 13 digits: a date in
    milliseconds has 13. A shorter whole number is a counter. Names that are no possible time stamps (they do not
    increase, or lie beyond 2^63) are no error, because nobody has said that they are time stamps.
    """
    stems = [path.stem for path in paths]
    stated: TimeUnit | None = None
    if all(re.fullmatch(r"\d+\.\d+", stem, re.ASCII) for stem in stems):
        stated = TimeUnit.SECONDS
    elif all(re.fullmatch(r"[1-9]\d{12,18}", stem, re.ASCII) for stem in stems):
        stated = TimeUnit.NANOSECONDS
    if stated is not None:
        with suppress(SourceError):
            return image_times([float(stem) for stem in stems], stems, stated)
    rate_hz, taken = PHOTO_RATE_HZ, "photographs, one a second, without a rolling shutter"
    if _is_video(paths, root):
        rate_hz = NOMINAL_RATE_HZ
        taken = f"a video of {rate_hz:g} frames a second, since their steps are small and even"
    return np.arange(len(paths)) / rate_hz, (f"the names of the images state no times: they are taken as {taken}",)


def _is_video(paths: list[Path], root: Path) -> bool:
    """Whether images are a video, and no photographs. No image is read where EXIF names the camera."""
    if photograph_facts(paths[0], root).names_camera:
        return False
    try:
        firsts = evenly_spaced(max(len(paths) - 2, 0), _TRIPLES).tolist()
        return _steps_are_even([read_pixels(path, root) for path in paths[k : k + 3]] for k in firsts)
    except SourceError:  # of an image that cannot be read, which is reported when its frame is asked for
        return False


# -- are they a video? -----------------------------------------------------------------------------


# A video moves on as it did: from step to step, the shift of its images changes by 0.1 to 0.9 % of their width (medians
# of eight sequences at 10 to 30 Hz). Between photographs it changes by 3 to 11 % (five sets). Only in a video do the
# steps show how the camera turns while the rows of one image are read.

#: Number of triples of consecutive images that are looked at. With three instead of five, photographs of a fountain
#: are a video.
_TRIPLES = 5
#: Largest change of a shift, as a share of the sides. Between those of videos and those of photographs.
_MOST_CHANGE = 0.02
#: Largest shift: a camera of 60 degrees at 30 Hz turns by 180 degrees in a second. Photographs of a panorama have even
#: steps too, and larger ones.
_MOST_SHIFT = 0.1
# The shift is that of coarse images.
_SIZE = (128, 96)


def _steps_are_even(triples: Iterable[Sequence[Pixels]]) -> bool:
    """Tell whether consecutive images are those of a video.

    * ``triples``: Of consecutive images; without any there is no video.
    """
    import cv2

    window = cv2.createHanningWindow(_SIZE, cv2.CV_32F)
    steps = [step for triple in triples for step in pairwise(map(_coarse, triple))]
    found = [cv2.phaseCorrelate(one, next_one, window)[0] for one, next_one in steps]
    shifts = np.array(found).reshape(-1, 2, 2) / np.array(_SIZE)
    if not len(shifts):
        return False
    largest = np.median(np.linalg.norm(shifts, axis=2).max(axis=1))
    change = np.median(np.linalg.norm(shifts[:, 1] - shifts[:, 0], axis=1))
    return bool(largest <= _MOST_SHIFT and change <= _MOST_CHANGE)


def _coarse(image: Pixels) -> Floats32:
    import cv2

    coarse = np.asarray(cv2.resize(image, _SIZE, interpolation=cv2.INTER_AREA), np.float32)
    return coarse if coarse.ndim == 2 else coarse.mean(axis=2)
