"""What is known of the true size of a scene, and how it is written on the command line.

=========================================  ============================================================
``marker:tag36h11:0.14``                   side of the black square of all markers of this dictionary
``board:9x6:0.025``                        side of the squares of a checkerboard of 9 x 6 inner corners
``height:1.65``, ``height:40,nadir``       the camera above the ground; ``nadir`` for a camera that looks down
``distance:0.25``, ``distance:0.25,10,40``   between the first and the last keyframe, or between two frames
``groundtruth``                            the true trajectory of the source, by a similarity
``imu``                                    the accelerations and rates of an inertial sensor, between the keyframes
=========================================  ============================================================

A length may state its standard deviation, as in ``height:1.65+-0.02``. All lengths are metres.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

from slam_init.errors import ConfigError, check_type
from slam_init.types.scale import ScaleOrigin

_FORMS = (
    "marker:tag36h11:0.14, board:9x6:0.025, height:1.65, height:40,nadir, distance:0.25, distance:0.25,10,40, "
    "groundtruth or imu"
)
#: Lengths outside are in a wrong unit: a marker of 0.1 mm cannot be printed, and no camera is 1000 km above a ground
#: whose landmarks do not look like a plane.
_LENGTHS_M = (1e-4, 1e6)
#: The sub-pixel detector needs three corners a side. Boards of a hundred corners a side are not made.
_BOARD_CORNERS = (3, 100)
#: A frame number has no more digits than this.
_DIGITS = 12


@dataclass(frozen=True)
class KnownLength:
    """A length that somebody measured."""

    metres: float
    #: Its standard deviation in metres; 0 where the length is exact.
    sigma_m: float = 0.0

    def __post_init__(self) -> None:
        least, most = _LENGTHS_M
        if not least <= self.metres <= most:  # also refuses what is not a number
            raise ConfigError(f"length {self.metres!r}: give metres from {least:g} to {most:g}")
        if not 0 <= self.sigma_m < self.metres:
            raise ConfigError(f"standard deviation {self.sigma_m!r} of a length of {self.metres:g} m: give less metres")

    @property
    def relative_sigma(self) -> float:
        """Standard deviation over the length."""
        return self.sigma_m / self.metres


@dataclass(frozen=True)
class KnownMarkers:
    """Square markers, all of one dictionary and size."""

    origin: ClassVar = ScaleOrigin.MARKER

    #: A dictionary of OpenCV: ``tag36h11``, ``tag25h9``, ``4x4_50``, ``DICT_5X5_100``, in upper or lower case.
    dictionary: str
    #: Side of the black square, without the white margin.
    length: KnownLength

    def __str__(self) -> str:
        return f"marker of {self.dictionary[:40]}"


@dataclass(frozen=True)
class KnownBoard:
    """A checkerboard."""

    origin: ClassVar = ScaleOrigin.BOARD

    #: columns, rows: Number of inner corners.
    columns: int
    rows: int
    #: Side of a square.
    length: KnownLength

    def __post_init__(self) -> None:
        least, most = _BOARD_CORNERS
        if not (least <= self.columns <= most and least <= self.rows <= most):
            raise ConfigError(f"{self}: give {least} to {most} in each direction")

    def __str__(self) -> str:
        return f"board of {self.columns}x{self.rows} inner corners"


@dataclass(frozen=True)
class CameraHeight:
    """The height of the camera above the ground, on average over the keyframes."""

    origin: ClassVar = ScaleOrigin.HEIGHT

    length: KnownLength
    #: Whether the camera looks down, so that the ground lies ahead of it. By default the ground lies below it, in the
    #: direction of the lower border of the image.
    nadir: bool = False


@dataclass(frozen=True)
class KnownDistance:
    """The distance between the positions of the camera at two frames."""

    origin: ClassVar = ScaleOrigin.DISTANCE

    length: KnownLength
    #: (int, int) Absolute indices of the frames: keyframes, or frames that were located after the initialization.
    #: None for the first and the last keyframe.
    frames: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.frames is not None and not 0 <= self.frames[0] < self.frames[1]:
            raise ConfigError(f"distance between frames {self.frames[0]} and {self.frames[1]}: give the earlier first")


@dataclass(frozen=True)
class TrueTrajectory:
    """The true trajectory of the source, in metres."""

    origin: ClassVar = ScaleOrigin.GROUNDTRUTH


@dataclass(frozen=True)
class MeasuredMotion:
    """The record of an inertial sensor that is fixed to the camera."""

    origin: ClassVar = ScaleOrigin.IMU


#: Everything that may be known.
ScaleRequest: TypeAlias = KnownMarkers | KnownBoard | CameraHeight | KnownDistance | TrueTrajectory | MeasuredMotion


class NoScaleError(Exception):
    """The map and what came with it do not determine a scale. The text is the reason, for the user."""


def parse_scale(text: str) -> ScaleRequest:
    """Read a request from its text."""
    check_type(text, str, "the scale", f"text: {_FORMS}", ConfigError)
    kind, _, rest = text.strip().partition(":")
    try:
        request = _parsed(kind.lower(), rest)
    except ConfigError as error:
        raise ConfigError(f"--scale {text[:100]!r}: {error}") from None
    if request is None:
        raise ConfigError(f"--scale is {text[:100]!r}: give {_FORMS}")
    return request


def _parsed(kind: str, rest: str) -> ScaleRequest | None:
    """The request of a kind; None where the rest has another form."""
    first, *others = re.split("[:,]", rest) if rest else [""]
    match kind, others:
        case "groundtruth", [] if not rest:
            return TrueTrajectory()
        case "imu", [] if not rest:
            return MeasuredMotion()
        case "marker", [side] if first:
            marker_dictionary(first)
            return KnownMarkers(first, _length(side))
        case "board", [square] if size := re.fullmatch(rf"(\d{{1,{_DIGITS}}})[xX](\d{{1,{_DIGITS}}})", first):
            return KnownBoard(int(size[1]), int(size[2]), _length(square))
        case "height", [] | ["nadir"]:
            return CameraHeight(_length(first), nadir=bool(others))
        case "distance", []:
            return KnownDistance(_length(first))
        case "distance", [a, b] if all(re.fullmatch(rf"\d{{1,{_DIGITS}}}", number) for number in (a, b)):
            return KnownDistance(_length(first), (int(a), int(b)))
    return None


def _length(text: str) -> KnownLength:
    """A length, with or without a standard deviation."""
    metres, _, sigma = text.partition("+-")
    try:
        return KnownLength(float(metres), float(sigma or 0))
    except ValueError:
        raise ConfigError(f"{text[:40]!r} is no length: give metres, as in 1.65 or 1.65+-0.02") from None


def marker_dictionary(name: str) -> Any:
    """Look up OpenCV's dictionary of markers by a name that people write."""
    import cv2

    known = {key.upper(): key for key in sorted(vars(cv2.aruco)) if key.startswith("DICT_")}
    wanted = name.strip().upper().removeprefix("DICT_").removeprefix("APRILTAG_")
    for key in (f"DICT_APRILTAG_{wanted.removeprefix('TAG')}", f"DICT_{wanted}"):
        if key in known:
            return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known[key]))
    raise ConfigError(f"unknown marker dictionary {name[:40]!r}: give tag36h11, tag25h9, tag16h5, 4x4_50, 6x6_250, ...")
