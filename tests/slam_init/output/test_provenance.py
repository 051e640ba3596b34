"""Laws of the provenance: equal inputs have equal hashes, and each change of the input changes the hash."""

from dataclasses import replace

import numpy as np
from make_map import CAMERAS, make_frame

from slam_init.output.summary import InputHash

FRAMES = [make_frame(k, k / 30, f"{k}.png") for k in range(3)]


def hash_of(frames, camera=CAMERAS["pinhole"]):
    hashed = InputHash(camera)
    assert list(hashed.reading(iter(frames))) == list(frames)
    return hashed.hexdigest()


def dotted(frame):
    """The same frame with one other pixel."""
    image = frame.image.copy()
    image[7, 5] += 1
    return replace(frame, image=image)


def test_equal_inputs_have_equal_hashes():
    copies = [replace(frame, image=frame.image.copy()) for frame in FRAMES]
    assert hash_of(FRAMES) == hash_of(copies)
    strided = [replace(frame, image=np.asfortranarray(frame.image)) for frame in FRAMES]
    assert hash_of(FRAMES) == hash_of(strided)


def test_each_change_of_the_frames_or_of_the_calibration_changes_the_hash():
    newest = FRAMES[2]
    others = [
        dotted(newest),
        replace(newest, name="other.png"),
        replace(newest, timestamp_s=newest.timestamp_s + 1e-9),
        replace(newest, image=newest.image.reshape(640, 480, 3)),
    ]
    for changed in (*([*FRAMES[:2], other] for other in others), FRAMES[:2], FRAMES[::-1]):
        assert hash_of(changed) != hash_of(FRAMES)
    assert hash_of(FRAMES, replace(CAMERAS["pinhole"], fx=501.0)) != hash_of(FRAMES)


def test_only_frames_that_were_read_are_hashed():
    hashed = InputHash(CAMERAS["pinhole"])
    reading = hashed.reading(iter(FRAMES))
    next(reading)
    next(reading)
    assert hashed.hexdigest() == hash_of(FRAMES[:2])
