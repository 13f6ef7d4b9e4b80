# SPDX-License-Identifier: Apache-2.0
"""
What the tests of a session count, for the last lines of its output.

The tests may run in several worker processes: each hands its counts to the process that prints.
"""

from collections import Counter

# Faults that tests injected into running graphs, by kind.
FAULTS: Counter[str] = Counter()
# Inputs that the fuzz tests tried, by kind.
INPUTS: Counter[str] = Counter()


def counts() -> dict[str, dict[str, int]]:
    """Return the counts of this process, in a form that a worker can send."""
    return {'faults': dict(FAULTS), 'inputs': dict(INPUTS)}


def add(other: dict[str, dict[str, int]]) -> None:
    """Add the counts of another process."""
    FAULTS.update(other['faults'])
    INPUTS.update(other['inputs'])


def summary() -> list[str]:
    """Return the lines that say how much was tried; none where nothing was."""
    lines = []
    if FAULTS:
        lines.append(f'{FAULTS.total()} faults injected, of {len(FAULTS)} kinds')
    if INPUTS:
        kinds = ', '.join(f'{count} {kind}' for kind, count in sorted(INPUTS.items()))
        lines.append(f'fuzzed inputs: {INPUTS.total()} ({kinds})')
    return lines
