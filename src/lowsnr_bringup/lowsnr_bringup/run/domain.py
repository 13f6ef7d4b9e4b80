"""One run at a time on a ROS domain: two graphs on one domain would hear each other."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import stat
import tempfile
from typing import TextIO

_LARGEST = 232  # beyond it DDS has no ports
_MEND = ': remove it, or set TMPDIR to a folder of your own'


def claim_domain() -> TextIO:
    """
    Claim the ROS domain of this process's environment for a run.

    Returns
    -------
    file
        The claim; it ends when the file is closed, or with the process.

    Raises
    ------
    ValueError
        If there is no such domain, a run of the same user on this machine has it, or the claim
        cannot be written.

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
    Open a file of ours; ValueError where another user, or a link, stands at its name.

    Everybody may write to the folder of temporary files, and knows the name.
    """
    try:
        # Non-blocking, so that a pipe is no trap.
        flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        claim = os.fdopen(os.open(path, flags, 0o600), 'w')
    except OSError as error:
        raise ValueError(f'{path}: cannot be written: {error.strerror}{_MEND}') from None
    found = os.fstat(claim.fileno())
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid():
        claim.close()
        raise ValueError(f'{path}: is not a file of this user{_MEND}')
    return claim
