"""Attacks on the API: images, times, tracks and rays that are none."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Pose
from tests.benchmarks.attacks.attack import Attack, Seen
from tests.benchmarks.attacks.hostile_files import written

__all__ = ["ATTACKS"]

_CAMERA = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)
_IMAGE = np.zeros((48, 64), np.uint8)
_ERROR = "an error of the package, in one line"


def _refused(call: Callable[[], object], error: type[Exception], *words: str) -> Seen:
    """The call has to raise this error, with a message of one line."""
    try:
        result = call()
    except error as raised:
        text = str(raised)
        fine = len(text.splitlines()) == 1 and all(word in text for word in words)
        return Seen(fine, f"{type(raised).__name__}: {text}"[:200])
    return Seen(False, f"returned {result!r:.100}")


def _processed(*inputs: Any) -> object:
    """Give images with times to a new initializer."""
    from slam_init.initializer import Initializer

    initializer = Initializer(_CAMERA)
    for image, stamp in inputs:
        initializer.process(image, stamp)
    return initializer


def _frame_row(name: str, word: str, *inputs: Any) -> Attack:
    return Attack("API", name, _ERROR, lambda _: _refused(lambda: _processed(*inputs), SlamInitError, word))


def _works(*inputs: Any) -> Callable[[Path], Seen]:
    def run(_: Path) -> Seen:
        _processed(*inputs)
        return Seen(True, "processed")

    return run


_WIDE = np.zeros((48, 128, 3), np.uint8)
_NO_IMAGE: Any = None
_READ_ONLY = _IMAGE.copy()
_READ_ONLY.setflags(write=False)

_FRAMES = (
    _frame_row("an image that is None", "NoneType", (None, 0.0)),
    _frame_row("an image that is a list", "list", (_IMAGE.tolist(), 0.0)),
    _frame_row("an image of floats", "float64", (_IMAGE.astype(float), 0.0)),
    _frame_row("an image of four channels", "(48, 64, 4)", (np.zeros((48, 64, 4), np.uint8), 0.0)),
    _frame_row("an image of another size than the camera", "(24, 32)", (np.zeros((24, 32), np.uint8), 0.0)),
    _frame_row(
        "a frame with an image of another size", "(24, 32)", (Frame(0, 0.0, "a", np.zeros((24, 32), np.uint8)), None)
    ),
    _frame_row("a frame whose image is None", "NoneType", (Frame(0, 0.0, "a", _NO_IMAGE), None)),
    _frame_row("a time that is NaN", "finite", (_IMAGE, float("nan"))),
    _frame_row("a time that is a text", "'now'", (_IMAGE, "now")),
    _frame_row("a time of 10^400", "finite", (_IMAGE, 10**400)),
    _frame_row("a time that is negative", "negative", (_IMAGE, -1.0)),
    _frame_row("a time beyond 2^63", "2^63", (_IMAGE, 2**63)),
    _frame_row("a repeated time", "after", (_IMAGE, 1.0), (_IMAGE, 1.0)),
    _frame_row("a time that goes back", "after", (_IMAGE, 1.0), (_IMAGE, 0.5)),
    Attack(
        "API",
        "images that are mirrored views of other arrays",
        "works",
        _works((_WIDE[:, ::-2], 0.0), (_WIDE[::-1, ::2, ::-1], 0.1)),
    ),
    Attack("API", "a read-only image", "works", _works((_READ_ONLY, 0.0), (_READ_ONLY, 0.1))),
)


def _nanoseconds(_: Path) -> Seen:
    from slam_init.initializer import Initializer

    initializer = Initializer(_CAMERA)
    for k in range(3):
        initializer.process(_IMAGE, 1_403_636_579_763_555_584 + 50_000_000 * k)
    times_s = [seen.timestamp_s for seen in initializer.history]
    told = any("nanoseconds" in note for note in initializer.finish().notes)
    return Seen(told and abs(times_s[0] - 1403636579.763) < 1e-3, f"{times_s[0]:.3f} s; told: {told}")


def _left_out(_: Path) -> Seen:
    from slam_init.initializer import Initializer

    initializer = Initializer(_CAMERA)
    for stamp in (0.0, 0.1, float("nan"), 0.05, -1.0, 0.2):
        try:
            initializer.process(_IMAGE, stamp)
        except SlamInitError:
            continue
    return Seen(initializer.frames_read == 3, f"{initializer.frames_read} of 6 frames were taken")


def _rays(name: str, rays1: Any, rays2: Any, expected: str) -> Attack:
    """Degenerate rays: a refusal, or rotations."""

    def run(_: Path) -> Seen:
        import quest
        from tests.benchmarks.quest.adversarial import is_rotation

        try:
            result = quest.estimate_relative_pose(rays1, rays2)
        except quest.InputError as error:
            return Seen(expected == "InputError" and len(str(error).splitlines()) == 1, f"InputError: {error}"[:200])
        if isinstance(result, quest.NoPose):
            return Seen(expected != "InputError", f"no pose: {result.reason}")
        rotations = [result.R, *(other.R for other in result.alternatives)]
        return Seen(
            expected != "InputError" and all(map(is_rotation, rotations)), f"{result.kind}: {len(rotations)} rotations"
        )

    return Attack("API", name, expected, run)


_RNG = np.random.default_rng(0)
_BOX = _RNG.uniform([-1, -1, 1], [1, 1, 4], (30, 3))
_TWO = _RNG.normal(size=(2, 3))[np.arange(30) % 2]
_ROTATION = "rotations to 1e-9, or a reason"
_RAYS = (
    _rays("quest: all rays nearly equal", 1 + 1e-9 * _BOX, 1 + 1e-9 * _BOX[::-1], _ROTATION),
    _rays("quest: two clusters of rays", _TWO + 1e-13 * _BOX, _TWO[::-1] + 1e-13 * _BOX, _ROTATION),
    _rays("quest: collinear rays", _BOX * [1, 0, 1], _BOX[::-1] * [1, 0, 1], _ROTATION),
    _rays("quest: antipodal rays", _BOX, -_BOX, _ROTATION),
    _rays("quest: rays of 1e308", _BOX * 4e307, _BOX * 1e-300, _ROTATION),
    _rays("quest: NaN in one row", np.vstack([_BOX, [[np.nan] * 3]]), np.vstack([_BOX, [[0, 0, 1]]]), "InputError"),
    _rays(
        "quest: a ray of length zero", np.vstack([_BOX, np.zeros((1, 3))]), np.vstack([_BOX, [[0, 0, 1]]]), "InputError"
    ),
    _rays("quest: texts as rays", [["a", "b", "c"]] * 12, _BOX[:12], "InputError"),
)


def _own_data_set(body: str, *words: str) -> Callable[[Path], Seen]:
    """A data set of the user that is none."""

    def run(folder: Path) -> Seen:
        from slam_init.datasets import open_source

        module = f"hostile_{zlib.crc32(body.encode())}"
        written(folder / f"{module}.py", f"import numpy as np\nfrom slam_init.types.pose import *\n{body}\n")
        sys.path.insert(0, str(folder))
        try:
            return _refused(lambda: open_source(f"python:{module}:Source"), SlamInitError, *words)
        finally:
            sys.path.remove(str(folder))

    return run


_SOURCE = """
class Source:
    name = kind = "own"
    camera = groundtruth = None
    timestamps_s = [0.0, 0.1]
    def __len__(self): return 2
    def frames(self, start=0, max_frames=None): return iter(())
"""
_TRUTH = "Trajectory(np.arange(2.0), (Pose(np.zeros((3, 3)), np.zeros(3)),) * 2)"
_OWN = (
    ("a data set of one's own without frames()", "class Source: name = kind = 'own'", "not a source"),
    ("a data set of one's own with repeated times", _SOURCE.replace("[0.0, 0.1]", "[0.1, 0.1]"), "after"),
    ("a data set of one's own with too few times", _SOURCE.replace("[0.0, 0.1]", "[0.1]"), "shape"),
    ("a data set of one's own with words as times", _SOURCE.replace("[0.0, 0.1]", "['a', 'b']"), "numbers"),
    (
        "a data set of one's own whose true poses are no rotations",
        _SOURCE.replace("groundtruth = None", f"groundtruth = {_TRUTH}").replace("camera = ", "camera = None; "),
        "no rotation",
    ),
)


def _zero_quaternion(_: Path) -> Seen:
    return _refused(lambda: Pose.from_quaternion(np.zeros(4), np.zeros(3)), SlamInitError, "no rotation")


#: In the order of the table.
ATTACKS: tuple[Attack, ...] = (
    *_FRAMES,
    Attack("API", "times in nanoseconds", "converted, and told", _nanoseconds),
    Attack("API", "refused frames in between", "the others are processed as if they had not come", _left_out),
    *_RAYS,
    Attack("API", "a pose of a zero quaternion", _ERROR, _zero_quaternion),
    *(Attack("API", name, _ERROR, _own_data_set(body, word)) for name, body, word in _OWN),
)
