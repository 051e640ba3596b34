"""Video files, decoded through PyAV, which has the decoders of FFmpeg.

Frames are turned upright by the rotation that the container states (the display matrix, which phones write). Times are
the presentation times of the container, so that a variable frame rate needs no special case. The video is opened as a
file object and not by its name: so the container cannot make FFmpeg open another file.

**Interlaced videos.** The even rows of an interlaced frame are half a frame interval older or younger than the odd
rows. Where the image moves, neighbouring rows differ more than rows two apart, which belong to the same field: a comb.
In an image of one time the mean absolute difference grows with the distance of the rows. For white noise, which has the
least growth, the two differences are equal. So a frame in which neighbouring rows differ by clearly more than rows two
apart has two fields. A flag of the container would be less certain: progressive videos are often stored with it.

From the first such frame on, the odd rows are replaced by the means of the even rows beside them. The rows that are
left keep their places, so the calibration and earlier tracks stay valid; only the resolution of the columns is halved.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.image_files import NOMINAL_RATE_HZ, check_pixels, check_size, frame_range
from slam_init.errors import SourceError
from slam_init.system.regular_file import first_bytes, open_regular
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.reformatter import VideoReformatter
    from av.video.stream import VideoStream

# -- fields ----------------------------------------------------------------------------------------


#: Note for the user.
NOTE = "the video is interlaced: the rows of one field are used, the others are interpolated"

#: Frames with a larger comb ratio have two fields. White noise has the ratio 1, other images of one time have less. The
#: ratio of white noise is known to 0.5 % from 40,000 differences, the least that a 640 x 480 frame gives.
_LEAST_COMB = 1.1
#: Columns of a frame that are looked at: every eighth one.
_STEP = 8


def comb_ratio(image: Image) -> float:
    """Compute how much more neighbouring rows differ than rows two apart.

    Shapes: ``image`` (H, W).

    * Returns: Ratio of the mean absolute differences; 0 for an image without any.
    """
    if len(image) < 3:
        return 0.0
    # Of three channels the green one has most of the luminance.
    rows = (image if image.ndim == 2 else image[..., 1])[:, ::_STEP].astype(np.int16)
    near, far = (float(np.abs(rows[lag:] - rows[:-lag]).mean()) for lag in (1, 2))
    return near / far if far > 0 else 0.0


def first_field(image: Image) -> Image:
    """Replace the odd rows by the means of the even rows beside them.

    Shapes: ``image`` (H, W).
    """
    field = image.copy()
    between = field[1:-1:2]
    above, below = field[0:-2:2][: len(between)], field[2::2][: len(between)]
    field[1:-1:2] = ((above.astype(np.uint16) + below + 1) // 2).astype(np.uint8)
    if len(field) % 2 == 0 and len(field) > 1:  # the last row has no even row below
        field[-1] = field[-2]
    return field


# -- decoding --------------------------------------------------------------------------------------


#: Most frames of a video: nine hours at 30 Hz.
_MAX_FRAMES = 1_000_000
_CONVERT = "convert it: ffmpeg -i IN -c:v libx264 OUT.mp4"


@contextmanager
def _opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    import av

    with open_regular(path, SourceError) as file, av.open(file, mode="r", metadata_errors="replace") as container:
        if not container.streams.video:
            raise SourceError(f"{path}: not a readable video: it holds no images")
        best = container.streams.best("video")
        stream = next((one for one in container.streams.video if one is best), container.streams.video[0])
        stream.thread_type = "AUTO"
        yield container, stream


def _quarters(frame: VideoFrame) -> int:
    """The quarters of a turn, anticlockwise, that make a frame upright."""
    return round(frame.rotation / 90) % 4


def upright_pixels(frame: VideoFrame, reformatter: VideoReformatter) -> Image:
    """Convert a decoded frame to BGR, and turn it upright. The interpolation of the colours is that of OpenCV.

    Shapes: returns ``image`` (H, W, 3).

    * ``reformatter``: One for all frames, since each makes tables.
    """
    pixels = reformatter.reformat(frame, format="bgr24", interpolation="BICUBIC").to_ndarray()
    return np.ascontiguousarray(np.rot90(pixels, _quarters(frame)), np.uint8)


def decoded(path: Path, skip: int = 0) -> Iterator[tuple[float, Image | None]]:
    """Decode a video from its beginning, since seeking is inexact.

    Shapes: returns ``image`` (H, W, 3).

    * ``skip``: Number of frames at the beginning whose images are not needed.
    * Returns ``time_s``: Presentation time in the container in whole nanoseconds, from the start of its stream; NaN
      where it states none.
    * Returns ``image``: The upright frame, BGR; None for a skipped one. A frame that cannot be decoded ends the video.
    """
    import av
    from av.video.reformatter import VideoReformatter

    reformatter = VideoReformatter()
    with _opened(path) as (container, stream):
        start_s = _start_s(stream)
        try:
            for index, frame in enumerate(container.decode(stream)):
                # Without the rounding of the decoder: 0.3 and not 0.30000000000000004.
                time_s = np.nan if frame.time is None else round(frame.time - start_s, 9)
                yield time_s, None if index < skip else upright_pixels(frame, reformatter)
        except av.error.FFmpegError:
            return


def packet_times_s(path: Path) -> list[float]:
    """Read the presentation times of all frames. The file is read, and nothing is decoded.

    * Returns: Ascending; empty where the container states no times. Frames before the start of the stream, which an
      edit list hides, are left out.
    """
    import av

    times_s: list[float] = []
    with _opened(path) as (container, stream):
        start_s, unit_s = _start_s(stream), float(stream.time_base or 0)
        try:
            for packet in islice(container.demux(stream), _MAX_FRAMES):
                stamp = packet.dts if packet.pts is None else packet.pts  # AVI has no presentation times
                if stamp is not None and packet.size:
                    times_s.append(round(stamp * unit_s - start_s, 9))
        except av.error.FFmpegError:  # the times up to the damage
            pass
    return sorted(time_s for time_s in times_s if time_s >= 0)


def _start_s(stream: VideoStream) -> float:
    return float((stream.start_time or 0) * (stream.time_base or 0))


# -- the source ------------------------------------------------------------------------------------


# A file whose first bytes have no control character but white space is a text.
_TEXT_BYTES = 4096
_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


@dataclass(frozen=True, eq=False)
class VideoSource:
    """A :class:`slam_init.types.frame.Source` over a video file. The time stamp of a frame is that of the container."""

    path: Path
    #: Number of frames as the header states, or as counted where the header states none or one that is impossible.
    length: int
    #: Mean number of frames per second. A frame without a possible time in the container comes one interval after the
    #: frame before it.
    rate_hz: float
    #: (int, int) Width and height of the upright frames in pixels.
    size: tuple[int, int]
    #: Notes about the header for the user: whether the frame rate is assumed, or the frames are turned.
    header_notes: tuple[str, ...] = ()
    kind: str = "video"
    #: camera, groundtruth: A video holds neither.
    camera: Camera | None = None
    groundtruth: Trajectory | None = None
    _seen: set[str] = field(default_factory=set, init=False, repr=False)

    @property
    def name(self) -> str:
        """File name."""
        return self.path.name

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know about the video, from its header and from the frames that were read."""
        return (*self.header_notes, *sorted(self._seen))

    @cached_property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps in seconds. The file is read for them, and nothing is decoded."""
        # A container may hold fewer times than frames, or none.
        stated_s = [*packet_times_s(self.path), *[np.nan] * self.length][: self.length]
        later = accumulate(stated_s, lambda last_s, time_s: _next_time(time_s, last_s, 1 / self.rate_hz), initial=-1.0)
        return np.array(list(later)[1:])

    def __len__(self) -> int:
        return self.length

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Decode frames in order, always from the beginning of the video, since seeking is inexact.

        A stream may end earlier than its header states. This is an error only if it ends before frame ``start``.
        """
        wanted = frame_range(self.length, start, max_frames, self.name)
        # A GIF has no fields; its few colours are dithered, which looks like a comb.
        may_have_fields, has_fields = first_bytes(self.path, 3) != b"GIF", False
        index, last_s = -1, -1.0
        for index, (time_s, image) in enumerate(islice(decoded(self.path, wanted.start), wanted.stop)):
            last_s = _next_time(time_s, last_s, 1 / self.rate_hz)
            if image is None:
                continue
            check_size(f"{self.path}, frame {index}", image.shape[1::-1], self.size, "the first frame")
            has_fields = has_fields or (may_have_fields and comb_ratio(image) > _LEAST_COMB)
            if has_fields:
                image = first_field(image)
                self._seen.add(NOTE)
            yield Frame(index, last_s, f"frame-{index:06d}", image)
        if index < wanted.start:
            raise SourceError(f"{self.path}: the video ends before frame {wanted.start}")


def open_video(path: Path) -> VideoSource:
    """Open a video file and decode its first frame."""
    import av

    # A playlist is a text with the names of other files, or of addresses, which FFmpeg would read.
    start = first_bytes(path, _TEXT_BYTES)
    if start and not _NOT_TEXT.search(start):
        raise SourceError(f"{path}: is a text, not a readable video; give a video file, or a folder of images")
    try:
        with _opened(path) as (container, stream):
            if stream.codec_context is None:
                raise SourceError(f"{path}: no installed decoder knows the codec of the video: {_CONVERT}")
            check_pixels(str(path), stream.codec_context.width, stream.codec_context.height, least=0)
            first = next(container.decode(stream), None)
            if first is None:
                raise SourceError(f"{path}: not a readable video, or a video without frames")
            quarters = _quarters(first)
            size = (first.height, first.width) if quarters % 2 else (first.width, first.height)
            rate_hz = float(stream.average_rate or stream.guessed_rate or 0)
            stated = stream.frames or np.floor((container.duration or 0) / av.time_base * rate_hz + 0.5)
    except (av.error.FFmpegError, ValueError) as error:
        cause = getattr(error, "strerror", None) or error
        raise SourceError(f"{path}: not a readable video ({cause}); give a video file, or a folder of images") from None
    notes: list[str] = []
    if quarters:
        turned = f"the frames are turned by {360 - 90 * quarters} degrees, as the video states"
        notes.append(f"{turned}: a calibration has to be that of upright images")
    if not (np.isfinite(rate_hz) and 0 < rate_hz <= 1000):
        rate_hz = NOMINAL_RATE_HZ
        notes.append(f"the video states no possible frame rate: {rate_hz:g} frames a second are assumed")
    # A frame takes at least a byte of the file.
    if not 1 <= stated <= min(path.stat().st_size, _MAX_FRAMES):
        stated = max(sum(1 for _ in islice(decoded(path, skip=_MAX_FRAMES), _MAX_FRAMES)), 1)
    return VideoSource(path, int(stated), rate_hz, size, tuple(notes))


def _next_time(time_s: float, last_s: float, interval_s: float) -> float:
    """The time of a frame: later than that of the frame before, also where the container states none or an earlier.

    * ``last_s``: -1 before the first frame.
    """
    if last_s < 0:
        return time_s if time_s >= 0 else 0.0
    return time_s if time_s > last_s else last_s + interval_s
