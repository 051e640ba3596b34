"""The digests of the tracks of this version of InitBench, which freeze its input.

``frozen.json`` holds, for each suite, the digest of the tracks of each source
(:func:`slam_init.compare.replay.tracks_digest`), and the libraries that they were made with. Tracks of points depend on
this project and on numpy only. Tracks of images depend on OpenCV's optical flow as well.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

from slam_init.bench.protocol import VERSION
from slam_init.bench.suites import simulated_worlds


@dataclass(frozen=True)
class FrozenCheck:
    """The digests of a run compared with the frozen ones."""

    #: Number of sources of the run.
    sources: int
    #: Number of sources with the frozen digest.
    same: int
    #: Sources with another digest than the frozen one.
    different: tuple[str, ...]
    #: Number of sources without a frozen digest.
    unknown: int
    #: The libraries that the frozen digests were made with.
    made_with: str

    @property
    def text(self) -> str:
        """Return the result in one sentence."""
        if self.different:
            return (
                f"{len(self.different)} of {self.sources} sources have other tracks than the frozen ones (made with "
                f"{self.made_with}): compare these figures with runs on this machine only"
            )
        if self.same == self.sources:
            return f"all {self.sources} sources have the frozen tracks"
        return f"{self.same} of {self.sources} sources have the frozen tracks; {self.unknown} are not frozen"


@dataclass(frozen=True)
class _Frozen:
    """The content of ``frozen.json`` for this version: digest by source, libraries by suite, checksum by sequence."""

    digests: Mapping[str, Mapping[str, str]]
    made_with: Mapping[str, Mapping[str, str]]
    checksums: Mapping[str, str]


@cache
def _frozen() -> _Frozen:
    text = files("slam_init.bench").joinpath("frozen.json").read_text(encoding="utf-8")
    content = json.loads(text)[str(VERSION)]
    # The worlds of ``drawn`` are listed by their number.
    drawn = dict(zip(simulated_worlds(len(content["drawn"]), 0), content["drawn"], strict=True))
    digests = {"drawn": drawn, "rendered": content["rendered"], "video": content["video"]}
    return _Frozen(digests, content["made_with"], content["checksums"])


def check_frozen(suite: str, digests: Mapping[str, str]) -> FrozenCheck:
    """Compare digests with the frozen ones.

    * ``digests``: By the label of the source. A sequence is known by the name of its folder.
    """
    frozen = _frozen()
    known = frozen.digests[suite]
    expected = {label: known.get(_key(suite, label)) for label in digests}
    different = tuple(label for label, digest in digests.items() if expected[label] not in (None, digest))
    unknown = sum(digest is None for digest in expected.values())
    made_with = ", ".join(f"{name} {number}" for name, number in frozen.made_with.get(suite, {}).items())
    return FrozenCheck(len(digests), len(digests) - len(different) - unknown, different, unknown, made_with)


def frozen_checksum(sequence: str) -> str | None:
    """Return the checksum of the files of a public sequence.

    * Returns: None if the sequence was not at hand when this version was frozen.
    """
    return _frozen().checksums.get(sequence)


def _key(suite: str, label: str) -> str:
    return Path(label).name if suite == "video" else label
