"""A method that fails spoils only its own trial."""

from dataclasses import replace

import pytest
from comparisons import SOURCES

from slam_init.compare.isolation import isolated_trial
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Settings, Trial

HOSTILE = "hostile"


@pytest.mark.parametrize(
    ("method", "cause"),
    [
        ("failing_methods:Raises", "RuntimeError: no such thing as a pose"),
        (f"{HOSTILE}:Aborts", "the process died (SIGABRT)"),
        (f"{HOSTILE}:EatsMemory", "more than 400 MB of memory"),
        (f"{HOSTILE}:LoopsInPython", "no answer within 0.5 s"),
    ],
)
def test_a_method_that_fails_spoils_only_its_own_trial(method, cause):
    source = describe_sources(SOURCES[:1])[0]
    settings = Settings(memory_limit_mb=400)
    # The first trial starts the process and imports the libraries. Only after that half a second is a long time.
    isolated_trial(Trial(source, "stella", 0), settings)
    limit_s = 0.5 if "Loops" in method else 60.0
    failed = isolated_trial(Trial(source, method, 0), replace(settings, time_limit_s=limit_s))
    assert (failed.outcome, failed.reason) == ("error", cause)
    assert isolated_trial(Trial(source, "stella", 0), settings).outcome != "error"
