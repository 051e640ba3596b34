"""The colour of each method: the same in all charts of all reports."""

from __future__ import annotations

from collections.abc import Sequence

from slam_init.methods import METHODS

#: Number of colours of the page (``report.css``).
COLORS = 22


def method_colors(methods: Sequence[str]) -> dict[str, str]:
    """Give each method a CSS class.

    A method of the registry has the class of its place there, which does not depend on the other methods of a report.
    Two names of one method share a class, unless both are in the report. Other methods get the remaining classes in
    their order; if there are more methods than classes, classes repeat.
    """
    own = [name for name, info in METHODS.items() if info.alias_of is None]
    places = {name: position % COLORS for position, name in enumerate(own)}
    for name, info in METHODS.items():
        if info.alias_of is not None and info.alias_of not in methods:
            places[name] = places[info.alias_of]
    chosen = {method: places[method] for method in methods if method in places}
    free = [k for k in range(COLORS - 1, -1, -1) if k not in chosen.values()] or list(range(COLORS))
    others = (method for method in methods if method not in chosen)
    chosen |= {method: free[k % len(free)] for k, method in enumerate(others)}
    return {method: f"c{chosen[method]}" for method in methods}
