"""The suite ``video``: public sequences, where to get each, and the checksums of those at hand.

A sequence is a folder of this name anywhere below ``SLAM_INIT_DATA``, with ``rgb.txt``, ``groundtruth.txt`` and
``camera.yaml``. Most entries are a part of a public sequence, so that a run takes minutes. ``slam-init bench convert``
makes the folder from what the authors publish.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside, read_regular

#: Variable of the folder of public sequences.
VARIABLE = "SLAM_INIT_DATA"
#: Layouts that the readers take, and those that no program converts.
READ, BY_HAND = "read", "by hand"
_LISTS = ("camera.yaml", "groundtruth.txt", "rgb.txt")
#: Folders below SLAM_INIT_DATA that are looked through: no collection of data sets has more.
_MOST_FOLDERS = 100_000
#: An uncompressed image of 100 million pixels.
_MAX_FILE_BYTES = 300_000_000


@dataclass(frozen=True)
class Entry:
    """A public sequence."""

    #: Name of the folder.
    name: str
    #: Kind of the scene and of the motion: the stratum.
    kind: str
    #: Name of the published sequence.
    title: str
    #: Where to get it.
    url: str
    #: Layout of what is published, as :mod:`slam_init.bench.convert` takes it. :data:`READ` is a layout that the
    #: readers take (TUM RGB-D, EuRoC, KITTI), :data:`BY_HAND` one without a published truth that can be converted.
    layout: str
    #: first, count: First frame and number of frames.
    first: int
    count: int


_KITTI = "https://www.cvlibs.net/datasets/kitti/eval_odometry.php"
_EUROC = "https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets"
_TUM = "https://cvg.cit.tum.de/data/datasets/rgbd-dataset/download"
_STRECHA = "https://github.com/openMVG/SfM_quality_evaluation"
_TSUKUBA = "https://home.cvlab.cs.tsukuba.ac.jp/dataset"
_SCENES = "https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/"
_PARRINGTON = "https://github.com/SSARCandy/panoramas-image-stitching"
_TARTAN = "https://theairlab.org/tartanair-dataset"
_TEMPLE = "https://vision.middlebury.edu/mview"

#: The sequences of this version, sorted by name.
MANIFEST: tuple[Entry, ...] = (
    Entry("06_start", "driving", "KITTI odometry 06", _KITTI, READ, 0, 51),
    Entry("V1_01_static", "no translation", "EuRoC MAV V1_01_easy", _EUROC, READ, 0, 30),
    Entry("castle-P19", "photographs", "Strecha castle-P19", _STRECHA, "strecha", 0, 19),
    Entry("checkerboard_desk", "plane", "UZH course, exercise 1", "https://github.com/yosoufe/VAMR", "uzh", 0, 200),
    Entry("door", "photographs", "Lund door", "https://github.com/borglab/gtsfm", "colmap", 0, 12),
    Entry("entry-P10", "photographs", "Strecha entry-P10", _STRECHA, "strecha", 0, 10),
    Entry("fountain-P11", "photographs", "Strecha fountain-P11", _STRECHA, "strecha", 0, 11),
    Entry("fr1_desk_9frames", "hand-held", "TUM RGB-D freiburg1_desk", _TUM, READ, 0, 9),
    Entry("fr1_rpy_b", "hand-held", "TUM RGB-D freiburg1_rpy", _TUM, READ, 80, 120),
    Entry("hospital_clip", "drone", "TartanAir hospital", _TARTAN, "tartanair", 0, 40),
    Entry("new_tsukuba_150", "hand-held", "New Tsukuba stereo, left camera", _TSUKUBA, BY_HAND, 0, 150),
    Entry("parrington", "no translation", "parrington panorama", _PARRINGTON, BY_HAND, 0, 18),
    Entry("redkitchen_a", "hand-held", "7-Scenes RedKitchen", _SCENES, "7scenes", 0, 300),
    Entry("templeRing_19", "photographs", "Middlebury templeRing", _TEMPLE, "middlebury", 0, 19),
)


@dataclass(frozen=True)
class DataFolder:
    """The sequences of the manifest below a folder."""

    root: Path
    #: Folder of each sequence at hand, by name, sorted.
    found: dict[str, Path]
    missing: tuple[Entry, ...]


def data_folder() -> Path:
    """Return the folder of public sequences."""
    text = os.environ.get(VARIABLE, "")
    if not text:
        raise SourceError(f"set {VARIABLE} to the folder of the public sequences; slam-init bench list tells which")
    if not Path(text).is_dir():
        raise SourceError(f"{VARIABLE} is {text!r}: there is no such folder")
    return Path(text)


def find_sequences(root: Path) -> DataFolder:
    """Find the sequences of the manifest. Links to folders are not followed."""
    names = {entry.name for entry in MANIFEST}
    found: dict[str, Path] = {}
    for folder in _folders(root):
        if folder.name in names and all((folder / name).is_file() for name in _LISTS):
            if folder.name in found:
                raise SourceError(f"{folder} and {found[folder.name]} have the same name: keep one below {root}")
            found[folder.name] = folder
    missing = tuple(entry for entry in MANIFEST if entry.name not in found)
    return DataFolder(root, dict(sorted(found.items())), missing)


def kind_of_sequence(label: str) -> str:
    """Return the stratum of a public sequence."""
    return next((entry.kind for entry in MANIFEST if entry.name == Path(label).name), "other")


def checksum(folder: Path) -> str:
    """Hash the files of a sequence: its calibration, truth and list of images, and the images on this list."""
    from slam_init.datasets import open_source
    from slam_init.datasets.image_files import ImageFileSource

    source = open_source(folder)
    if not isinstance(source, ImageFileSource):
        raise SourceError(f"{folder} is no folder of images")
    digest = hashlib.sha256()
    for path in (*(folder / name for name in _LISTS), *source.paths):
        check_inside(path, folder)
        data = read_regular(path, _MAX_FILE_BYTES, "a file of a sequence", SourceError)
        digest.update(hashlib.sha256(data).digest())
    return digest.hexdigest()[:16]


def _folders(root: Path) -> Iterator[Path]:
    for seen, (folder, below, _) in enumerate(os.walk(root)):
        if seen > _MOST_FOLDERS:
            raise SourceError(f"{root} has more than {_MOST_FOLDERS} folders: name the folder of the sequences")
        below.sort()
        if seen:
            yield Path(folder)
