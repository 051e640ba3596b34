"""Measures the speed of everything on one core: ``python -m tests.benchmarks.speed``.

=====================  ===============================================================================================
table                  what it shows
=====================  ===============================================================================================
frames, stages         images given to an initializer (:mod:`.frames`)
robust                 quest and PoseLib on the same matches, simulated and real (:mod:`.robust`)
start                  the first pose of a process, and ``slam-init run`` (:mod:`.start`)
=====================  ===============================================================================================

Beside the times stand their ratios to a fixed piece of work of the same run: OpenCV's flow of 400 points in an image of
640x480 pixels. The ratios of two machines, or of two states of one machine, can be compared.

All libraries run on one thread. The numerical libraries read the number of threads when they are imported, so this
package imports them only after the program has set that number.
"""

from tests.benchmarks.speed.frames import Frames, frames_table, measure, stages_table
from tests.benchmarks.speed.timing import cpu_flow_ms, flow_ms, machine

__all__ = ["Frames", "cpu_flow_ms", "flow_ms", "frames_table", "machine", "measure", "stages_table"]
