"""How clearly the tracks prefer one map to another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

__all__ = ["Margin"]


@dataclass(frozen=True)
class Margin:
    """How much better one map explains the tracks than another.

    Attributes
    ----------
    log_likelihood : float
        Difference of the truncated Gaussian log likelihoods, in nats; positive where the first map is better.
    z : float
        The same as a sum over tracks, in units of the standard deviation of that sum (Vuong 1989). Each track votes by
        the difference of its two likelihoods, and the scatter of the votes tells how reliable their sum is.
    z_needed : float
        The vote decides from this z on. The default is exceeded by chance once in 30 000 cases.
    """

    #: Odds that still decide when the noise level is wrong by a factor of two.
    LOG_LIKELIHOOD_NEEDED: ClassVar[float] = 20.0

    log_likelihood: float
    z: float
    z_needed: float = 4.0

    def decides(self) -> bool:
        """Whether the first map is better beyond chance: both z and the log likelihood reach what they need."""
        return self.decision_ratio() >= 1

    def decision_ratio(self) -> float:
        """The smaller one of z and log likelihood over what is needed; the vote decides from 1 on."""
        return min(self.z / self.z_needed, self.log_likelihood / self.LOG_LIKELIHOOD_NEEDED)

    def reversed(self) -> Margin:
        """The same vote, seen from the other map."""
        return replace(self, log_likelihood=-self.log_likelihood, z=-self.z)
