"""The margin of a vote between two maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Margin:
    """The amount by which one map explains the tracks better than another.

    Attributes
    ----------
    log_likelihood : float
        Difference of the truncated Gaussian log likelihoods, in nats; positive where the first map is better.
    z : float
        The same difference, in units of its standard deviation if both maps explain the tracks equally well
        (after Vuong 1989). Each track votes by the difference of its two log likelihoods; the votes against the
        first map tell the standard deviation (:mod:`slam_init.window.risk`).
    z_needed : float
        Smallest z that decides the vote. Two equally good maps exceed the default once in 30 000 cases.
    """

    #: Smallest log likelihood that decides the vote, also if the assumed noise is wrong by a factor of two.
    LOG_LIKELIHOOD_NEEDED: ClassVar[float] = 20.0

    log_likelihood: float
    z: float
    z_needed: float = 4.0

    def decides(self) -> bool:
        """Return whether the first map is significantly better.

        * Returns: True if both z and the log likelihood reach their required values.
        """
        return self.decision_ratio() >= 1

    def decision_ratio(self) -> float:
        """Divide z and the log likelihood by their required values.

        * Returns: The smaller one of the two ratios; the vote decides from 1 on.
        """
        return min(self.z / self.z_needed, self.log_likelihood / self.LOG_LIKELIHOOD_NEEDED)
