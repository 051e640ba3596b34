"""A cluster is checked before the first trial, and what is wrong with it is one line that says what to do."""

import pytest

from slam_init.compare import backends
from slam_init.compare.backends import open_backend, worker_facts
from slam_init.errors import ConfigError, SlamInitError

distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="tcp"
    ) as one:
        yield one


def opened(cluster, sources=()):
    return open_backend(f"dask:{cluster.scheduler_address}", 1, sources)


def test_a_worker_without_the_data_is_refused(cluster, tmp_path):
    with opened(cluster, [str(tmp_path)]):
        pass
    absent = str(tmp_path / "absent")
    assert worker_facts([str(tmp_path), absent])[1] == [absent]
    with pytest.raises(SlamInitError, match=r"lacks .*absent: workers need the data"), opened(cluster, [absent]):
        pass


def test_a_worker_of_another_version_is_refused(cluster, monkeypatch):
    monkeypatch.setattr(backends, "worker_facts", lambda _: ({"slam-init": "0.0.1"}, []))
    with pytest.raises(SlamInitError, match=r"has slam-init 0\.0\.1, .*install the same version"), opened(cluster):
        pass


def test_a_worker_without_the_package_is_refused(cluster, monkeypatch):
    def fails(_):
        raise ModuleNotFoundError("No module named 'slam_init'")

    monkeypatch.setattr(backends, "worker_facts", fails)
    with pytest.raises(SlamInitError, match=r"cannot run slam-init .*install slam-init there"), opened(cluster):
        pass


def test_a_scheduler_without_workers_is_refused():
    options = {"n_workers": 0, "processes": False, "dashboard_address": ":0", "protocol": "tcp"}
    with (
        distributed.LocalCluster(**options) as none,
        pytest.raises(SlamInitError, match="has no workers"),
        opened(none),
    ):
        pass


@pytest.mark.parametrize(
    ("files", "told"), [({}, "needs certificates"), ({"ca-file": "/nowhere.pem"}, "certificates|TLS")]
)
def test_a_tls_address_without_certificates_is_one_line(files, told):
    import dask

    names = {"distributed.comm.tls.ca-file": files.get("ca-file")}
    names |= {f"distributed.comm.tls.client.{kind}": files.get("ca-file") for kind in ("cert", "key")}
    with dask.config.set(names), pytest.raises(ConfigError, match=told), open_backend("dask:tls://127.0.0.1:1", 1, ()):
        pass


def test_workers_that_come_later_get_tasks_as_well(cluster, monkeypatch):
    with opened(cluster) as backend:
        assert backend.workers == 1
        backend._looked -= 60.0  # a minute passes
        monkeypatch.setattr(backend._client, "nthreads", lambda: {"one": 1, "two": 2})
        assert len(list(backend.run(abs, range(5)))) == 5
        assert backend.workers == 3
