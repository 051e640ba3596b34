"""Writes ``frozen.json`` anew: for a new version of the protocol, and for further public sequences.

Run it as ``python -m tests.benchmarks.freeze_bench SUITE [--from tracks.jsonl]``. The digests of all
suites but ``drawn`` are those that a run wrote to its ``tracks.jsonl``.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from slam_init.bench import protocol
from slam_init.bench.manifest import checksum, data_folder, find_sequences
from slam_init.bench.protocol import DEFAULTS, SUITES, VERSION, frozen_key, simulated_worlds
from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.output.provenance import versions

_FILE = Path(protocol.__file__).with_name("frozen.json")
#: What the tracks of each suite depend on.
_LIBRARIES = {
    "drawn": ("numpy",),
    "rendered": ("numpy", "opencv-python-headless"),
    "video": ("numpy", "opencv-python-headless"),
    "other": ("numpy",),
}


def main(arguments: list[str]) -> None:
    """Write the digests of a suite."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--from", dest="tracks", type=Path)
    chosen = parser.parse_args(arguments)
    content = json.loads(_FILE.read_text(encoding="utf-8"))
    of_version = content[str(VERSION)]
    if chosen.suite == "drawn":
        sources = [(text, open_compared(text)) for text in simulated_worlds(DEFAULTS["drawn"].worlds, 0)]
        of_version["drawn"] = [tracks_digest(source, replay(source, text, 0, "")) for text, source in sources]
    else:
        for line in chosen.tracks.read_text(encoding="utf-8").splitlines():
            label, digest = json.loads(line)
            of_version.setdefault(chosen.suite, {})[frozen_key(chosen.suite, label)] = digest
    if chosen.suite == "video":
        of_version["checksums"] = {name: checksum(path) for name, path in find_sequences(data_folder()).found.items()}
    of_version["made_with"][chosen.suite] = {
        name: number for name, number in versions().items() if name in _LIBRARIES[chosen.suite]
    }
    _FILE.write_text(json.dumps(content, indent=0) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
