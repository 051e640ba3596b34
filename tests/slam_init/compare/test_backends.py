"""Backends are opened by name."""

import pytest

from slam_init.compare.backends import open_backend
from slam_init.errors import ConfigError


@pytest.mark.parametrize("name", ["spark", "dask:", ""])
def test_an_unknown_backend_is_an_error(name):
    with pytest.raises(ConfigError, match="unknown backend"), open_backend(name, 1):
        pass


@pytest.mark.parametrize(("name", "jobs"), [("sequential", 1), ("loky", 1)])
def test_every_task_is_answered_once(name, jobs):
    with open_backend(name, jobs) as backend:
        assert sorted(backend.run(abs, iter([-3, -2, -1]))) == [(-3, 3), (-2, 2), (-1, 1)]
