# SPDX-License-Identifier: Apache-2.0
"""What a socket holds until a node takes it, which large frames may exceed."""

from __future__ import annotations

from pathlib import Path

# What the nodes ask for: four frames of 4096 x 4096 pixels of 16 bits.  The kernel grants less
# where its limit is lower, and takes memory only for what waits.
WANTED_BYTES = 128 * 2**20
_LIMIT = Path('/proc/sys/net/core/rmem_max')


def remedy(limit: Path = _LIMIT) -> str:
    """Return how to raise the kernel's limit, or nothing where it is high enough or unknown."""
    try:
        allowed = int(limit.read_text())
    except (OSError, ValueError):
        return ''
    if allowed >= WANTED_BYTES:
        return ''
    return (f'; sockets may hold {allowed / 1e6:.1f} MB here, and large frames need more: '
            f'sudo sysctl -w net.core.rmem_max={WANTED_BYTES}')
