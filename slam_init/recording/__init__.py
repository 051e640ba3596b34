"""The recording of a run for the Rerun viewer: frames, tracks, attempts, maps.

Rerun takes half a second to load. The modules ``rerun_recorder``, ``layout`` and ``views`` load it; a run loads them
when it records.
"""

import os

# Rerun must not send usage data. It reads this variable when it is imported.
os.environ.setdefault("RERUN_ANALYTICS", "false")
