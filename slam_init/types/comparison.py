"""How clearly the tracks prefer one map to another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

__all__ = ["Margin"]


@dataclass(frozen=True)
class Margin:
    """By how much one map explains the tracks better than another.

    Attributes
    ----------
    log_likelihood : float
        Difference of the truncated Gaussian log-likelihoods, in nats.
    z : float
        The same as a sum over tracks in units of its own fluctuation (Vuong 1989): tracks vote, each by as much as it
        knows, and the scatter of the votes says how far their sum can be trusted.
    z_needed : float
        One chance in 30 000 for a fair coin, where it is not stated otherwise.
    """

    LOG_LIKELIHOOD_NEEDED: ClassVar[float] = 20.0

    log_likelihood: float
    z: float
    z_needed: float = 4.0

    def decides(self) -> bool:
        """Beyond chance, and by odds that a wrong noise level by a factor of two does not turn."""
        return self.share() >= 1

    def share(self) -> float:
        """How far the vote is on its way to a decision; from 1 on it has decided."""
        return min(self.z / self.z_needed, self.log_likelihood / self.LOG_LIKELIHOOD_NEEDED)

    def reversed(self) -> Margin:
        """The same seen from the other map."""
        return replace(self, log_likelihood=-self.log_likelihood, z=-self.z)
