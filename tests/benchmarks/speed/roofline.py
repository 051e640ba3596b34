"""How near the largest stages come to the limit of the machine (roofline).

Figures of the core are measured: floating-point operations a second in a large product of matrices, and bytes a second
in copies of several sizes, which fit different caches. A stage with ``n`` operations that touches ``b`` bytes of its
input and output takes at least ``max(n / peak, b / bandwidth)``, with the bandwidth of the cache that holds ``b``.
This limit over the measured time is the share that is reached.

The operations are those of the formulas in :mod:`tests.benchmarks.speed.operations`, counted from the code: an
addition, a multiplication, a division or a root is one operation. Copies, comparisons and indices are none. The bytes
are those of the arrays that a stage reads and writes, each once. A product of matrices keeps eight multiplications and
eight additions under way at once; a loop over single numbers, such as a projection with its derivatives, has one
operation after the other and reaches a tenth of that peak at best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam_init.types.arrays import Floats

#: Side of the matrices: their product takes 0.27 billion operations in 6 MB, beyond the caches of a core's own.
_SIDE = 512
#: Bytes of source and target of the copies: they fit the first cache of a core (32 KiB or more), the second one (1 MiB
#: or more), the one that a server's cores share, and none or the largest shared ones.
_COPIES = (1 << 15, 1 << 20, 1 << 24, 1 << 28)


@dataclass(frozen=True)
class Limits:
    """What the core can do."""

    #: Floating-point operations in a second (64 bits).
    operations: float
    #: Bytes that are read and written in a second, by the size of what is read and written, in bytes and ascending.
    bandwidths: dict[int, float]

    def bandwidth(self, touched: float) -> float:
        """Bytes in a second of the smallest copy that holds what is touched; else of the largest one."""
        return next((one for size, one in self.bandwidths.items() if touched <= size), [*self.bandwidths.values()][-1])


@dataclass(frozen=True)
class Stage:
    """A stage that was measured."""

    name: str
    #: What it was measured on.
    size: str
    #: operations, bytes: Operations of one call, and memory that it touches.
    operations: float
    bytes: float
    #: CPU time of a call.
    ms: float

    def least_ms(self, limits: Limits) -> float:
        """What the machine would take at least."""
        return 1e3 * max(self.operations / limits.operations, self.bytes / limits.bandwidth(self.bytes))

    def bound(self, limits: Limits) -> str:
        """Which of the two limits it is."""
        by_memory = self.bytes / limits.bandwidth(self.bytes) > self.operations / limits.operations
        return "memory" if by_memory else "operations"


def measure_limits() -> Limits:
    """Measure the core."""
    import numpy as np

    from tests.benchmarks.speed.timing import cpu_ms

    rng = np.random.default_rng(0)
    a, b, product = (rng.normal(size=(_SIDE, _SIDE)) for _ in range(3))
    product_ms = cpu_ms(lambda: np.matmul(a, b, out=product), 15)
    bandwidths = {}
    for size in _COPIES:
        source = np.ones(size // 16)
        target, repeats = np.empty_like(source), max(1, (1 << 24) // size)

        def copies(source: Floats = source, target: Floats = target, repeats: int = repeats) -> None:
            for _ in range(repeats):
                np.copyto(target, source)

        bandwidths[size] = size * repeats / (1e-3 * cpu_ms(copies, 15))
    # Each of the n^2 elements is the sum of n products.
    return Limits(2 * _SIDE**3 / (1e-3 * product_ms), bandwidths)


def measure_stage(
    name: str, size: str, operations: float, touched: float, work: Callable[[], object], calls: int
) -> Stage:
    """Measure a stage; the first call is not counted."""
    from tests.benchmarks.speed.timing import cpu_ms

    work()
    return Stage(name, size, operations, touched, cpu_ms(work, calls))


def roofline_table(stages: Sequence[Stage], limits: Limits, flow_ms: float) -> str:
    """The table of the stages."""
    from slam_init.output.tables import markdown_table, number

    rows = []
    for stage in stages:
        least_ms = stage.least_ms(limits)
        rows.append(
            [
                stage.name,
                stage.size,
                number(1e-6 * stage.operations, 2),
                number(1e-6 * stage.bytes, 2),
                f"{number(stage.ms, 3)} ({stage.ms / flow_ms:.3f})",
                number(1e-6 * stage.operations / stage.ms, 2),
                f"{number(least_ms, 4)} ({stage.bound(limits)})",
                f"{least_ms / stage.ms:.1%}",
            ]
        )
    header = [
        "stage", "size", "million operations", "MB touched", "CPU ms (over the flow)", "billion operations / s",
        "limit of the core (ms)", "reached",
    ]  # fmt: skip
    speeds = ", ".join(f"{1e-9 * one:.0f} GB/s of {size >> 10} KiB" for size, one in limits.bandwidths.items())
    told = f"One core: {1e-9 * limits.operations:.1f} billion operations a second in a product of matrices of "
    told += f"{_SIDE}x{_SIDE}; copies read and write {speeds}. "
    told += "The formulas of the operations are in `tests.benchmarks.speed.operations`."
    return f"{told}\n\n{markdown_table(header, rows)}"
