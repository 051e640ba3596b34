"""Every N-th frame, a lower rate, or masks: indices and times stay those of the source, and black is ignored."""

import itertools

import numpy as np
import pytest
from make_files import picture, write_image
from make_video import corner_frames, write_mp4

from slam_init.datasets import open_source
from slam_init.datasets.video import open_video
from slam_init.datasets.views import MaskedSource, SourceView, SubsampledSource, read_mask
from slam_init.errors import SourceError


@pytest.fixture(params=["images", "video"])
def source(request, tmp_path):
    """Thirty frames at 30 Hz."""
    if request.param == "video":
        return open_video(write_mp4(tmp_path / "v.mp4", corner_frames(30)))
    for i in range(30):
        write_image(tmp_path / f"{i / 30:.6f}.png", picture(i, (16, 12)))
    return open_source(str(tmp_path))


def indices_of(source, start=0, max_frames=None):
    frames = list(source.frames(start, max_frames))
    np.testing.assert_allclose(
        [frame.timestamp_s for frame in frames], [frame.index / 30 for frame in frames], atol=1e-6
    )
    return [frame.index for frame in frames]


def test_every_nth_frame_is_counted_from_the_start_frame(source):
    view = SubsampledSource(source, every=7)
    assert indices_of(view) == [0, 7, 14, 21, 28] and len(view) == 5 == len(view.timestamps_s)
    assert indices_of(view, 3) == [3, 10, 17, 24] and view.left(3) == 4
    assert indices_of(view, 3, 2) == [3, 10]


@pytest.mark.parametrize("fps", [1, 4, 10, 12, 29, 30, 60])
def test_a_rate_takes_the_frames_nearest_to_its_instants(source, fps):
    indices = indices_of(SubsampledSource(source, fps=fps))
    assert indices == sorted(set(indices)) and indices[0] == 0
    wanted = np.arange(0, 1 - 1e-9, 1 / min(fps, 30))
    assert len(indices) == pytest.approx(len(wanted), abs=1)
    for instant, index in zip(wanted, indices, strict=False):
        assert abs(index / 30 - instant) <= 0.5 / 30 + 1e-6
    assert indices_of(SubsampledSource(source, fps=fps), 5, 3) == [5 + i for i in indices[:3]]


def test_a_gap_in_the_times_gives_no_frame_twice(tmp_path):
    """A camera that stops for two seconds: the first frame after it, and then those at the regular instants."""
    for k in [*range(10), *range(70, 80)]:
        write_image(tmp_path / f"{1e9 + k / 30:.6f}.png", picture(k, (16, 12)))
    frames = list(SubsampledSource(open_source(str(tmp_path)), fps=10).frames())
    assert [frame.index for frame in frames] == [0, 3, 6, 9, 10, 12, 15, 18]


@pytest.mark.parametrize("options", [{"every": 0}, {"every": -3}, {"fps": 0.0}, {"fps": float("nan")}, {"fps": -1.0}])
def test_an_impossible_rate_is_an_error(source, options):
    with pytest.raises(SourceError, match="give"):
        SubsampledSource(source, **options)


def test_a_view_is_carried_by_a_text():
    views = (SourceView(), SourceView(every=3), SourceView(fps=7.5, mask="/a: b?&é/m.png", camera="f=9"))
    for view, text in itertools.product(views, ("/data/a: b", "synth:room?seed=3")):
        assert SourceView.parse(view.text(text)) == (view, text)
    with pytest.raises(SourceError, match="one of both"):
        SourceView(every=2, fps=3)


# -- masks -----------------------------------------------------------------------------------------


LEFT = np.zeros((48, 64), np.uint8)
LEFT[:, 32:] = 255


@pytest.fixture
def pictures(tmp_path):
    for i in range(3):
        write_image(tmp_path / "images" / f"{i}.jpg", picture(i))
    return open_source(str(tmp_path / "images"))


def test_one_mask_holds_for_all_frames(pictures, tmp_path):
    write_image(tmp_path / "m.png", LEFT)
    masked = MaskedSource(pictures, tmp_path / "m.png")
    masks = [frame.mask for frame in masked.frames(1)]
    assert len(masks) == 2 and masks[0] is masks[1] and np.array_equal(masks[0], LEFT)
    assert "ignores 50.0%" in masked.notes[-1]


@pytest.mark.parametrize("suffix", [".png", ".jpg.png"])
def test_a_folder_has_a_mask_for_each_frame_by_its_name(pictures, tmp_path, suffix):
    for i in range(3):
        write_image(tmp_path / "masks" / f"{i}{suffix}", np.roll(LEFT, i, axis=1))
    for i, frame in enumerate(MaskedSource(pictures, tmp_path / "masks").frames()):
        assert np.array_equal(frame.mask, np.roll(LEFT, i, axis=1))


def test_black_is_ignored_and_nothing_else(tmp_path):
    image = np.full((48, 64, 3), (0, 0, 1), np.uint8)
    image[0] = 0
    write_image(tmp_path / "m.png", image)
    mask = read_mask(tmp_path / "m.png")
    assert mask.shape == (48, 64) and not mask[0].any() and (mask[1:] == 255).all()


def test_of_a_mask_of_16_bits_small_numbers_count(tmp_path):
    labels = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
    write_image(tmp_path / "m.png", labels)
    assert np.array_equal(read_mask(tmp_path / "m.png") > 0, labels > 0)


def test_a_mask_that_leads_out_of_its_folder_is_one_line(pictures, tmp_path):
    path = tmp_path / "masks"
    path.mkdir()
    write_image(tmp_path / "elsewhere.png", LEFT)
    (path / "0.png").symlink_to(tmp_path / "elsewhere.png")
    with pytest.raises(SourceError, match="leads out of the folder"):
        list(SourceView(mask=str(path)).apply(pictures).frames())
