# SPDX-License-Identifier: Apache-2.0
"""What rclpy otherwise does when a node first uses a kind of message, or its log."""

from __future__ import annotations

import inspect
import sys

from rclpy.type_support import check_for_type_support


def preload() -> None:
    """
    Load the type support of every message and service whose package has been imported.

    The logger of rclpy asks which module a message comes from, and `inspect` looks through the
    files of all modules the first time, which takes longer than a frame may take.
    """
    for name, module in list(sys.modules.items()):
        if name.endswith(('.msg', '.srv')):
            for kind in vars(module).values():
                if hasattr(type(kind), '_TYPE_SUPPORT'):
                    check_for_type_support(kind)
    inspect.getmodule(inspect.currentframe())
