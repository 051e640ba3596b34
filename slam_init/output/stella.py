"""The map as stella_vslam's map file (``.msg``, MessagePack), from which it localizes or goes on mapping.

The keys are those of ``map_database_io_msgpack.cc``, ``map_database.cc``, ``keyframe.cc``, ``landmark.cc`` and the
cameras' ``to_json`` in stella_vslam at commit b0e60d6 [1]_. ``src_frm_id`` and ``frame_next_id`` are read by versions
before 0.3 only. Keypoints are undistorted: those of the pinhole camera with the same matrix. The spanning tree is a
chain, as the keyframes are neighbours in time. stella_vslam computes the words of its vocabulary, the covisibility
graph and the normals of the points itself when it loads the file.

References
----------
.. [1] S. Sumikura, M. Shibuya, K. Sakurada, OpenVSLAM: a versatile visual SLAM framework, ACM Multimedia 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.output.colmap import is_whole_sphere
from slam_init.types.arrays import Bools, Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap

#: Names of the camera and of the settings of ORB in the file. A configuration of stella_vslam with other values must
#: use other names.
_CAMERA, _ORB = "slam-init camera", "slam-init ORB"
#: Frames per second, by which stella_vslam chooses how often it makes a keyframe; it needs a number.
_FPS = 30.0
#: stella_vslam's defaults. All keypoints are of octave 0.
_ORB_PARAMETERS = {"scale_factor": 1.2, "num_levels": 8, "ini_fast_threshold": 20, "min_fast_threshold": 7}

#: Of the observations of a keyframe, in their order: descriptors (N, 32), orientations (N,) in degrees, whether known.
Described = tuple[Image, Floats, Bools]


def stella_camera(camera: Camera) -> dict[str, Any] | None:
    """Describe a camera as stella_vslam does; None for a lens that it has no model for."""
    numbers: dict[str, Any] = {
        "setup_type": "Monocular", "color_order": "Gray", "cols": camera.width, "rows": camera.height, "fps": _FPS,
        "focal_x_baseline": 0.0,
    }  # fmt: skip
    if camera.model == "equirectangular" and is_whole_sphere(camera):
        return {"model_type": "Equirectangular"} | numbers
    if camera.model not in ("pinhole", "radtan", "fisheye"):
        return None
    fisheye = camera.model == "fisheye"
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    lens = dict.fromkeys(names, 0.0) | dict(zip(names, camera.distortion, strict=False))
    matrix = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    return {"model_type": "Fisheye" if fisheye else "Perspective"} | numbers | matrix | lens


def stella_bytes(map_: InitialMap, described: Sequence[Described]) -> bytes:
    """Write the map.

    * ``described``: Of each keyframe. Observations that are not described are left out, and so are points that less
      than two keyframes still observe.
    """
    import msgpack

    camera = stella_camera(map_.camera)
    if camera is None:
        raise SlamInitError(f"stella_vslam has no {map_.camera.model} lens: leave stella out of the export")
    pixels = _undistorted(map_)
    used: Bools = np.asarray(np.isfinite(pixels).all(axis=1))
    for k, (_, _, known) in enumerate(described):
        used[map_.observation_keyframes == k] &= known
    counts = np.bincount(map_.observation_landmarks[used], minlength=len(map_.points))
    used &= counts[map_.observation_landmarks] >= 2
    keyframes = {}
    for k, (keyframe, (descriptors, angles, _)) in enumerate(zip(map_.keyframes, described, strict=True)):
        rows = np.flatnonzero(map_.observation_keyframes == k)
        here = used[rows]
        rows = rows[here]
        cam_from_world = keyframe.world_from_cam.inverse()
        w, x, y, z = cam_from_world.q_wxyz.tolist()
        keyframes[str(k)] = {
            "ts": keyframe.timestamp_s,
            "cam": _CAMERA,
            "orb_params": _ORB,
            "src_frm_id": keyframe.frame,
            "rot_cw": [x, y, z, w],
            "trans_cw": cam_from_world.t.tolist(),
            "n_keypts": len(rows),
            "undist_keypts": [
                {"pt": pt, "ang": angle, "oct": 0}
                for pt, angle in zip(pixels[rows].tolist(), angles[here].tolist(), strict=True)
            ],
            "x_rights": [-1.0] * len(rows),
            "depths": [-1.0] * len(rows),
            "descs": np.ascontiguousarray(descriptors[here]).view("<u4").tolist(),
            "lm_ids": map_.observation_landmarks[rows].tolist(),
            "span_parent": k - 1,  # the first one has none: -1
            "span_children": [k + 1] if k + 1 < len(map_.keyframes) else [],
            "loop_edges": [],
        }
    first = np.full(len(map_.points), len(map_.keyframes))
    np.minimum.at(first, map_.observation_landmarks[used], map_.observation_keyframes[used])
    landmarks = {
        str(i): {"1st_keyfrm": int(first[i]), "ref_keyfrm": int(first[i]), "pos_w": map_.points[i].tolist()}
        | dict.fromkeys(("n_vis", "n_fnd"), int(counts[i]))
        for i in np.flatnonzero(counts >= 2).tolist()
    }
    content = {
        "cameras": {_CAMERA: camera},
        "orb_params": {_ORB: {"name": _ORB} | _ORB_PARAMETERS},
        "keyframes": keyframes,
        "landmarks": landmarks,
        "frame_next_id": map_.keyframes[-1].frame + 1,
        "keyframe_next_id": len(keyframes),
        "landmark_next_id": len(map_.points),
    }
    return bytes(msgpack.packb(content))


def _undistorted(map_: InitialMap) -> Floats:
    """Observations (M, 2) in the pinhole camera with the same matrix, or in stella's panorama.

    In stella's panorama the first pixel begins at 0, so that its centre is at 0.5; in its pinhole camera it is at (cx,
    cy) of the calibration as here.
    """
    camera = map_.camera
    if camera.model == "equirectangular":
        return map_.observation_pixels + 0.5
    return camera.normalize(map_.observation_pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
