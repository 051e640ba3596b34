"""The summary of a result that no run made."""

from dataclasses import dataclass

from make_map import CAMERAS

from slam_init.output.results import summary_dict
from slam_init.types.camera import Camera


@dataclass
class FakeSource:
    name: str = "arc"
    kind: str = "images"
    camera: Camera | None = None
    groundtruth = None

    def __len__(self):
        return 32

    def frames(self, start=0, max_frames=None):
        return iter(())


def summarize(result, camera=CAMERAS["pinhole"], **keywords):
    return summary_dict(result, FakeSource(), camera, "quest", 0, **keywords)
