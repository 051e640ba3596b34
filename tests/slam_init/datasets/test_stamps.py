"""Each reader converts time stamps of any unit, states it, and refuses what is no time."""

import numpy as np
import pytest
from make_files import write, write_image
from make_layouts import eth3d, euroc, kitti, pose

from slam_init.datasets import open_source
from slam_init.errors import SourceError
from slam_init.types.frame import notes_of

UNITS = {"seconds": 1, "milliseconds": 10**3, "microseconds": 10**6, "nanoseconds": 10**9}
TIMES_S = {"from zero": (0, 0.05, 0.1, 0.15), "a date": (1403636579.75, 1403636579.8, 1403636579.85, 1403636579.9)}


def texts(times_s, unit):
    """As files print them: seconds with digits, the others as whole numbers."""
    return [f"{t:.6f}" if unit == "seconds" else str(round(t * 10**6) * UNITS[unit] // 10**6) for t in times_s]


READERS = {"tum": eth3d, "euroc": euroc, "kitti": kitti}


@pytest.mark.parametrize("times_s", TIMES_S.values(), ids=TIMES_S)
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("reader", READERS)
def test_each_reader_converts_each_unit_and_reports_it(tmp_path, reader, unit, times_s):
    source = open_source(READERS[reader](tmp_path, texts(times_s, unit)))
    np.testing.assert_allclose(source.timestamps_s, times_s, atol=2e-3 if unit == "milliseconds" else 1e-6, rtol=0)
    np.testing.assert_array_equal([frame.timestamp_s for frame in source.frames(1)], source.timestamps_s[1:])
    stated = "nanoseconds" if reader == "euroc" else "seconds"
    assert any(unit in note for note in notes_of(source)) == (unit != stated)
    if source.groundtruth is not None:
        np.testing.assert_allclose(source.groundtruth.at(float(source.timestamps_s[2])).t, pose(2)[:3, 3], atol=1e-9)


@pytest.mark.parametrize(
    ("stamps", "word"),
    [
        (["0", "nan", "2", "3"], "nan|finite"),
        (["0", "inf", "2", "3"], "inf|finite"),
        (["-2", "-1", "0", "1"], "negative"),
        (["0", "1", "1", "2"], "after the one before"),
        (["0", "2", "1", "3"], "after the one before"),
        ([str(2**63 + k) for k in (0, 10**5, 2 * 10**5, 3 * 10**5)], "2\\^63"),
        (["1", "1e400", "2", "3"], "1e400|finite"),
        ([str(14 * 10**17 + k) for k in range(4)], "after the one before"),  # a double does not tell them apart
    ],
)
@pytest.mark.parametrize("reader", READERS)
def test_each_reader_refuses_what_is_no_time_in_one_line(tmp_path, reader, stamps, word):
    with pytest.raises(SourceError, match=word):
        open_source(READERS[reader](tmp_path, stamps))


@pytest.mark.parametrize("unit", UNITS)
def test_names_of_images_that_are_dates_in_any_unit_are_times(tmp_path, unit):
    for text in texts(TIMES_S["a date"], unit):
        write_image(tmp_path / f"{text}.png")
    source = open_source(str(tmp_path))
    np.testing.assert_allclose(source.timestamps_s, TIMES_S["a date"], atol=1e-5)
    assert bool(source.notes) == (unit not in ("seconds", "nanoseconds"))


@pytest.mark.parametrize(("images", "truth"), [("seconds", "nanoseconds"), ("nanoseconds", "seconds")])
def test_a_ground_truth_of_another_unit_is_put_on_the_clock_of_the_images(tmp_path, images, truth):
    times_s = TIMES_S["a date"]
    folder = eth3d(tmp_path, texts(times_s, images))
    rows = [f"{stamp} {i} 0 0 0 0 0 1\n" for i, stamp in enumerate(texts(times_s, truth))]
    write(tmp_path / "groundtruth.txt", "".join(rows))
    source = open_source(folder)
    assert [source.groundtruth.at(t).t[0] for t in source.timestamps_s.tolist()] == [0, 1, 2, 3]
    assert any("ground truth" in note for note in source.notes) == (truth == "nanoseconds")
