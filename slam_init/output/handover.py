"""The map as arrays, for another SLAM system: ``handover.npz``.

The file is read by ``numpy.load(path)`` without pickles, and by every language that reads ``.npy``. K keyframes, L
points, M observations, F frames that were located after the initialization, N tracks without a point. Poses are
``world_from_cam``, camera frames are optical (x right, y down, z forward), pixel centres are at integers.

=============================  ============  ==============================================================
array                          shape, type   content
=============================  ============  ==============================================================
``format``                     str           ``slam-init-handover``
``version``                    int           1; raised when an array changes its name or meaning
``unit``                       str           ``metre``, or ``median depth`` of the points in the first view
``metres_per_unit``            float         of the map before it was brought to metres; NaN without a scale
``scale_sigma``                float         relative standard deviation of the scale; NaN without one
``gravity``                    (3,) float    unit vector down in the world; NaN where it was not measured
``gravity_sigma_deg``          float         standard deviation of each of its two angles
``camera_model``               str           ``pinhole``, ``radtan`` (k1, k2, p1, p2[, k3]), ``fisheye`` (k1..k4), ...
``camera_size``                (2,) int      width, height
``camera_parameters``          (P,) float    fx, fy, cx, cy, then the distortion
``noise_px``                   float         standard deviation of a coordinate of an observation, at least .1
``risk``                       float         probability that the map is wrong; NaN where the method states none
``depth_sigma``                float         median of ``point_depth_sigmas``; NaN without points
``unit_sigma``                 float         relative, of the mean distance of the points, but for the lens
``unit_by_lens``               (4,) float    how far four independent errors of the lens move it
``keyframe_frames``            (K,) int      absolute index in the source
``keyframe_times``             (K,) float    seconds
``keyframe_names``             (K,) str      names of the images
``keyframe_poses``             (K, 4, 4)     world_from_cam
``keyframe_covariances``       (K, 6, 6)     (rotation, translation) in the camera frame, as in gtsam
``point_ids``                  (L,) int      track of the point: ``L(id)`` in ``graph.txt``
``points``                     (L, 3) float  in the world: the camera frame of the first keyframe
``point_covariances``          (L, 3, 3)     of ``points``: the first pose and the longest baseline are held
``point_depth_sigmas``         (L,) float    relative, of the distances from the newest keyframe
``point_colors``               (L, 3) uint8  RGB
``point_descriptors``          (L, 32) uint8 ORB, octave 0, oriented; zero where ``point_described`` is false
``point_described``            (L,) bool
``observation_keyframes``      (M,) int      position among the keyframes
``observation_points``         (M,) int      position among the points
``observation_pixels``         (M, 2) float  raw pixels; with a rolling shutter those of the middle of the readout
``track_ids``                  (N,) int      tracks of the newest keyframe that have no point yet
``track_pixels``               (N, 2) float  raw pixels in the newest keyframe
``track_bearings``             (N, 3) float  unit rays in its camera frame
``located_frames``             (F,) int      absolute index
``located_times``              (F,) float    seconds
``located_poses``              (F, 4, 4)     world_from_cam
=============================  ============  ==============================================================
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.initial_map import Descriptors, InitialMap, Keyframe

#: The name of the format, and its version.
FORMAT, VERSION = "slam-init-handover", 1


def handover_arrays(
    map_: InitialMap, located: Sequence[Keyframe] = (), descriptors: Descriptors | None = None
) -> dict[str, Any]:
    """Make the arrays of the handover.

    * ``descriptors``: Without them no point is described.
    """
    camera, scale, count = map_.camera, map_.scale, len(map_.points)
    if descriptors is None:
        descriptors = Descriptors(np.zeros((count, 32), np.uint8), np.zeros(count, bool))
    return {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "unit": np.array("median depth" if scale is None else "metre"),
        "metres_per_unit": np.array(math.nan if scale is None else scale.metres_per_unit, float),
        "scale_sigma": np.array(math.nan if scale is None else scale.sigma, float),
        "gravity": np.full(3, math.nan) if map_.gravity is None else map_.gravity.down,
        "gravity_sigma_deg": np.array(math.nan if map_.gravity is None else map_.gravity.sigma_deg, float),
        "camera_model": np.array(camera.model),
        "camera_size": np.array([camera.width, camera.height]),
        "camera_parameters": np.array(camera.parameters, float),
        "noise_px": np.array(map_.noise_px, float),
        "risk": np.array(math.nan if map_.risk is None else map_.risk, float),
        "depth_sigma": np.array(map_.depth_sigma, float),
        "unit_sigma": np.array(map_.scale_uncertainty.own, float),
        "unit_by_lens": map_.scale_uncertainty.by_lens,
        "keyframe_frames": _frames(map_.keyframes),
        "keyframe_times": _times(map_.keyframes),
        "keyframe_names": np.array([keyframe.name for keyframe in map_.keyframes], np.str_),
        "keyframe_poses": _matrices(map_.keyframes),
        "keyframe_covariances": map_.pose_covariances,
        "point_ids": map_.track_ids,
        "points": map_.points,
        "point_covariances": map_.point_covariances,
        "point_depth_sigmas": map_.depth_sigmas,
        "point_colors": map_.colors,
        "point_descriptors": descriptors.orb,
        "point_described": descriptors.described,
        "observation_keyframes": map_.observation_keyframes,
        "observation_points": map_.observation_landmarks,
        "observation_pixels": map_.observation_pixels,
        "track_ids": map_.open_tracks.track_ids,
        "track_pixels": map_.open_tracks.pixels,
        "track_bearings": map_.open_tracks.bearings,
        "located_frames": _frames(located),
        "located_times": _times(located),
        "located_poses": _matrices(located),
    }


def handover_bytes(map_: InitialMap, located: Sequence[Keyframe] = (), descriptors: Descriptors | None = None) -> bytes:
    """Write the handover; see :func:`handover_arrays`."""
    buffer = io.BytesIO()
    np.savez(buffer, **handover_arrays(map_, located, descriptors))
    return buffer.getvalue()


def _frames(keyframes: Sequence[Keyframe]) -> Any:
    return np.array([keyframe.frame for keyframe in keyframes], np.int64)


def _times(keyframes: Sequence[Keyframe]) -> Floats:
    return np.array([keyframe.timestamp_s for keyframe in keyframes], float)


def _matrices(keyframes: Sequence[Keyframe]) -> Floats:
    """Poses (N, 4, 4)."""
    return np.array([keyframe.world_from_cam.matrix() for keyframe in keyframes]).reshape(-1, 4, 4)
