"""A Dask cluster that runs trials: it is checked before the first trial, and its loss is an error with a remedy."""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module, metadata
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from slam_init.compare.backend import Backend
from slam_init.errors import ConfigError, SlamInitError

#: A scheduler has to answer within this time.
_CONNECT = "10s"
#: A cluster may replace its workers, but not for longer than this. It is looked at this often.
_WITHOUT_WORKERS_S, _POLL_S = 60.0, 5.0
#: Trials of one source in one task. A worker that has no tracks of the source computes them, which takes as long as ten
#: or more trials on a sequence of 1000 frames. A comparison that is killed runs the trials of open batches again.
_LARGEST_BATCH = 50
#: The packages whose versions have to be equal: arguments and answers are pickled.
_SAME_VERSIONS = ("distributed", "python")

#: HOST:PORT, with a protocol or without; an address of IPv6 is in brackets.
_ADDRESS = re.compile(r"([a-z]{1,9}://)?(\[[0-9a-fA-F:.]{2,45}\]|[\w.-]{1,255}):\d{1,5}")

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


@dataclass(frozen=True)
class WorkerFacts:
    """What a worker has."""

    #: Of slam-init.
    version: str
    #: The sources that do not exist there.
    missing: tuple[str, ...]


def worker_facts(sources: Sequence[str]) -> WorkerFacts:
    """Tell what this machine has."""
    return WorkerFacts(metadata.version("slam-init"), tuple(text for text in sources if not os.path.lexists(text)))


@contextmanager
def open_cluster(address: str, sources: Sequence[str] = ()) -> Iterator[Backend]:
    """Connect to the scheduler of a cluster, and check its workers.

    * ``address``: ``HOST:PORT``, ``tcp://HOST:PORT``, or ``tls://HOST:PORT`` with the certificates in Dask's
      configuration (``distributed.comm.tls``).
    """
    if not _ADDRESS.fullmatch(address):
        raise ConfigError(f"{address[:80]!r} is no address of a scheduler: give dask:HOST:PORT or dask:tls://HOST:PORT")
    try:
        distributed: Any = import_module("distributed")  # the package has no type annotations
    except ImportError:
        raise ConfigError("the backend dask needs the package distributed: pip install '.[dask]'") from None
    _check_certificates(distributed, address)
    with _quiet():
        try:
            client = distributed.Client(address, timeout=_CONNECT, set_as_default=False)
        except Exception as error:  # a server of another protocol or version may cause any
            cause = " ".join(str(error).split()) or type(error).__name__
            raise SlamInitError(f"no Dask scheduler answers at {address}: {cause}"[:300]) from None
        try:
            _check_cluster(client, address, sources)
            # pure=False: Dask must not reuse the answer of an earlier call with equal arguments.
            yield _Cluster(client, client.get_executor(pure=False), address)
        finally:
            client.close(timeout=_POLL_S)


def _check_certificates(distributed: Any, address: str) -> None:
    """Refuse a TLS address without certificates: Dask finds them in its configuration."""
    if not address.startswith("tls://"):
        return
    try:
        context = distributed.Security().get_connection_args("client").get("ssl_context")
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"the TLS files of Dask's configuration cannot be used: {error}"[:300]) from None
    if context is None:
        keys = "distributed.comm.tls.ca-file, .client.cert and .client.key"
        raise ConfigError(f"{address} needs certificates: name them in Dask's configuration ({keys})")


class _Cluster(Backend):
    """The workers of a cluster, whose number may change; a lost cluster is an error."""

    largest_batch = _LARGEST_BATCH

    def __init__(self, client: Any, executor: Any, address: str) -> None:
        super().__init__(executor, sum(client.nthreads().values()))
        self._client = client
        self._address = address
        self._looked = self._seen = time.monotonic()

    def run(self, function: Callable[[_Task], _Answer], tasks: Iterable[_Task]) -> Iterator[tuple[_Task, _Answer]]:
        try:
            yield from super().run(function, tasks)
        except (CancelledError, OSError, TimeoutError) as error:
            raise _lost(f"the Dask scheduler at {self._address} was lost", error) from None
        except RuntimeError as error:  # KilledWorker; a closed client
            raise _lost(f"the Dask cluster at {self._address} gave a trial up", error) from None

    def _next(self, ended: SimpleQueue[Future[Any]]) -> Future[Any]:
        self._seen = time.monotonic()
        while True:
            self._count_workers()
            try:
                return ended.get(timeout=_POLL_S)
            except Empty:
                continue

    def _count_workers(self) -> None:
        """Look at the number of workers now and then: a cluster grows and shrinks."""
        now = time.monotonic()
        if now - self._looked < _POLL_S:
            return
        self._looked = now
        found = sum(self._client.nthreads().values())
        if found:
            self.workers, self._seen = found, now
        elif now - self._seen > _WITHOUT_WORKERS_S:
            raise _lost(f"the Dask scheduler at {self._address} has lost its workers", None)


def _lost(what: str, error: BaseException | None) -> SlamInitError:
    cause = "" if error is None or not str(error) else f" ({' '.join(str(error).split())[:200]})"
    return SlamInitError(f"{what}{cause}: completed trials are kept; start it again, and repeat the command")


def _check_cluster(client: Any, address: str, sources: Sequence[str]) -> None:
    """Raise an error if trials cannot run on the cluster."""
    if not client.nthreads():
        raise SlamInitError(f"the Dask scheduler at {address} has no workers: start at least one")
    versions = client.get_versions()
    ours = _versions(versions["client"])
    others = {"the scheduler": versions["scheduler"]} | {f"the worker {k}": v for k, v in versions["workers"].items()}
    for name, facts in others.items():
        theirs = _versions(facts)
        for package in _SAME_VERSIONS:
            if theirs[package] != ours[package]:
                raise SlamInitError(
                    f"{name} at {address} has {package} {theirs[package]}, and this machine {ours[package]}: install "
                    "the same version"
                )
    for worker, facts in client.run(worker_facts, list(sources), on_error="return").items():
        if isinstance(facts, BaseException):
            cause = " ".join(str(facts).split())[:200]
            raise SlamInitError(f"the Dask worker {worker} cannot run slam-init ({cause}): install slam-init there")
        _check_worker(worker, facts)


def _check_worker(worker: str, facts: WorkerFacts) -> None:
    ours = metadata.version("slam-init")
    if facts.version != ours:
        raise SlamInitError(
            f"the Dask worker {worker} has slam-init {facts.version}, and this machine {ours}: install the same version"
        )
    if facts.missing:
        raise SlamInitError(
            f"the Dask worker {worker} lacks {facts.missing[0]}: workers need the data under the same path"
        )


def _versions(facts: Mapping[str, Any] | None) -> dict[str, str]:
    """Versions of the packages that have to be equal; of Python without the patch level."""
    packages = (facts or {}).get("packages", {})
    found = {package: str(packages.get(package)) for package in _SAME_VERSIONS}
    found["python"] = ".".join(found["python"].split(".")[:2])
    return found


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask logs each failure with a traceback; the error that is raised tells it in one line."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)
