"""One run at a time on a ROS domain: two graphs on one would receive each other's frames."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import stat
import tempfile
from typing import TextIO

_LARGEST = 232  # DDS has no ports for more
_REMEDY = ': remove it, or set TMPDIR to a folder of your own'


def claim_domain() -> TextIO:
    """
    Claim the ROS domain of this process's environment for a run.

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
    try:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        claim.close()
        raise ValueError(
            f'another run uses ROS domain {number}: end it, or choose another with --domain-id'
        ) from None
    return claim


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
