"""Many pairs at once, on threads: the compiled loops run without the lock of the interpreter."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from numpy.typing import ArrayLike

from quest.errors import as_index
from quest.estimate import estimate_relative_pose
from quest.relative_pose import NoPose, RelativePose


def estimate_relative_poses(
    pairs: Iterable[tuple[ArrayLike, ArrayLike]], *, threads: int = 1, **options: Any
) -> list[RelativePose | NoPose]:
    """Estimate the motion of each pair of views.

    Parameters
    ----------
    pairs : iterable of (bearings1, bearings2)
        Matched rays (N, 3) of each pair; N may differ.
    threads : int
        Number of pairs at a time. The results do not depend on it.
    **options
        Of :func:`quest.estimate_relative_pose`, the same for all pairs.

    Returns
    -------
    list of RelativePose or NoPose
        In the order of the pairs.

    Raises
    ------
    InputError
        If threads is not a number from 1, or a pair or an option is refused.
    """
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(as_index(threads, "threads", 1)) as pool:
        return list(pool.map(lambda pair: estimate_relative_pose(*pair, **options), pairs))
