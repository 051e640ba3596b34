"""What is no frame, no track or no measurement is refused in one line, and the right one can then be given."""

from dataclasses import replace

import numpy as np
import pytest
from make_map import bytes_of, make_poses
from make_scene import CAMERA, CONFIG, cloud, observe, texture

from slam_init import Camera, Frame, Initializer, Observations, SlamInitError
from slam_init.types.inertial import Gravity

COUNT = 200
#: What is no number, whatever number is wanted.
NO_NUMBERS = (
    None,
    "0.1",
    b"1",
    1j,
    np.nan,
    np.inf,
    True,
    [0.1],
    np.ones(2),
    10**400,
    np.longdouble("1e4000"),
    object(),
)


def masked(array):
    return np.ma.masked_array(array, np.arange(array.size).reshape(array.shape) == 1)


def no_arrays(array):
    """What is none of the shape and the type of numbers of an array."""
    yield from (
        None,
        "text",
        5,
        [[1.0], [2.0, 3.0]],
        object(),
        array.astype(str),
        array.astype(object) + 1j,
        array[:-1],
    )
    yield from (masked(array), array[..., None], array.astype(complex), [*array.ravel().tolist()[:-1], "a"])
    if array.dtype == float:
        yield from (np.where(np.arange(array.size).reshape(array.shape) == 1, bad, array) for bad in (np.nan, np.inf))
        yield array.astype(np.longdouble) * np.longdouble("1e4000")
    else:
        yield array + 0.5


def views():
    points = cloud(np.random.default_rng(0), COUNT)
    seen = observe(CAMERA, make_poses(8), points, 0.3, np.random.default_rng(1))
    further = {"colors": np.full((COUNT, 3), 7, np.uint8), "drifts": np.tile(0.01 * np.eye(2), (COUNT, 1, 1))}
    return [replace(one, step_px=1.0, exposure_s=0.01, **further) for one in seen]


@pytest.mark.parametrize(
    ("axes", "named"),
    [
        ((1, -1, -1), "OpenGL"),
        ((1, -1, 1), "y up"),
        ((-1, -1, 1), "x left"),
        ((-1, -1, -1), "from the points to the camera"),
        ((1, 1, -1), "z backward"),
    ],
)
def test_rays_in_other_axes_are_named(axes, named):
    right = views()[0]
    with pytest.raises(SlamInitError, match=named):
        Initializer(CAMERA).process_tracks(replace(right, bearings=right.bearings * axes))


def test_rays_of_another_camera_are_reported():
    right, other = views()[0], replace(CAMERA, fx=0.5 * CAMERA.fx, fy=0.5 * CAMERA.fy)
    with pytest.raises(SlamInitError, match=r"give camera\.bearings"):
        Initializer(CAMERA).process_tracks(replace(right, bearings=other.bearings(right.pixels)))


def wrong_tracks(right):
    """Calls that an initializer has to refuse, for each argument of the tracks of a frame."""

    def with_(**changed):
        return lambda it: it.process_tracks(replace(right, **changed))

    ids = right.track_ids
    for name in ("track_ids", "pixels", "bearings", "colors", "drifts"):
        yield from (with_(**{name: wrong}) for wrong in no_arrays(getattr(right, name)))
    for wrong in (-1 - ids, ids + 2**56, ids[::-1].astype(np.uint32), 0 * ids, ids.astype(np.uint64) + 2**63):
        yield with_(track_ids=wrong)
    yield from (
        with_(bearings=wrong) for wrong in (2 * right.bearings, 0 * right.bearings, right.bearings * (1, -1, -1))
    )
    yield from (with_(drifts=wrong) for wrong in (-right.drifts, right.drifts[:3]))
    yield from (
        with_(colors=wrong) for wrong in (right.colors[:3], right.colors[:, :2], right.colors.astype(np.uint16))
    )
    yield with_(pixels=right.pixels + 1e7)
    for name in ("timestamp_s", "step_px", "exposure_s", "turn_error", "readout_s"):
        yield from (with_(**{name: wrong}) for wrong in NO_NUMBERS)
    yield from (with_(**{name: -1.0}) for name in ("timestamp_s", "step_px", "exposure_s", "turn_error"))
    yield from (with_(turn_rad_s=wrong) for wrong in no_arrays(np.ones(3)) if wrong is not None)
    yield from (with_(frame=wrong) for wrong in (*NO_NUMBERS, 0.5, -4, 2**56))
    yield from (with_(name=wrong) for wrong in (None, 5))
    yield from (lambda it, wrong=wrong: it.process_tracks(wrong) for wrong in (None, ids, "tracks", [right]))
    yield from (lambda it, wrong=wrong: it.process_tracks(right, revised=wrong) for wrong in (None, [3], right))
    yield lambda it: it.process_tracks(right, right.pixels)
    for name, array in (("ids", ids), ("pixels", right.pixels)):
        for wrong in no_arrays(array):
            yield lambda it, given={"ids": ids, "pixels": right.pixels, name: wrong}: it.process_tracks(*given.values())
    yield lambda it: it.process_tracks(0 * ids, right.pixels)
    yield from measurements(lambda it, **given: it.process_tracks(right, **given))
    yield lambda it: it.process(np.zeros((480, 640), np.uint8))


def measurements(process):
    """Calls with measurements of gravity and of the rotation that are none."""
    for wrong in (*no_arrays(np.array([0.0, 1.0, 0.0])), (0, 0, 0)):
        yield lambda it, wrong=wrong: process(it, gravity=Gravity(wrong, 1.0))
    for wrong in (*NO_NUMBERS, 0.0, 90.0):
        yield lambda it, wrong=wrong: process(it, gravity=Gravity((0, 1, 0), wrong))
    yield from (lambda it, wrong=wrong: process(it, gravity=wrong) for wrong in ("down", (0, 1, 0), 9.8))
    for wrong in (*no_arrays(np.eye(3)), np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.full((3, 3), 1e308), "no", 3):
        if wrong is not None:
            yield lambda it, wrong=wrong: process(it, rotation=wrong)
    for wrong in (*NO_NUMBERS, 0.0, -1.0, 2.0):
        yield lambda it, wrong=wrong: process(it, rotation=np.eye(3), rotation_sigma_rad=wrong)


def wrong_images(right, index, time_s):
    """Calls that an initializer has to refuse, for each argument of an image."""
    for wrong in (None, "a.png", right.tolist(), right.astype(float), right.astype(np.uint16), right.astype(bool),
                  masked(right), right[::2, ::2], right[:-1], right[:, :0], right[0], right[..., None],
                  np.dstack(4 * [right])):  # fmt: skip
        yield lambda it, wrong=wrong: it.process(wrong, time_s)
        yield lambda it, wrong=wrong: it.process(Frame(index, time_s, "", wrong))
    for wrong in (*NO_NUMBERS, -1.0, 0.0, 2.0**63):
        if wrong is not None:
            yield lambda it, wrong=wrong: it.process(right, wrong)
        yield lambda it, wrong=wrong: it.process(Frame(index, wrong, "", right))
    mask = np.full(right.shape, 255, np.uint8)
    for wrong in (mask.astype(float), mask[:-1], mask[..., None], masked(mask), "mask", mask.tolist()):
        yield lambda it, wrong=wrong: it.process(right, time_s, mask=wrong)
        yield lambda it, wrong=wrong: it.process(Frame(index, time_s, "", right, wrong))
    yield from (
        lambda it, wrong=wrong: it.process(Frame(wrong, time_s, "", right)) for wrong in (0, -1, 1.5, "3", 2**56)
    )
    yield lambda it: it.process(Frame(index, time_s, None, right))
    yield lambda it: it.process(Frame(index, time_s, "", right, gravity=(0, 1, 0)))
    yield from measurements(lambda it, **given: it.process(right, time_s, **given))
    yield lambda it: it.process_tracks(np.arange(3), np.ones((3, 2)))


def refused(call, initializer):
    with pytest.raises(SlamInitError) as message:
        call(initializer)
    assert "\n" not in str(message.value) and ": " in str(message.value)  # what is wrong: what to do


def test_refused_tracks_leave_no_trace():
    plain, tried = Initializer(CAMERA, CONFIG), Initializer(CAMERA, CONFIG)
    for k, right in enumerate(views()):
        if k == 1:
            for call in wrong_tracks(right):
                refused(call, tried)
        assert bool(tried.process_tracks(right)) == bool(plain.process_tracks(right))
    assert tried.frames_read == plain.frames_read
    assert bytes_of(tried.finish().map) == bytes_of(plain.finish().map)


def test_refused_images_leave_no_trace():
    image, camera = texture(0, 120, 200), CAMERA.scaled(0.25)
    plain, tried = Initializer(camera, CONFIG), Initializer(camera, CONFIG)
    for k in range(4):
        right = np.ascontiguousarray(image[:, 3 * k : 3 * k + 160])
        if k == 2:
            for call in wrong_images(right, k, 0.1 * k):
                refused(call, tried)
        for one in (tried, plain):
            one.process(right, 0.1 * k)
    seen = [[(one.timestamp_s, one.pixels.tobytes()) for one in it.history] for it in (tried, plain)]
    assert seen[0] == seen[1] and len(seen[0]) == tried.frames_read == 4


OTHER_ARRAYS = {
    "big-endian": lambda array: array.astype(array.dtype.newbyteorder(">")),
    "long double": lambda array: array.astype(np.longdouble) if array.dtype == float else array.astype(np.int16),
    "Fortran": np.asfortranarray,
    "strided": lambda array: np.repeat(array, 2, axis=0)[::2],
    "masked": np.ma.asarray,
    "list": lambda array: array.tolist(),
    "read-only": lambda array: np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape),
}


def test_arrays_in_other_forms_are_the_same_tracks():
    given = views()
    made = {}
    for name, other in {"plain": np.asarray, **OTHER_ARRAYS}.items():
        initializer = Initializer(CAMERA, CONFIG)
        for one in given:
            fields = ("track_ids", "pixels", "bearings", "drifts")
            if initializer.process_tracks(replace(one, **{field: other(getattr(one, field)) for field in fields})):
                break
        made[name] = bytes_of(initializer.finish().map)
    assert all(one == made["plain"] for one in made.values())


def test_ids_and_pixels_are_the_tracks_of_the_camera_of_the_initializer():
    """In any order, and without the rays; pixels that the lens does not see are left out."""
    lens = Camera("radtan", 640, 480, 500.0, 500.0, 319.5, 239.5, (-0.1, 0.0, 0.0, 0.0))
    points = cloud(np.random.default_rng(0), COUNT)
    seen = observe(lens, make_poses(8), points, 0.3, np.random.default_rng(1))
    by_rays, by_ids = Initializer(lens, CONFIG), Initializer(lens, CONFIG)
    for k, one in enumerate(seen):
        known = Observations(k, k / 30, f"frame-{k:06d}", one.track_ids, one.pixels, one.bearings)
        order = np.random.default_rng(k).permutation(COUNT)
        ids, pixels = [*one.track_ids[order], 10**9], [*one.pixels[order], (5000.0, 5000.0)]
        assert bool(by_rays.process_tracks(known)) == bool(by_ids.process_tracks(ids, pixels, k / 30))
    assert bytes_of(by_rays.finish().map) == bytes_of(by_ids.finish().map)
    timeless = Initializer(lens)
    timeless.process_tracks(seen[0].track_ids, seen[0].pixels)
    assert [(one.frame, one.timestamp_s) for one in timeless.history] == [(0, 0.0)]


def test_a_camera_is_made_of_numbers():
    right = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5}
    further = {"focal_sigma": 0.1, "readout_ms": 10.0}
    for name in (*right, *further):
        for wrong in NO_NUMBERS:
            if wrong is not None or name in right:
                refused(lambda _, name=name, wrong=wrong: Camera("pinhole", **(right | further | {name: wrong})), None)
    for wrong in no_arrays(np.array([0.1, 0.0, 0.0, 0.0])):
        refused(lambda _, wrong=wrong: Camera("radtan", **right, distortion=wrong), None)
    refused(lambda _: Camera("pinhole", **(right | {"width": 64.5})), None)
    for kind in (np.longdouble, np.float32, np.float16):
        made = Camera("radtan", *map(kind, right.values()), distortion=np.zeros(4, ">f4"))
        assert made == Camera("radtan", *right.values(), distortion=(0.0,) * 4)
        assert all(type(value) is float for value in made.parameters) and type(made.width) is int
