# SPDX-License-Identifier: Apache-2.0
"""
The process of conditioner, detectors and trackers that share one (``bringup.py --composed``).

Its arguments are those of the process, and then ``--node``, module and arguments of each node.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
from functools import partial
from importlib import import_module
import sys
from typing import Any

from lowsnr_common.ros.node_main import run_together

_CLASSES = {
    'lowsnr_sensor.conditioner_node': 'ConditionerNode',
    'lowsnr_detect.node.detector_node': 'DetectorNode',
    'lowsnr_track.tracker_node': 'TrackerNode'}


def make_node(module: str, *arguments: str) -> Any:
    """Return the node of a module; arguments from ``--ros-args`` on are for ROS."""
    own = arguments[:arguments.index('--ros-args')]
    return getattr(import_module(module), _CLASSES[module])(
        *own, cli_args=list(arguments[len(own):]), use_global_arguments=False)


def split(words: Iterable[str]) -> Iterator[list[str]]:
    """Yield the words before the first ``--node``, and those after each."""
    part: list[str] = []
    for word in words:
        if word == '--node':
            yield part
            part = []
        else:
            part.append(word)
    yield part


def main() -> None:
    """Run the nodes."""
    of_process, *nodes = split(sys.argv[1:])
    run_together([partial(make_node, *node) for node in nodes], of_process)


if __name__ == '__main__':
    main()
