"""The package quest as seen from outside: its public names and its version."""

import importlib.metadata

import quest


def test_dir_shows_the_public_names_and_the_version():
    assert dir(quest) == sorted([*quest.__all__, "__version__"])
    assert all(hasattr(quest, name) for name in dir(quest))


def test_the_version_is_that_of_the_distribution():
    """That of slam-init, or of quest-relpose where quest is installed alone."""
    installed = {one.name: one.version for one in importlib.metadata.distributions()}
    assert quest.__version__ == (installed.get("slam-init") or installed["quest-relpose"])
