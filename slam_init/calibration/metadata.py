"""What a photograph or a video states in its metadata: the focal length, and how it is to be turned.

Two statements lead to pixels, for an image of ``W`` pixels along its longer side and ``D`` along its diagonal:

35-mm equivalent
    ``F`` mm on a film of 36 x 24 mm show the same. By the definition (CIPA DCG-001) "the same" is the diagonal,
    ``f = F D / 43.27``; some makers compare widths, ``f = F W / 36``. For images of 3:2 both are equal, for 4:3 they
    differ by 4 %. The mean of both is taken.
resolution of the focal plane
    The focal length in mm times the stated number of sensor pixels per mm.

The standard deviation has these parts, each that of a uniform distribution or half of a difference:

* A focal length is nominal. Makers state a customary value within 5 % of the true one: 2.9 %.
* 35-mm equivalents are whole millimetres: 0.29 mm, 1.1 % of 26 mm.
* Diagonal or width: half of the difference, 2 % for 4:3.
* Videos: the statement is that of the lens for photographs of 3:2 or 4:3. A video of 16:9 uses the whole width of the
  sensor or less: electronic stabilization cuts off up to a fifth, which lengthens the focal length in pixels by a
  factor from 1 to 1.25. Its mean is taken, with 6.4 %.

If two statements of one file differ by more than three standard deviations, one of them is wrong, and nobody knows
which: the difference becomes the standard deviation.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside, open_regular

#: A focal length in pixels, with the relative standard deviation of what is known besides the nominal value.
_Statement: TypeAlias = tuple[float, float]

_JPEG = b"\xff\xd8"
#: The size, the tags, depth maps and profiles of colours are before the pixels of a JPEG, in so many bytes.
_JPEG_HEADER = 4_000_000
#: Width and diagonal of 35-mm film.
_FILM_WIDTH_MM, _FILM_DIAGONAL_MM = 36.0, math.hypot(36.0, 24.0)
#: Standard deviation of a uniform distribution over an interval of length 1.
_UNIFORM = 1 / math.sqrt(12)
#: A nominal focal length may be off by 5 % in each direction.
_NOMINAL = 0.10 * _UNIFORM
#: A video shows at least four fifths of what a photograph shows along its longer side.
_LARGEST_CROP = 1.25
#: Sensors have 3:2 or 4:3, whatever the format of a video.
_SENSOR_ASPECTS = (3 / 2, 4 / 3)
#: Statements that differ by more standard deviations contradict each other.
_CONTRADICTION = 3.0
#: Focal lengths over the longer side: from a fisheye lens to a telescope. Others are errors of the file.
_RANGE = (0.2, 30.0)
#: Two sizes have the same aspect ratio if it differs by less: sizes are rounded to 8 or 16 pixels.
_ASPECT_TOLERANCE = 0.02
#: Two photographs of a folder have the same focal length if it differs by less.
_SAME_ZOOM = 0.01

_IMAGE_FORMATS = ("JPEG", "TIFF", "PNG", "WEBP")

# Numbers of EXIF tags.
_MAKE, _MODEL, _ORIENTATION, _EXIF_IFD = 0x010F, 0x0110, 0x0112, 0x8769
_FOCAL_MM, _WIDTH, _HEIGHT = 0x920A, 0xA002, 0xA003
_PLANE_X, _PLANE_UNIT = 0xA20E, 0xA210
_ZOOM, _FOCAL_35MM = 0xA404, 0xA405
#: Millimetres of a unit of the focal plane's resolution, by its number in EXIF.
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}

_VIDEO_FOCAL = "com.apple.quicktime.camera.focal_length.35mm_equivalent"


class MetadataFocal(NamedTuple):
    """A focal length from metadata."""

    #: In pixels of the image.
    focal_px: float
    #: Its standard deviation.
    sigma_px: float


def focal_from_metadata(paths: Sequence[Path], size: tuple[int, int], root: Path | None = None) -> MetadataFocal | None:
    """Read the focal length that a video or photographs state.

    * ``paths``: A video, or photographs (JPEG, TIFF, PNG or WebP), of which the first and the last are read.
    * ``size``: Width and height of the images that are used, in pixels. They may have been resized, and turned.
    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    * Returns: None where the metadata state no focal length, where the images were cut to another format, or where the
      first and the last photograph have different ones (a zoom).
    """
    first = _of_file(paths[0], size, root)
    last = first if len(paths) == 1 else _of_file(paths[-1], size, root)
    if first is None or last is None:
        return None
    return first if abs(first.focal_px - last.focal_px) <= _SAME_ZOOM * first.focal_px else None


def _of_file(path: Path, size: tuple[int, int], root: Path | None) -> MetadataFocal | None:
    tags = _exif(path, root)
    if tags is not None:
        return _best(_statements(tags, size), size)
    stated = re.match(r"\s*([0-9.]+)", _video_tags(path).get(_VIDEO_FOCAL, ""))
    film_mm = _number(stated[1] if stated else None)
    return None if film_mm is None else _best([_video_statement(film_mm, size)], size)


def _best(found: Iterable[_Statement], size: tuple[int, int]) -> MetadataFocal | None:
    """The surest of several statements; less sure where they contradict each other."""
    least, most = (limit * max(size) for limit in _RANGE)
    possible = [(focal_px, sigma) for focal_px, sigma in found if least <= focal_px <= most]
    if not possible:
        return None
    best_px, best_sigma = min(possible, key=lambda one: one[1])
    sigma_px = math.hypot(best_sigma, _NOMINAL) * best_px
    for other_px, sigma in possible:
        # Both have the same nominal focal length, so its error is no part of their difference.
        if abs(other_px - best_px) > _CONTRADICTION * math.hypot(best_sigma, sigma) * best_px:
            sigma_px = max(sigma_px, abs(other_px - best_px))
    return MetadataFocal(best_px, sigma_px)


# -- photographs -----------------------------------------------------------------------------------


def jpeg_head(data: bytes) -> bytes | None:
    """The part of a JPEG that is before its pixels; None for other images.

    A JPEG may have fill bytes before each marker, which Pillow reads one by one: 30 MB of them take more than a minute.
    """
    if not data.startswith(_JPEG):
        return None
    # One fill byte is left before the first marker, which stands for the marker's own.
    return _JPEG + b"\xff" + data[len(_JPEG) : _JPEG_HEADER].lstrip(b"\xff")


def _exif(path: Path, root: Path | None) -> dict[int, Any] | None:
    """The EXIF tags of a photograph; None if the file is no photograph."""
    from PIL import Image, UnidentifiedImageError

    if root is not None:
        check_inside(path, root)
    with open_regular(path, SourceError) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns about broken tags and large images; no pixel is decoded here
        try:
            head = jpeg_head(file.read(_JPEG_HEADER))
            file.seek(0)
            with Image.open(file if head is None else io.BytesIO(head), formats=_IMAGE_FORMATS) as image:
                exif = image.getexif()
                return {**exif, **exif.get_ifd(_EXIF_IFD)}
        except UnidentifiedImageError:
            return None
        except Exception:  # Pillow raises what its parsers raise, for files that are broken
            return {}


class PhotographFacts(NamedTuple):
    """What EXIF states of a photograph besides its focal length; the defaults where it states nothing."""

    #: From 1 (upright) to 8.
    orientation: int = 1
    #: Whether maker or model of the camera are stated.
    names_camera: bool = False


def photograph_facts(path: Path, root: Path | None = None) -> PhotographFacts:
    """Read what EXIF states of an image. One that cannot be read states nothing: the error comes where it is decoded.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    with suppress(SourceError):
        tags = _exif(path, root) or {}
        stated = tags.get(_ORIENTATION)
        orientation = stated if isinstance(stated, int) and 1 <= stated <= 8 else 1
        return PhotographFacts(orientation, bool(_text(tags.get(_MAKE)) or _text(tags.get(_MODEL))))
    return PhotographFacts()


def _statements(tags: Mapping[int, Any], size: tuple[int, int]) -> Iterator[_Statement]:
    width, height, scale = _number(tags.get(_WIDTH)), _number(tags.get(_HEIGHT)), 1.0
    if width is not None and height is not None:
        longer, shorter = max(width, height), min(width, height)
        if abs(longer / shorter * min(size) / max(size) - 1) > _ASPECT_TOLERANCE:
            return  # the image was cut, nobody knows where
        scale = max(size) / longer
    if (film_mm := _number(tags.get(_FOCAL_35MM))) is not None:
        yield _film_statement(film_mm, size)
    focal_mm, plane = _number(tags.get(_FOCAL_MM)), _number(tags.get(_PLANE_X))
    unit_mm = _UNIT_MM.get(int(_number(tags.get(_PLANE_UNIT)) or 2))
    if focal_mm is not None and plane is not None and unit_mm is not None and width is not None:
        zoom = max(1.0, _number(tags.get(_ZOOM)) or 1.0)
        yield focal_mm * zoom * plane / unit_mm * scale, 0.01


def _film_statement(film_mm: float, size: tuple[int, int]) -> _Statement:
    by_diagonal = film_mm * math.hypot(*size) / _FILM_DIAGONAL_MM
    by_width = film_mm * max(size) / _FILM_WIDTH_MM
    mean = (by_diagonal + by_width) / 2
    return mean, max(math.hypot(_UNIFORM / film_mm, abs(by_diagonal - by_width) / 2 / mean), 0.01)


# -- videos ----------------------------------------------------------------------------------------


def _video_tags(path: Path) -> dict[str, str]:
    """The tags of a video and of its stream of images; empty if the file is no video."""
    import av

    try:
        with open_regular(path, SourceError) as file, av.open(file, mode="r", metadata_errors="replace") as container:
            streams = [stream.metadata for stream in container.streams.video]
            return {key.lower(): value for tags in (*streams, container.metadata) for key, value in tags.items()}
    except (av.error.FFmpegError, ValueError):
        return {}


def _video_statement(film_mm: float, size: tuple[int, int]) -> _Statement:
    width = max(size)
    # The video has the width of a photograph, which has the format of the sensor.
    by_diagonal = [film_mm * math.hypot(width, width / aspect) / _FILM_DIAGONAL_MM for aspect in _SENSOR_ASPECTS]
    mean = sum(by_diagonal) / len(by_diagonal)
    ambiguity = (max(by_diagonal) - min(by_diagonal)) / 2 / mean
    crop = (1 + _LARGEST_CROP) / 2
    crop_sigma = (_LARGEST_CROP - 1) * _UNIFORM / crop
    sigma = math.sqrt((_UNIFORM / film_mm) ** 2 + ambiguity**2 + crop_sigma**2)
    return crop * mean, sigma


# -- untrusted values ------------------------------------------------------------------------------


def _number(value: Any) -> float | None:
    """A positive finite number, or None. Tags may hold texts, tuples, or fractions with the denominator 0."""
    with suppress(TypeError, ValueError, ZeroDivisionError, OverflowError):
        return float(value) if 0 < float(value) < math.inf else None
    return None


def _text(value: Any) -> str:
    """A name; empty where it is none."""
    return value.strip("\0 \t\r\n") if isinstance(value, str) else ""


# -- images of another size than their calibration, or than other images ---------------------------


#: What makes an image of an EXIF orientation upright.
TURNS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "turned by 180 degrees and mirrored",
    5: "turned by 90 degrees and mirrored",
    6: "turned by 90 degrees clockwise",
    7: "turned by 90 degrees and mirrored",
    8: "turned by 90 degrees anticlockwise",
}
_QUARTER_TURNS = (5, 6, 7, 8)


def size_remedy(size: tuple[int, ...], expected: tuple[int, int], orientation: int, otherwise: str) -> str:
    """Name the cause of an unexpected size, and the remedy.

    * ``size, expected``: Width and height.
    * ``orientation``: That of EXIF, 1 for an upright image.
    * ``otherwise``: The remedy where the sizes show no cause.
    """
    width, height = expected
    if size == (height, width):
        if orientation in _QUARTER_TURNS:
            turn = f"by its EXIF orientation, which is not applied, the image is to be {TURNS[orientation]}"
            return f"{turn}: store it so (mogrify -auto-orient), or give the calibration of the images as stored"
        return "one of both is turned by 90 degrees: turn the images, or calibrate them as they are"
    for doubled, places, crop in (
        ((2 * width, height), "side by side", "iw/2:ih:0:0"),
        ((width, 2 * height), "one above the other", "iw:ih/2:0:0"),
    ):
        if size == doubled:
            return f"the image holds two pictures {places}: cut one out (ffmpeg -i IN -vf crop={crop} OUT)"
    return otherwise
