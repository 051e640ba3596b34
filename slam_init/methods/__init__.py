"""Ways to initialize, behind one interface: ours, and those of other systems written from their rules.

The numbers of each stand in a frozen dataclass beside it, with their source. The rules carry over, no code does.
"""

from slam_init.methods.registry import (
    METHODS,
    FrontEnd,
    MethodInfo,
    make_initializer,
    make_two_view,
    method_info,
)

__all__ = ["METHODS", "FrontEnd", "MethodInfo", "make_initializer", "make_two_view", "method_info"]
