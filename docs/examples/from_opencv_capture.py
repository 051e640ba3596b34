"""Feed the initializer from an OpenCV capture (a camera or a video file) and print advice for the person who moves it.

Run it as ``python docs/examples/from_opencv_capture.py CAPTURE CAMERA``. CAPTURE is a video file or the number of
a camera. CAMERA is a calibration in any format of ``slam-init run --camera``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam_init.calibration.files import load_camera
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera
from slam_init.types.result import Result

if TYPE_CHECKING:
    import cv2


def initialize_from_capture(capture: cv2.VideoCapture, camera: Camera, say: Callable[[str], object] = print) -> Result:
    """Read images until a map is found or the capture ends.

    * ``say``: Is called with a line of text each time the reason or the progress (in steps of 10 %) changes.
    """
    import cv2

    initializer, last_news = Initializer(camera), ("", -1)
    while True:
        found, image = capture.read()
        if not found:
            return initializer.finish()
        time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        status = initializer.process(np.asarray(image, np.uint8), time_s)
        news = status.reason or "", int(10 * status.progress)
        if news != last_news:
            say(f"{time_s:7.2f} s  {status.progress:4.0%}  {status.state}  {status.advice}")
            last_news = news
        if status:
            return initializer.result


def main(argv: Sequence[str] | None = None) -> int:
    """Initialize from a capture and print the result.

    * ``argv``: Capture and calibration; the arguments of the process by default.
    """
    arguments = sys.argv[1:] if argv is None else argv
    if len(arguments) != 2:
        print("usage: python docs/examples/from_opencv_capture.py CAPTURE CAMERA", file=sys.stderr)
        return 2
    try:
        return _main(*arguments)
    except SlamInitError as error:
        print(f"from_opencv_capture: {error}", file=sys.stderr)
        return 2


def _main(name: str, calibration: str) -> int:
    import cv2

    capture = cv2.VideoCapture(int(name)) if name.isdecimal() else cv2.VideoCapture(name)
    try:
        if not capture.isOpened():
            raise SlamInitError(f"{name} cannot be opened: give a video file or the number of a camera")
        size = (round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        result = initialize_from_capture(capture, load_camera(calibration, size))
    finally:
        capture.release()
    if result.map is None:
        print(f"not initialized after {result.frames_read} images: {result.reason}: {result.advice}")
        return 3
    frames = ", ".join(str(keyframe.frame) for keyframe in result.map.keyframes)
    print(f"initialized after {result.frames_to_init} images: {len(result.map.points)} landmarks, keyframes {frames}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
