"""Backends are opened by name."""

import errno
from concurrent.futures import ThreadPoolExecutor

import pytest

from slam_init.compare.backends import Backend, open_backend
from slam_init.errors import ConfigError, SlamInitError


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


@pytest.mark.parametrize("address", ["nope", "nope:", "no pe:80", "http//x:1", ":80", "host:port"])
def test_what_is_no_address_of_a_scheduler_is_told_at_once(address):
    with pytest.raises(ConfigError, match="is no address of a scheduler"), open_backend(f"dask:{address}", 1):
        pass


@pytest.mark.parametrize("at", ["made", "used"])
def test_a_machine_that_gives_no_processes_is_told_the_sequential_backend(at, monkeypatch):
    import loky

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    if at == "made":
        monkeypatch.setattr(loky, "ProcessPoolExecutor", refuse)
    with pytest.raises(SlamInitError, match="use --backend sequential"), open_backend("loky", 1):
        raise OSError(errno.EMFILE, "Too many open files")
