"""Worlds of a generator that is no part of this project: the suite ``other``.

The generator is a folder with ``gen.py``. The file has two functions, as for ``tests.benchmarks.reliability``:

* ``draw_factors(seed)`` returns a dict of what is drawn: scene, motion, noise and so on.
* ``make(factors)`` returns None if there is no such world, or a dict: ``W, H`` the size of the image, ``fs`` the stated
  focal length and ``cs`` the stated principal point, ``frames`` a list of (index, time, track ids, pixels), ``poses`` a
  list of (R, t) of ``world_from_cam``, and ``notrans`` whether the camera does not translate.

Each world is written as an archive of tracks (docs/matches.md), and the archive is judged like any other source.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from slam_init.bench.protocol import other_seeds
from slam_init.compare.judging import NO_TRANSLATION
from slam_init.compare.sources import ComparedSource, describe_sources
from slam_init.datasets.points import POINTS
from slam_init.errors import SourceError
from slam_init.output.folder import OutputFolder, output_error
from slam_init.system.user_code import attribute_of, described_error

#: The file of the generator, and the folder of the archives below that of the results.
_FILE, _TRACKS = "gen.py", "tracks"


def draw_archives(generator: Path, worlds: int, seed: int, out: Path) -> tuple[list[ComparedSource], list[str]]:
    """Draw worlds of a generator, and write them as archives of tracks.

    * Returns: The sources, and notes for the sheet. The label of a source has the seed and those factors that are
      texts, and the baseline: these are its strata.
    """
    file = generator / _FILE
    if not file.is_file():
        raise SourceError(f"{generator} has no {_FILE}: the suite other is skipped: give the folder of a generator")
    labels: dict[str, tuple[str, str]] = {}
    empty = []
    with OutputFolder(out, "bench") as folder:
        try:
            (folder.staging / _TRACKS).mkdir()
            for number in other_seeds(worlds, seed):
                name = f"{_TRACKS}/{number}.npz"
                try:
                    factors = attribute_of(f"{file}:draw_factors")(number)
                    made = attribute_of(f"{file}:make")(factors)
                    if made is None:
                        empty.append(str(number))
                        continue
                    arrays, labels[name] = _arrays(made), _label(generator.resolve().name, number, factors, made)
                except (Exception, SystemExit) as error:
                    raise SourceError(f"{file}: seed {number}: {described_error(error)}") from None
                np.savez_compressed(folder.staging / name, allow_pickle=False, **arrays)
        except OSError as error:
            raise output_error(out, error) from error
        if not labels:
            raise SourceError(f"{file} has no world of the seeds {other_seeds(worlds, seed)}: give other --worlds")
        folder.publish(list(labels))
    described = describe_sources([str(out / name) for name in labels])
    sources = [
        replace(source, label=label, group=group)
        for source, (label, group) in zip(described, labels.values(), strict=True)
    ]
    return sources, [f"{generator.resolve().name} has no world of the seeds {', '.join(empty)}"] if empty else []


def _arrays(made: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays of an archive (:mod:`slam_init.datasets.tracks_file`)."""
    frames, focal, (cx, cy) = made["frames"], float(made["fs"]), made["cs"]
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    for pose, (R, t) in zip(poses, made["poses"], strict=True):
        pose[:3, :3], pose[:3, 3] = R, t
    return {
        "frame": np.concatenate([np.full(len(ids), k) for k, (_, _, ids, _) in enumerate(frames)]),
        "track": np.concatenate([ids for _, _, ids, _ in frames]).astype(np.int64),
        "xy": np.concatenate([pixels for _, _, _, pixels in frames]).astype(float),
        "size": np.array([made["W"], made["H"]]),
        "names": np.array([f"frame-{index:06d}" for index, _, _, _ in frames]),
        "timestamps_s": np.array([time_s for _, time_s, _, _ in frames], float),
        "K": np.array([[focal, 0.0, float(cx)], [0.0, focal, float(cy)], [0.0, 0.0, 1.0]]),
        "world_from_cam": poses,
    }


def _label(generator: str, number: int, factors: Mapping[str, Any], made: Mapping[str, Any]) -> tuple[str, str]:
    """The label and the group of a world."""
    name = f"{POINTS}{quote(generator, safe='')}"
    strata = {key: value for key, value in factors.items() if isinstance(value, str) or key == "baseline"}
    group = f"{name}, {NO_TRANSLATION}" if made["notrans"] else name
    return f"{name}/{number}?{urlencode(strata)}", group
