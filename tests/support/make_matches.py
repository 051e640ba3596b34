"""The matches of one scene in the formats of track sources: COLMAP's database, hloc's ``.h5`` files, ``tracks.npz``."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
#: In natural order.
NAMES = ("view2.png", "view9.png", "view10.png", "view11.png")

_TABLES = """
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY, model INTEGER, width INTEGER, height INTEGER, params BLOB,
  prior_focal_length INTEGER);
CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB, config INTEGER);
"""


@dataclass(frozen=True)
class Matches:
    """Keypoints and matches of a scene."""

    #: (N, 2) Of each view, in an order of its own.
    keypoints: tuple[np.ndarray, ...]
    #: (N,) The point of the world that each keypoint sees.
    point_of: tuple[np.ndarray, ...]
    world_from_cam: tuple[Pose, ...]

    def pair(self, i: int, j: int) -> np.ndarray:
        """(M, 2): the keypoints of two views that see the same points."""
        _, a, b = np.intersect1d(self.point_of[i], self.point_of[j], return_indices=True)
        return np.column_stack([a, b])


def scene(seed: int = 0, points: int = 300) -> Matches:
    """Views of points of random depth from a camera that moves sideways and turns a little; noise of 0.3 px."""
    rng = np.random.default_rng(seed)
    world = rng.uniform((-2.5, -1.5, 3.0), (2.5, 1.5, 7.0), (points, 3))
    keypoints, point_of, poses = [], [], []
    for i in range(len(NAMES)):
        pose = Pose.from_quaternion(np.array([1.0, 0.004 * i, 0.01 * i, 0.0]), np.array([0.25 * i, 0.02 * i, 0.0]))
        pixels = CAMERA.project(pose.inverse().apply(world)) + 0.3 * rng.normal(size=(points, 2))
        seen = np.flatnonzero(((pixels > 0) & (pixels < (639, 479))).all(axis=1))
        rng.shuffle(seen)
        keypoints.append(pixels[seen])
        point_of.append(seen)
        poses.append(pose)
    return Matches(tuple(keypoints), tuple(point_of), tuple(poses))


def pairs() -> list[tuple[int, int]]:
    return [(i, j) for i in range(len(NAMES)) for j in range(i)]


def write_database(path: Path, made: Matches, verified: bool = True, prior: int = 1) -> Path:
    """A database in the schema of COLMAP; the ids of the images are in another order than their names."""
    camera = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx + 0.5, CAMERA.cy + 0.5]).tobytes()
    with sqlite3.connect(path) as database:
        database.executescript(_TABLES)
        database.execute("INSERT INTO cameras VALUES (1, 1, 640, 480, ?, ?)", (camera, prior))
        ids = [len(NAMES) - i for i in range(len(NAMES))]
        for i, name in enumerate(NAMES):
            points = np.column_stack([made.keypoints[i] + 0.5, np.ones((len(made.keypoints[i]), 4))]).astype("<f4")
            database.execute("INSERT INTO images VALUES (?, ?, 1)", (ids[i], name))
            database.execute("INSERT INTO keypoints VALUES (?, ?, 6, ?)", (ids[i], len(points), points.tobytes()))
        for i, j in pairs():
            first, second = (i, j) if ids[i] < ids[j] else (j, i)
            matched = made.pair(first, second).astype("<u4")
            row = (2147483647 * ids[first] + ids[second], len(matched), matched.tobytes())
            if verified:
                database.execute("INSERT INTO two_view_geometries VALUES (?, ?, 2, ?, 2)", row)
            wrong = matched[::-1] if verified else matched  # raw matches are not used where there are verified ones
            database.execute("INSERT INTO matches VALUES (?, ?, 2, ?)", (*row[:2], wrong.tobytes()))
    database.close()
    return path


def write_hloc(folder: Path, made: Matches, separator: str = "/") -> Path:
    """Files of hloc; ``_`` is the separator of older versions."""
    import h5py

    with h5py.File(folder / "feats.h5", "w") as file:
        for name, points in zip(NAMES, made.keypoints, strict=True):
            group = file.create_group(f"db/{name}")
            group["keypoints"], group["image_size"] = points.astype(np.float32), np.array([640, 480])
    path = folder / "feats_matches_pairs.h5"
    with h5py.File(path, "w") as file:
        for i, j in pairs():
            partner = np.full(len(made.keypoints[i]), -1)
            matched = made.pair(i, j)
            partner[matched[:, 0]] = matched[:, 1]
            file[f"db-{NAMES[i]}{separator}db-{NAMES[j]}/matches0"] = partner
    return path


def tracks_arrays(made: Matches) -> dict[str, np.ndarray]:
    """The arrays of ``tracks.npz``, of the points that are seen in two views at least."""
    all_points = np.concatenate(made.point_of)
    often = np.flatnonzero(np.bincount(all_points) >= 2)
    rows = [np.flatnonzero(np.isin(seen, often)) for seen in made.point_of]
    K = CAMERA.K
    poses = np.tile(np.eye(4), (len(NAMES), 1, 1))
    for i, pose in enumerate(made.world_from_cam):
        poses[i, :3, :3], poses[i, :3, 3] = pose.R, pose.t
    return {
        "frame": np.repeat(np.arange(len(NAMES)), [len(r) for r in rows]),
        "track": np.concatenate([seen[r] for seen, r in zip(made.point_of, rows, strict=True)]),
        "xy": np.concatenate([points[r] for points, r in zip(made.keypoints, rows, strict=True)]),
        "size": np.array([640, 480]),
        "names": np.array(NAMES),
        "K": K,
        "world_from_cam": poses,
    }


def write_tracks(path: Path, made: Matches, **changes: np.ndarray | None) -> Path:
    """A file of tracks; a change of None leaves an array out."""
    arrays: Any = {name: array for name, array in (tracks_arrays(made) | changes).items() if array is not None}
    np.savez(path, **arrays)
    return path
