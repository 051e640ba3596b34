"""The patch around each track where it began: each frame aligns it, so that a track comes back to its point.

Flow from frame to frame moves a patch by a displacement alone. Where the view turns or comes nearer, the patch is
sheared and scaled as well, and the best displacement is not that of its centre. The error is the change of the patch
times the distance of its corners from the centre, which is some pixels. It grows with the change of the view and not
with time, as parallax does. On rendered images it reaches .2 to .4 px (median) within twenty frames, ten times the
noise. So the patch of the frame in which a track began is aligned with each frame by an affine map, a mean and a
contrast, from where the track is expected or flow ends (:mod:`~slam_init.frontend.flow`). The median error stays
at .03 to .05 px (hand-held: .11, where that of flow is .8).

One patch determines its affine map less precisely than all patches of a frame together do. The maps of the patches that
were cut in one frame are a linear function of the place, as those of a plane are, and a deviation, whose variance is
that of their scatter. Given this distribution, a displacement is a conditional mean. A patch whose map is far from the
mean lies on another surface, and keeps its own map.

An alignment is accepted where it ends near its start and leaves little. Else the track goes on by flow, and drifts.
Where alignments fail for some frames (the view has changed, or the track lies on a border of two surfaces), the patch
is cut again.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from slam_init.frontend.patch_size import SIDE_PX, UNKNOWNS, WIDE
from slam_init.types.arrays import Bools, Floats, Image, Ints, Pairs

Number = TypeVar("Number", bound=np.generic)

#: What the motion of a patch leaves at an edge, px: it turns, bends, and hides what is behind it. Unlike noise it is
#: alike along the edge and does not average out, so that a track slides along the edge by this times the ratio of the
#: slopes across and along. Across the epipolar lines of true poses, tracks whose ratio is 2, 4, 7 and 15 are off by .1,
#: .13, .2 and .5 px (median), and some by the length of the edge.
#: Class: measured.
MISFIT_PX = 0.05
#: An alignment ends this far from the flow at most, px: twenty standard deviations of both.
_NEAR_PX = 1.0
#: It leaves this share of the contrast of the patch at most, or this multiple of what the flow leaves between two
#: frames: dim patches have as much noise as contrast.
_LITTLE, _AS_FLOW = 0.35, 1.5
#: Root of the mean square of Gaussian numbers over their mean absolute value.
_ROOT_OVER_MEAN = 1.25
#: A patch is cut again when this number of alignments in a row have failed.
_FAILURES = 3
#: What rounding leaves between two images, grey levels: the root of two twelfths.
_ROUNDING = 0.4
#: Standard deviation of an alignment over that by independent errors of the pixels: 1.3 to 1.9 on rendered images.
_SCALE = 1.6
#: Fewer patches of a frame than this determine no distribution of their maps, whose means have twelve unknowns.
_LEAST_PATCHES = 24
#: A patch whose map deviates by more from the mean lies on another surface.
_ELSEWHERE_SIGMAS = 3.0
#: Deviation of the Gaussian that images are smoothed by before they are aligned, px. Between the pixels of a sharp
#: corner the slopes are those of the interpolation: without the Gaussian, alignments of a sharp checkerboard are off by
#: .085 px, with it by .065. On noisy images a larger one costs more than it gains.
_SMOOTHED_PX = 0.7
#: Of the displacements that stand for an affine map, from the centre of a patch.
_BORDER_PX = SIDE_PX // 2
#: The affine map of a patch that has just been cut, row by row.
_IDENTITY: Floats = np.array([1.0, 0.0, 0.0, 1.0])


def smoothed(image: Image) -> Image:
    """The image that patches are cut out of and aligned with."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), _SMOOTHED_PX), np.uint8)


def pairs_of(image: Image) -> Pairs:
    """Each pixel of an image with the one to its right as one number, the left one in its lower bits.

    Shapes: ``image`` (H, W), returns (H W - 1,), a view of the image.

    A place between pixels needs two of them, at half the reads.
    """
    return np.ndarray((image.size - 1,), np.dtype("<u2"), image, strides=(1,))


def anisotropy(products: Floats) -> Floats:
    """Differences (N,) of the eigenvalues of structure tensors (N, 2, 2): 0 where the slopes have no direction."""
    xx, xy, yy = products[:, 0, 0], products[:, 0, 1], products[:, 1, 1]
    return np.asarray(np.hypot(xx - yy, 2 * xy))


class Sought(NamedTuple):
    """Alignments of the patches of some tracks with an image, before they are accepted."""

    #: (N, 2) Where the alignments end.
    pixels: Floats
    #: (N, 4) The affine maps.
    affine: Floats
    #: (N,) Root of the mean square of what is left over the contrast; infinite where there is no alignment.
    residuals: Floats

    @property
    def found(self) -> Bools:
        """Which alignments leave little, (N,)."""
        return np.asarray(self.residuals <= _LITTLE)


class Aligned(NamedTuple):
    """Tracks that were aligned with a frame."""

    #: (N,) Whether the alignment is accepted.
    succeeded: Bools
    #: (N, 2) By the alignment where it is accepted, as given elsewhere.
    pixels: Floats
    #: (N, 2, 2) Covariance of the drift since each track began, where the alignment is accepted, px^2.
    drifts: Floats


class Patches:
    """The patches of the tracks of the last frame. Its images are :func:`smoothed`."""

    def __init__(self) -> None:
        # By slot: a track has one while it lives. Single precision is a thousand times finer than the noise.
        self._patches = np.zeros((0, 3, SIDE_PX, WIDE), np.float32)
        self._inverses, self._brightness = np.zeros((0, UNKNOWNS, UNKNOWNS)), np.zeros((0, 2))
        self._affine, self._drifts, self._anisotropy = np.zeros((0, 4)), np.zeros((0, 2, 2)), np.zeros(0)
        # Alignments in a row that failed, and the frame in which a patch was cut: a running number.
        self._failures, self._cut, self._frames = np.zeros(0, np.int64), np.zeros(0, np.int64), 0
        # In ascending order of the tracks.
        self._ids, self._slots = np.zeros(0, np.int64), np.zeros(0, np.int64)

    def seek(self, image: Image, track_ids: Ints, pixels: Floats) -> Sought:
        """Align the patches of tracks with an image, from given places.

        Shapes: ``image`` (H, W), ``track_ids`` (N,), ``pixels`` (N, 2).

        * ``pixels``: NaN where a track has no place.
        """
        from slam_init.frontend.patch_kernel import align_patches

        sought = Sought(pixels.copy(), np.zeros((len(pixels), 4)), np.full(len(pixels), np.inf))
        rows, slots = self._slots_of(track_ids)
        placed = np.isfinite(pixels[rows]).all(axis=1)
        rows, slots = rows[placed], slots[placed]
        places = np.hstack([pixels[rows], self._affine[slots]])
        sought.residuals[rows] = align_patches(
            pairs_of(image), np.array(image.shape), slots, self._patches, self._inverses, self._brightness, places
        )
        sought.pixels[rows], sought.affine[rows] = places[:, :2], places[:, 2:]
        return sought

    def align(
        self, image: Image, track_ids: Ints, pixels: Floats, remainders: Floats, sought: Sought | None = None
    ) -> Aligned:
        """Align the patches of tracks with an image, from where flow ends.

        Shapes: ``image`` (H, W), ``track_ids`` (N,), ``pixels`` (N, 2), ``remainders`` (N,).

        * ``remainders``: Mean absolute difference that flow leaves, grey levels.
        * ``sought``: Of these tracks: those that are found already end at their pixels, without flow. The others are
          added to it.
        """
        from slam_init.frontend.patch_kernel import distribution_of_maps

        if sought is None:
            sought = self.seek(image, track_ids, pixels)
        else:
            others = np.flatnonzero(~sought.found)
            for found, by_flow in zip(sought, self.seek(image, track_ids[others], pixels[others]), strict=True):
                found[others] = by_flow
        succeeded, moved = np.zeros(len(track_ids), bool), pixels.copy()
        drifts = np.zeros((len(track_ids), 2, 2))
        rows, slots = self._slots_of(track_ids)
        ends, affine, residuals = sought.pixels[rows], sought.affine[rows], sought.residuals[rows]
        accepted = np.isfinite(residuals) & (np.linalg.norm(ends - pixels[rows], axis=1) <= _NEAR_PX)
        greys = np.where(accepted, residuals, 0.0) * self._brightness[slots, 1]
        accepted &= (residuals <= _LITTLE) | (greys <= _AS_FLOW * _ROOT_OVER_MEAN * remainders[rows])
        self._failures[slots] = np.where(accepted, 0, self._failures[slots] + 1)
        rows, slots, ends, affine = rows[accepted], slots[accepted], ends[accepted], affine[accepted]
        noise = _SCALE * np.maximum(greys[accepted], _ROUNDING)
        variances = noise**2 + MISFIT_PX**2 * self._anisotropy[slots]
        covariances = variances[:, None, None] * self._inverses[slots, :6, :6]
        covariances = _moved_by(_in_image(affine), covariances)
        of_maps = np.ascontiguousarray(np.diagonal(covariances, axis1=1, axis2=2)[:, 2:])
        means, scatter = np.full_like(affine, np.nan), np.zeros_like(affine)
        for frame in np.unique(self._cut[slots]):
            cut = np.flatnonzero(self._cut[slots] == frame)
            if len(cut) >= _LEAST_PATCHES:
                means[cut], scatter[cut] = distribution_of_maps(ends[cut], _BORDER_PX * affine[cut], of_maps[cut])
        ends, affine, places = _given_maps(ends, affine, covariances, means, scatter)
        self._affine[slots] = affine
        succeeded[rows], moved[rows] = True, ends
        drifts[rows] = _moved_by(affine.reshape(-1, 2, 2), self._drifts[slots]) + places
        return Aligned(succeeded, moved, drifts)

    def follow(self, image: Image, track_ids: Ints, pixels: Floats, drifts: Floats) -> None:
        """Keep the patches of the tracks of a frame, and cut those of the tracks that have none or that fail.

        Shapes: ``image`` (H, W), ``track_ids`` (N,) in ascending order, ``pixels`` (N, 2), ``drifts`` (N, 2, 2).

        * ``drifts``: Covariances of the drifts since the tracks began.
        """
        from slam_init.frontend.patch_kernel import cut_patches

        self._frames += 1
        kept = np.isin(self._ids, track_ids, assume_unique=True) & (self._failures[self._slots] < _FAILURES)
        new = np.flatnonzero(~np.isin(track_ids, self._ids[kept], assume_unique=True))
        slots = self._free(np.setdiff1d(np.arange(len(self._cut)), self._slots[kept], assume_unique=True), len(new))
        was_cut = cut_patches(
            pairs_of(image), np.array(image.shape), pixels[new], slots, self._patches, self._inverses, self._brightness
        )
        new, slots = new[was_cut], slots[was_cut]
        self._affine[slots], self._drifts[slots] = _IDENTITY, drifts[new]
        slopes = self._patches[slots, 1:].reshape(-1, 2, SIDE_PX * WIDE).astype(float)
        self._anisotropy[slots] = anisotropy(slopes @ np.swapaxes(slopes, 1, 2))
        self._failures[slots], self._cut[slots] = 0, self._frames
        ids, slots = np.concatenate([self._ids[kept], track_ids[new]]), np.concatenate([self._slots[kept], slots])
        order = np.argsort(ids)
        self._ids, self._slots = ids[order], slots[order]

    def _slots_of(self, track_ids: Ints) -> tuple[Ints, Ints]:
        """Which tracks have a patch, and their slots."""
        _, rows, known = np.intersect1d(track_ids, self._ids, assume_unique=True, return_indices=True)
        return rows, self._slots[known]

    def _free(self, free: Ints, count: int) -> Ints:
        """A number of free slots, of which some are new where there are too few."""
        more = count - len(free)
        if more <= 0:
            return free[:count]
        first = len(self._cut)
        self._patches, self._inverses = _extended(self._patches, more), _extended(self._inverses, more)
        self._brightness, self._anisotropy = _extended(self._brightness, more), _extended(self._anisotropy, more)
        self._affine, self._drifts = _extended(self._affine, more), _extended(self._drifts, more)
        self._failures, self._cut = _extended(self._failures, more), _extended(self._cut, more)
        return np.append(free, np.arange(first, first + more))


def _moved_by(maps: Floats, covariances: Floats) -> Floats:
    """Covariances (N, D, D) after linear maps (N, D, D)."""
    return np.asarray(maps @ covariances @ np.swapaxes(maps, 1, 2))


def _in_image(affine: Floats) -> Floats:
    """How the steps of alignments move places and affine maps, row by row, (N, 6, 6).

    A step is that of the patch before its map (N, 4): a displacement ``u`` moves the place by ``A u``, and a change
    ``D`` of the map moves it by ``A D``.
    """
    maps = np.zeros((len(affine), 6, 6))
    for pair in ([0, 1], [2, 4], [3, 5]):  # the place, then the columns of the map
        maps[:, np.array(pair)[:, None], pair] = affine.reshape(-1, 2, 2)
    return maps


def _given_maps(
    ends: Floats, affine: Floats, covariances: Floats, means: Floats, scatter: Floats
) -> tuple[Floats, Floats, Floats]:
    """Places, affine maps and covariances of the places, given the distribution of the maps.

    Shapes: ``covariances`` (N, 6, 6), ``means, scatter`` (N, 4).

    * ``means``: Of the maps, as displacements at the border of a patch; NaN for a patch that keeps its own map.
    * ``scatter``: Variances of their deviations.
    """
    deviations = means - _BORDER_PX * affine
    variances = np.diagonal(covariances, axis1=1, axis2=2)[:, 2:]
    here = np.all(np.abs(deviations) <= _ELSEWHERE_SIGMAS * np.sqrt(variances + scatter), axis=1)
    own = covariances[here]
    of_maps = own[:, 2:, 2:] + scatter[here][:, :, None] * np.eye(4)
    gains = np.swapaxes(np.linalg.solve(of_maps, own[:, 2:]), 1, 2)
    changes = (gains @ deviations[here][:, :, None])[:, :, 0]
    ends, affine, places = ends.copy(), affine.copy(), covariances[:, :2, :2].copy()
    ends[here] += changes[:, :2]
    affine[here] += changes[:, 2:] / _BORDER_PX
    places[here] -= gains[:, :2] @ own[:, 2:, :2]
    return ends, affine, places


def _extended(values: NDArray[Number], more: int) -> NDArray[Number]:
    """The values of all slots (S, ...), with zeros for some new ones."""
    return np.concatenate([values, np.zeros((more, *values.shape[1:]), values.dtype)])
