"""Small videos for tests, with the tags that phones write."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest


def corner_frames(count: int = 6, size: tuple[int, int] = (64, 48)) -> list[np.ndarray]:
    """Frames whose top left quarter is bright, each a little brighter than the one before."""
    frames = [np.full((size[1], size[0], 3), 20, np.uint8) for _ in range(count)]
    for k, frame in enumerate(frames):
        frame[: size[1] // 2, : size[0] // 2] = 150 + 100 * k // count
    return frames


def write_grey(path: Path, levels: Iterable[int], fps: float) -> Path:
    """Write a video of JPEG images of 64x48 pixels by OpenCV, each of one grey level."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for level in levels:
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    return path


def write_mp4(path: Path, frames: list[np.ndarray], turned_deg: int = 0) -> Path:
    """Write a video by OpenCV; ``turned_deg`` is the clockwise rotation that its track header asks for."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (width, height))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for frame in frames:
        writer.write(frame)
    writer.release()
    if turned_deg:
        data = bytearray(path.read_bytes())
        # The matrix comes 40 bytes after the name of the box, as nine fixed-point numbers (ISO 14496-12, 8.3.2).
        cos, sin = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[turned_deg]
        matrix = [cos << 16, sin << 16, 0, -sin << 16, cos << 16, 0, 0, 0, 1 << 30]
        at = data.index(b"tkhd") + 44
        data[at : at + 36] = struct.pack(">9i", *matrix)
        path.write_bytes(data)
    return path


def write_by_pyav(
    path: Path,
    frames: list[np.ndarray],
    *,
    codec: str = "mpeg4",
    pixels: str = "yuv420p",
    times_ms: list[int] | None = None,
    tags: dict[str, str] | None = None,
    options: dict[str, str] | None = None,
) -> Path:
    """Write a video by PyAV: frames at any times, tags of the container, any codec that it encodes."""
    av = pytest.importorskip("av")
    from fractions import Fraction

    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(tags or {})
        try:
            stream = container.add_stream(codec, rate=30, options=options or {})
        except (ValueError, av.error.FFmpegError) as error:
            pytest.skip(f"this PyAV has no encoder {codec}: {error}")
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        stream.codec_context.max_b_frames = 0
        for k, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts = times_ms[k] if times_ms is not None else 33 * k
            frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
