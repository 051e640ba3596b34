"""Matchers of two images, which may take the place of the optical flow: OpenCV's, kornia's, hloc's, or your own.

A matcher takes two images and gives matched points with scores (:class:`Matcher`).
:mod:`slam_init.frontend.matched_tracks` makes tracks of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from slam_init.errors import ConfigError
from slam_init.frontend.sift import detect_sift, first_per_cell, match_descriptors
from slam_init.system.user_code import attribute_of, described_error
from slam_init.types.arrays import Floats, Image

#: Images whose features are kept: those that :mod:`slam_init.frontend.matched_tracks` matches a new image with, and it.
_KEPT = 10
#: Most features of SIFT and ORB.
_FEATURES = 2500
#: Keypoints of a learned detector: LightGlue was trained with 2048.
_KEYPOINTS = 2048
#: hloc's configurations where none are named.
_HLOC = "superpoint_aachen,superpoint+lightglue"


@runtime_checkable
class Matcher(Protocol):
    """Matches two images."""

    def __call__(self, image1: Image, image2: Image, /) -> tuple[Any, Any, Any]:
        """Match two images.

        Parameters
        ----------
        image1, image2 : (H, W) or (H, W, 3) uint8
            Grey or BGR, as the initializer gets them. The same image is given as the same object.

        Returns
        -------
        points1, points2 : (N, 2) float
            Raw pixels of matched points; the centre of the first pixel is (0, 0).
        scores : (N,) float
            The larger the better. Of two matches of one point, the better one is taken.
        """
        ...


class FeatureMatcher(ABC):
    """Base of matchers that detect features in each image: those of the last images are kept."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Image, Any]] = {}

    def __call__(self, image1: Image, image2: Image, /) -> tuple[Floats, Floats, Floats]:
        """Match two images."""
        return self.match(self._features_of(image1), self._features_of(image2))

    @abstractmethod
    def features(self, image: Image) -> Any:
        """Detect and describe the features of an image.

        Parameters
        ----------
        image : (H, W) or (H, W, 3) uint8

        Returns
        -------
        object
            What :meth:`match` takes.
        """

    @abstractmethod
    def match(self, features1: Any, features2: Any) -> tuple[Floats, Floats, Floats]:
        """Match the features of two images.

        Parameters
        ----------
        features1, features2 : object
            From :meth:`features`.

        Returns
        -------
        points1, points2 : (N, 2) float
        scores : (N,) float
            As of :class:`Matcher`.
        """

    def _features_of(self, image: Image) -> Any:
        if id(image) not in self._known:  # the image is kept as well, so that its number is of no other one
            self._known[id(image)] = (image, self.features(image))
            while len(self._known) > _KEPT:
                del self._known[next(iter(self._known))]
        return self._known[id(image)][1]


class SiftMatcher(FeatureMatcher):
    """OpenCV's SIFT with mutual nearest neighbours and Lowe's ratio."""

    #: Largest distance of the nearest neighbour over that of the second nearest.
    ratio: ClassVar[float] = 0.8

    def features(self, image: Image) -> tuple[Floats, Floats]:
        """Detect keypoints (N, 2), with descriptors (N, 128) of unit norm."""
        found = detect_sift(_gray(image), _FEATURES)
        return found.pixels, found.descriptors

    def match(self, features1: Any, features2: Any) -> tuple[Floats, Floats, Floats]:
        """Match by the cosine of the descriptors, which is the score."""
        (pixels1, described1), (pixels2, described2) = features1, features2
        i, j = match_descriptors(described1, described2, self.ratio)
        return pixels1[i], pixels2[j], np.sum(described1[i] * described2[j], axis=1)


class OrbMatcher(SiftMatcher):
    """OpenCV's ORB with mutual nearest neighbours and the ratio."""

    #: On the root of the Hamming distance. 0.9 of it is 0.8 of the distance, as in OpenCV's examples.
    ratio: ClassVar[float] = 0.9

    def features(self, image: Image) -> tuple[Floats, Floats]:
        """Detect keypoints (N, 2). Bits become signs, so that the distance of the unit vectors is that of Hamming."""
        import cv2

        keypoints, described = cv2.ORB.create(nfeatures=_FEATURES).detectAndCompute(_gray(image), None)
        if not keypoints:
            return np.zeros((0, 2)), np.zeros((0, 256))
        pixels = np.array([one.pt for one in keypoints])
        single = first_per_cell(pixels, 1.0)  # a corner is found at several octaves
        bits = np.unpackbits(np.asarray(described, np.uint8)[single], axis=1)
        return pixels[single], (2.0 * bits - 1.0) / np.sqrt(bits.shape[1])


class LightGlueMatcher(FeatureMatcher):
    """DISK and LightGlue of kornia. kornia downloads their weights at the first use."""

    def __init__(self) -> None:
        super().__init__()
        import torch
        from kornia.feature import DISK, LightGlueMatcher

        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self._disk = DISK.from_pretrained("depth").to(self._device).eval()
        self._lightglue = LightGlueMatcher("disk").to(self._device).eval()

    def features(self, image: Image) -> Any:
        """Detect and describe the keypoints of an image."""
        import torch

        with torch.inference_mode():
            (found,) = self._disk(_tensor(image, self._device), _KEYPOINTS, pad_if_not_divisible=True)
        return found.keypoints, found.descriptors, image.shape[:2]

    def match(self, features1: Any, features2: Any) -> tuple[Floats, Floats, Floats]:
        """Match by LightGlue, whose confidence is the score."""
        import torch
        from kornia.feature import laf_from_center_scale_ori

        (pixels1, described1, size1), (pixels2, described2, size2) = features1, features2
        frames = [laf_from_center_scale_ori(pixels[None]) for pixels in (pixels1, pixels2)]
        with torch.inference_mode():
            scores, pairs = self._lightglue(described1, described2, *frames, hw1=size1, hw2=size2)
        i, j = pairs.T
        return _array(pixels1[i]), _array(pixels2[j]), _array(scores).ravel()


class HlocMatcher(FeatureMatcher):
    """Sparse features and a matcher of hloc, by the names of their configurations.

    * ``names``: Of ``hloc.extract_features.confs`` and ``hloc.match_features.confs``, with a comma.
    """

    def __init__(self, names: str = _HLOC) -> None:
        super().__init__()
        import torch
        from hloc import extract_features, extractors, match_features, matchers
        from hloc.utils.base_model import dynamic_load

        feature, _, matcher = names.partition(",")
        for name, known in ((feature, extract_features.confs), (matcher, match_features.confs)):
            if name not in known:
                raise ConfigError(f"hloc has no configuration {name!r:.60}: use one of {', '.join(known)}")
        configured, matching = extract_features.confs[feature], match_features.confs[matcher]["model"]
        self._grey = bool(configured["preprocessing"].get("grayscale"))
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        detector = dynamic_load(extractors, configured["model"]["name"])(configured["model"])
        self._detector = detector.eval().to(self._device)
        self._matcher = dynamic_load(matchers, matching["name"])(matching).eval().to(self._device)

    def features(self, image: Image) -> Any:
        """Detect and describe the keypoints of an image, at its full size."""
        import torch

        tensor = _tensor(_gray(image) if self._grey else image, self._device, grey=self._grey)
        with torch.inference_mode():
            found = self._detector({"image": tensor})
        # hloc stores the features of one image, and its matchers get them with the dimension of the batch.
        return {name: value[0][None] for name, value in found.items()} | {"image": tensor}

    def match(self, features1: Any, features2: Any) -> tuple[Floats, Floats, Floats]:
        """Match by hloc's matcher."""
        import torch

        given = {f"{name}{k}": value for k, one in enumerate((features1, features2)) for name, value in one.items()}
        with torch.inference_mode():
            found = self._matcher(given)
        j = _array(found["matches0"][0]).astype(int)
        i = np.flatnonzero(j >= 0)
        pixels1, pixels2 = (_array(one["keypoints"][0]) for one in (features1, features2))
        return pixels1[i], pixels2[j[i]], _array(found["matching_scores0"][0])[i]


#: The matchers by name: how to make one, and what to install where that fails.
_MATCHERS: dict[str, tuple[Callable[[], Matcher], str]] = {
    "sift": (SiftMatcher, ""),
    "orb": (OrbMatcher, ""),
    "lightglue": (LightGlueMatcher, "pip install kornia"),
    "hloc": (HlocMatcher, "install hloc from its repository"),
}


def make_matcher(name: str) -> Matcher:
    """Make a matcher by its name.

    * ``name``: ``sift``, ``orb``, ``lightglue``, ``hloc``, ``hloc:FEATURES,MATCHER``, or an attribute of your own code
      as ``package.module:attribute`` or ``file.py:attribute``: a matcher, or a class of matchers.
    """
    kind, colon, names = name.partition(":")
    make, remedy = _MATCHERS.get(kind, (None, ""))
    try:
        if make is not None and not (colon and kind != "hloc"):
            return HlocMatcher(names) if colon else make()
        if not colon:
            known = ", ".join(_MATCHERS)
            own = "module:attribute or file.py:attribute"
            raise ConfigError(f"unknown matcher {name!r:.60}: use {known}, hloc:FEATURES,MATCHER, {own}")
        found = attribute_of(name)
        matcher = found() if isinstance(found, type) else found
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:  # a third-party module may raise anything
        hint = f": {remedy}" if remedy and isinstance(error, ImportError) else ""
        raise ConfigError(f"the matcher {name} cannot be loaded ({described_error(error)}){hint}") from error
    if not isinstance(matcher, Matcher):
        raise ConfigError(f"the matcher {name} is of the type {type(matcher).__name__}: give a callable of two images")
    return matcher


def _gray(image: Image) -> Image:
    import cv2

    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _tensor(image: Image, device: Any, *, grey: bool = False) -> Any:
    """The image as (1, 3, H, W) in RGB, or as (1, 1, H, W), from 0 to 1."""
    import torch

    if image.ndim == 3:
        planes = image[..., ::-1].transpose(2, 0, 1)
    else:
        planes = np.repeat(image[None], 1 if grey else 3, axis=0)
    return torch.from_numpy(np.ascontiguousarray(planes)).to(device).float()[None] / 255.0


def _array(tensor: Any) -> Any:
    return tensor.cpu().numpy().astype(float)
