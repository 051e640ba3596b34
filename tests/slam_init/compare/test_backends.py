"""Backends are opened by name."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from slam_init.compare.backend import Backend
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


@pytest.mark.parametrize("workers", [1, 3])
def test_tasks_are_read_only_as_workers_become_free(workers):
    read = []

    def tasks():
        for task in range(50):
            read.append(task)
            yield task

    with ThreadPoolExecutor(workers) as executor:
        answers = Backend(executor, workers).run(abs, tasks())
        for answered, _ in enumerate(answers):
            assert len(read) <= answered + 2 * workers
    assert read == list(range(50))


def test_the_error_of_a_task_is_raised_and_the_waiting_tasks_are_cancelled():
    ran = []

    def fails(task):
        ran.append(task)
        raise ValueError(task)

    with ThreadPoolExecutor(1) as executor, pytest.raises(ValueError, match="0"):
        list(Backend(executor, 1).run(fails, range(100)))
    assert len(ran) <= 3
