"""A graph of ROS 2 with one node and a peer that sends it messages: a fake with the calls of rclpy.

Messages pass as CDR, serialized and read by the message definitions of ``rosbags``: a field of a wrong name or type
fails. The fake resolves names, and keeps the states and managed publishers of a lifecycle node. It has no quality of
service, no threads and no discovery.
"""

from __future__ import annotations

import sys
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np


class _Success(Enum):
    SUCCESS = "success"
    FAILURE = "failure"
    ERROR = "error"


class FakeGraph:
    """Calls the node directly, and keeps what it publishes by topic."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.received: dict[str, list[Any]] = defaultdict(list)
        self.warnings: list[str] = []
        self.listeners: dict[str, Callable[[Any], None]] = {}

    def node(self, **parameters: Any) -> Any:
        """Make the node with the fake of rclpy."""
        from slam_init_ros.node import InitializerNode

        return InitializerNode(graph=self, parameters=parameters)

    def send(self, topic: str, message: Any) -> None:
        """Send a message; the answer is there at once."""
        listener = self.listeners.get(topic)
        if listener is not None:
            listener(self.passed(message))

    def passed(self, message: Any) -> Any:
        """The message as it arrives."""
        raw = self.store.serialize_cdr(message, message.__msgtype__)
        return self.store.deserialize_cdr(raw, message.__msgtype__)

    def modules(self) -> dict[str, ModuleType]:
        """The modules that a node imports."""
        modules: dict[str, ModuleType] = {}

        def module(name: str, **content: Any) -> None:
            modules[name] = ModuleType(name)
            vars(modules[name]).update(content)

        qos = SimpleNamespace(TRANSIENT_LOCAL=1, BEST_EFFORT=2)
        module("rclpy")
        module("rclpy.executors", ExternalShutdownException=type("ExternalShutdownException", (Exception,), {}))
        module("rclpy.lifecycle", LifecycleNode=FakeLifecycleNode, TransitionCallbackReturn=_Success)
        module("rclpy.qos", DurabilityPolicy=qos, QoSProfile=lambda **options: options, ReliabilityPolicy=qos)
        for kind in self.store.types:
            package, _, name = kind.split("/")
            if f"{package}.msg" not in modules:
                module(package)
                module(f"{package}.msg")
            setattr(modules[f"{package}.msg"], name, self._maker(kind))
        return modules

    def _maker(self, kind: str) -> Callable[..., Any]:
        def make(**fields: Any) -> Any:
            for key, value in fields.items():
                assert not (isinstance(value, np.ndarray) and value.dtype == np.uint8), f"rclpy takes no array as {key}"
                if isinstance(value, array):
                    fields[key] = np.array(value)
                if isinstance(value, bytes):
                    (fields[key],) = value
            return self.store.types[kind](**fields)

        return make


class FakeLifecycleNode:
    """A lifecycle node with one transition after the other: https://design.ros2.org/articles/node_lifecycle.html."""

    def __init__(self, name: str, *, graph: FakeGraph, parameters: dict[str, Any]) -> None:
        self.name, self._graph, self._given = name, graph, parameters
        self._parameters: dict[str, Any] = {}
        self.state = "unconfigured"

    def declare_parameter(self, name: str, default: Any) -> None:
        self._parameters[name] = SimpleNamespace(value=self._given.get(name, default))

    def get_parameter(self, name: str) -> Any:
        return self._parameters[name]

    def resolve_topic_name(self, name: str) -> str:
        return name if name.startswith("/") else name.replace("~", f"/{self.name}") if "~" in name else f"/{name}"

    def create_lifecycle_publisher(self, type_: Any, topic: str, qos: Any) -> Any:
        def publish(message: Any) -> None:
            if self.state == "active":
                self._graph.received[self.resolve_topic_name(topic)].append(self._graph.passed(message))

        return SimpleNamespace(publish=publish)

    def destroy_lifecycle_publisher(self, publisher: Any) -> None:
        del publisher.publish

    def create_subscription(self, type_: Any, topic: str, callback: Callable[[Any], None], qos: Any) -> str:
        topic = self.resolve_topic_name(topic)
        self._graph.listeners[topic] = callback
        return topic

    def destroy_subscription(self, topic: str) -> None:
        del self._graph.listeners[topic]

    def destroy_node(self) -> None:
        self._graph.listeners.clear()

    def get_logger(self) -> Any:
        def keep(text: str, **_: Any) -> None:
            self._graph.warnings.append(text)

        return SimpleNamespace(info=lambda *_, **__: None, warning=keep, error=keep)

    def _change(self, before: str, callback: Callable[[Any], _Success], after: str) -> _Success:
        assert self.state == before, f"a transition from {self.state}"
        result = callback(None)
        if result == _Success.SUCCESS:
            self.state = after
        return result

    def trigger_configure(self) -> _Success:
        return self._change("unconfigured", self.on_configure, "inactive")

    def trigger_activate(self) -> _Success:
        return self._change("inactive", self.on_activate, "active")

    def trigger_deactivate(self) -> _Success:
        return self._change("active", self.on_deactivate, "inactive")

    def trigger_cleanup(self) -> _Success:
        return self._change("inactive", self.on_cleanup, "unconfigured")

    def _succeed(self, state: Any) -> _Success:
        return _Success.SUCCESS

    on_configure = on_activate = on_deactivate = on_cleanup = on_shutdown = on_error = _succeed


@contextmanager
def fake_graph() -> Iterator[FakeGraph]:
    """A graph whose node imports the fake of rclpy."""
    fake = FakeGraph()
    modules = fake.modules()
    saved = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield fake
    finally:
        for name, module in saved.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
        for name in [name for name in sys.modules if name.startswith("slam_init_ros")]:
            del sys.modules[name]
