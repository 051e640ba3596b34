"""Finds markers and checkerboards in images: planar points of known size, and their pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam_init.scale.requests import KnownBoard, KnownMarkers, marker_dictionary
from slam_init.types.arrays import Floats, Image

#: Corners of a marker of side 2 as OpenCV lists them: from the upper left one, clockwise.
_CORNERS = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Sighting:
    """A target of known size in one image."""

    #: Absolute index of the frame.
    frame: int
    #: Number of the marker; 0 for the board.
    target: int
    #: (P, 3) Points of the target in its own frame, in metres; z = 0.
    points_m: Floats
    #: (P, 2) Their raw pixels.
    pixels: Floats


def find_markers(images: Mapping[int, Image], markers: KnownMarkers) -> list[Sighting]:
    """Find all markers of a dictionary in images.

    Shapes: ``images`` (H, W).

    * Returns: A number that an image shows twice is left out of this image: a marker on a poster, or a copy.
    """
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(marker_dictionary(markers.dictionary), parameters)
    points_m = 0.5 * markers.length.metres * _CORNERS
    sightings = []
    for frame, image in sorted(images.items()):
        corners, numbers, _ = detector.detectMarkers(image)
        found = [] if numbers is None else [int(number) for number in np.ravel(numbers)]
        for number, pixels in zip(found, corners, strict=True):
            if found.count(number) == 1:
                sightings.append(Sighting(frame, number, points_m, np.asarray(pixels, float).reshape(4, 2)))
    return sightings


def find_board(images: Mapping[int, Image], board: KnownBoard) -> list[Sighting]:
    """Find a checkerboard in images.

    Shapes: ``images`` (H, W).

    * Returns: At most one for each image. Half a turn of a board may look the same, so the order of the corners may be
      reversed from one image to another.
    """
    import cv2

    x, y = np.meshgrid(np.arange(float(board.columns)), np.arange(float(board.rows)))
    points_m = board.length.metres * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points_m = np.asarray(points_m - points_m.mean(axis=0), float)
    sightings = []
    for frame, image in sorted(images.items()):
        found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=cv2.CALIB_CB_ACCURACY)
        if found:
            sightings.append(Sighting(frame, 0, points_m, np.asarray(corners, float).reshape(-1, 2)))
    return sightings
