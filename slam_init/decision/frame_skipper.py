"""Which frames are not evaluated: those after windows that were far from a map.

An evaluation takes most of the time of a frame. A frame that is left out still joins the history, and later windows.
"""

from __future__ import annotations

from slam_init.decision.evaluated_window import EvaluatedWindow
from slam_init.window.levels import EVEN_ODDS, WRONG_DIRECTION_DEG

#: Frames that are not evaluated where the last window, of so many views or more, left this standard deviation of the
#: direction (degrees): twice what is wrong. In a steady motion it falls with the power 3/2 of the views, so that ten
#: views in place of six leave half of it, which is no map. A sudden motion shows in the score of the pairs.
#: Class: geometry, in frames, views and degrees.
_LONGEST_REST, _MANY_VIEWS, _FAR_DEG = 3, 6, 2 * WRONG_DIRECTION_DEG
#: After a window whose map is wrong at even odds or worse, this number of frames is not evaluated while the score has
#: grown by less than this factor: the tracks have less than half as much information again. With more frames left out,
#: motions are lost between two windows: of four simulated worlds without a map after three such frames, two have one
#: after one.
#: Class: level, as a factor and in frames.
_MORE_INFORMATIVE, _SKIPPED_AT_EVEN_ODDS = 1.2, 1
#: A camera that turns for long shows as little after a hundred frames as after ten. So either number may grow to this
#: share of the frames so far, and a map comes later by that share at the most. Before a camera that turns in the hand
#: (TUM fr1/rpy) a frame takes 43 ms in the median, and 227 if all are evaluated.
#: Class: level, as a share.
_SHARE_OF_FRAMES = 0.1


class FrameSkipper:
    """Counts the frames that were left out since the last evaluation. A frame without motion never comes here."""

    def __init__(self) -> None:
        # The best score of the pairs of the last frame that was not left out.
        self._score = 0.0
        self._skipped, self._frames = 0, 0

    def count_and_skip(self, score: float, last: EvaluatedWindow | None) -> bool:
        """Whether a frame is left out; called once a frame.

        * ``score``: The best score of its pairs (:attr:`~slam_init.frontend.keyframes.PairPreview.direction_score`).
        * ``last``: The last window; None without one.
        """
        self._frames += 1
        if last is not None and self._skipped < self._most(score, last):
            self._skipped += 1
            return True
        self._score, self._skipped = score, 0
        return False

    def _most(self, score: float, last: EvaluatedWindow) -> int:
        """The number of frames in a row that may be left out after a window."""
        share = int(_SHARE_OF_FRAMES * self._frames)
        if len(last.best.rows) < _MANY_VIEWS:
            return 0
        if last.risk.directions.sigma_deg * self._score > _FAR_DEG * score:
            return max(_LONGEST_REST, share)
        if last.risk.total > EVEN_ODDS and score < _MORE_INFORMATIVE * self._score:
            return max(_SKIPPED_AT_EVEN_ODDS, share)
        return 0
