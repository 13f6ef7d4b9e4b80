"""One run at a time on a ROS domain: two graphs on one domain would hear each other."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import tempfile
from typing import TextIO

_LARGEST = 232  # beyond it DDS has no ports


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
    path = Path(tempfile.gettempdir(), f'lowsnr-{os.getuid()}-domain-{number}.lock')
    try:
        claim = path.open('a')
    except OSError as error:
        raise ValueError(f'{path}: cannot be written: {error.strerror}') from None
    try:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        claim.close()
        raise ValueError(
            f'another run uses ROS domain {number}: end it, or choose another with --domain-id'
        ) from None
    return claim
