# SPDX-License-Identifier: Apache-2.0
"""One run at a time on a ROS domain: two graphs on one would receive each other's frames."""

from __future__ import annotations

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import re
import stat
import tempfile
import time
from typing import TextIO

_LARGEST = 232  # DDS has no ports for more
# A node of a run, by its command.
_NODE = re.compile(r' -m lowsnr_\w+\.(?:\w+\.)*(\w+_node) ')
# How long nodes may take to end after their bring-up was killed.
_ENDING_S, _LOOK_EVERY_S = 5.0, 0.05
_REMEDY = ': remove it, or set TMPDIR to a folder of your own'


def claim_domain(shared: bool = False) -> TextIO:
    """
    Claim the ROS domain of this process's environment for a run.

    Parameters
    ----------
    shared
        Whether other parts of the same run may have it too.

    Returns
    -------
    file
        The claim; it ends when the file is closed or the process ends.

    Raises
    ------
    ValueError
        If there is no such domain, another run of the same user on this machine has it, or the
        claim cannot be written.

    """
    number = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (number.isdecimal() and int(number) <= _LARGEST):
        raise ValueError(f'ROS_DOMAIN_ID = {number!r}, must be a whole number in [0, {_LARGEST}]')
    claim = _open(Path(tempfile.gettempdir(), f'lowsnr-{os.getuid()}-domain-{number}.lock'))
    until = time.monotonic() + _ENDING_S
    while True:
        try:
            fcntl.flock(claim, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            return claim
        except OSError:
            holders = _holders(claim)
        nodes = [match and match[1] for match in map(_NODE.search, holders.values())]
        if not nodes or None in nodes or time.monotonic() > until:
            break
        time.sleep(_LOOK_EVERY_S)  # their bring-up was killed, and they are ending
    claim.close()
    if not nodes or None in nodes:
        raise ValueError(
            f'another run uses ROS domain {number}: end it, or choose another with --domain-id')
    left = ', '.join(f'{node} (process {pid})' for pid, node in zip(holders, nodes))
    raise ValueError(f'nodes that an earlier run left behind use ROS domain {number}: {left}: '
                     'kill them, or choose another with --domain-id')


def _holders(claim: TextIO) -> dict[int, str]:
    """Return the commands of the other processes that hold a claim, by process id."""
    found, own = {}, os.fstat(claim.fileno())
    for process in Path('/proc').glob('[0-9]*'):
        with suppress(OSError):  # it has ended, or belongs to another user
            if int(process.name) != os.getpid() and any(
                    os.path.samestat(file.stat(), own) for file in (process / 'fd').iterdir()):
                command = (process / 'cmdline').read_bytes().replace(b'\0', b' ')
                found[int(process.name)] = command.decode(errors='replace')
    return found


def _open(path: Path) -> TextIO:
    """
    Open a file for the claim; ValueError if the path is a link or belongs to another user.

    Every user may write to the folder of temporary files, and can guess the name.
    """
    try:
        # Non-blocking, so that the open of a pipe does not wait for its reader.
        flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        claim = os.fdopen(os.open(path, flags, 0o600), 'w')
    except OSError as error:
        raise ValueError(f'{path}: cannot be written: {error.strerror}{_REMEDY}') from None
    found = os.fstat(claim.fileno())
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid():
        claim.close()
        raise ValueError(f'{path}: is not a file of this user{_REMEDY}')
    return claim
