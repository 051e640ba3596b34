"""Old places of modules and names: they still import, with a :class:`DeprecationWarning`, for one release."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

__all__ = ["QUEST_MODULES", "MovedModules", "moved_names"]

#: Old module -> new modules, whose names it had; dropped in version 0.3.
QUEST_MODULES: dict[str, str] = {
    "quest.quaternion": "quest.geometry.quaternion",
    "quest.epipolar": "quest.geometry.epipolar",
    "quest.homography": "quest.geometry.homography",
    "quest.refine": "quest.geometry.refine",
    "quest.monomials": "quest.solvers.monomials",
    "quest.translation": "quest.solvers.translation",
    "quest.newton": "quest.solvers.newton",
    "quest.selection": "quest.solvers.selection",
    "quest.printed": "quest.solvers.printed",
    "quest.quest5": "quest.solvers.quest5",
    "quest.quest6": "quest.solvers.quest6",
    "quest.quest7": "quest.solvers.quest7",
    "quest.questn": "quest.solvers.questn",
    "quest.nullspace": "quest.solvers.quest6_fast",
    "quest.ransac": "quest.robust.ransac",
    "quest.search": "quest.robust.lo_ransac quest.robust.prosac",
    "quest.pose_problem": "quest.robust.pose_problem",
    "quest.kernels": "quest.robust.kernels",
    "quest.rotation": "quest.robust.rotation",
    "quest.modes": "quest.robust.pose_modes",
    "quest.neighbours": "quest.robust.spatial_blocks",
    "quest.planes": "quest.robust.plane",
    "quest.parallax": "quest.uncertainty.parallax quest.uncertainty.tails",
}


class MovedModules(MetaPathFinder, Loader):
    """Finds modules by their old names, after all other finders: the old name becomes the new module.

    Parameters
    ----------
    moved : mapping of str to str
        Old name -> new name, or several new names with a blank between them.
    """

    def __init__(self, moved: Mapping[str, str]) -> None:
        self._moved = dict(moved)

    def install(self) -> None:
        """Take part in imports from now on."""
        sys.meta_path.append(self)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a module that moved.

        Parameters
        ----------
        fullname : str
            Name that is imported.
        path, target : object
            Not used.

        Returns
        -------
        ModuleSpec or None
            None for every other module.
        """
        return importlib.util.spec_from_loader(fullname, self) if fullname in self._moved else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import the new modules, and warn.

        Parameters
        ----------
        spec : ModuleSpec
            Of the old name.

        Returns
        -------
        ModuleType
            A module of the old name with the names of the new ones.
        """
        places = self._moved[spec.name].split()
        warnings.warn(f"{spec.name} has moved to {' and '.join(places)}", DeprecationWarning, stacklevel=2)
        module = ModuleType(spec.name)
        for place in places:
            new = vars(importlib.import_module(place))
            vars(module).update({name: value for name, value in new.items() if not name.startswith("__")})
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is left to do.

        Parameters
        ----------
        module : ModuleType
            Made by :meth:`create_module`.
        """


def moved_names(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """A ``__getattr__`` for a package that was a module: its old names still work, with a warning.

    Parameters
    ----------
    package : str
        Name of the package.
    homes : mapping of str to str
        Name -> module that has it now.

    Returns
    -------
    function of str
    """

    def _find(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        warnings.warn(f"{package}.{name} has moved to {homes[name]}", DeprecationWarning, stacklevel=2)
        return getattr(importlib.import_module(homes[name]), name)

    return _find
