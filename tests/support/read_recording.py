"""Reads a rerun recording back."""

import os
import subprocess
import sys

from rerun.chunk import RrdReader


def rerun_tool(*arguments):
    environment = os.environ | {"RERUN_ANALYTICS": "false"}
    return subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", *map(str, arguments)], env=environment, capture_output=True, check=False
    )


def chunks(path, entity):
    return [chunk.to_record_batch() for chunk in RrdReader(path).stream().filter(content=entity)]


def column(path, entity, name):
    return [value for batch in chunks(path, entity) if name in batch.schema.names for value in batch[name].to_pylist()]


def entities(path):
    return {str(chunk.entity_path) for chunk in RrdReader(path).stream()}
