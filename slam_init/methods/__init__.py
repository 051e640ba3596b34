"""Methods of initialization behind one interface: that of this project, and those of other systems.

The methods of other systems are written from their published rules; no code is copied. The constants of each method are
in a frozen dataclass in its module, each with its source.
"""

from slam_init.methods.registry import METHODS, MethodInfo, make_initializer, make_two_view, method_info

__all__ = ["METHODS", "MethodInfo", "make_initializer", "make_two_view", "method_info"]
