"""The results folder of a run: made for it alone, and what its starter adds to the scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
import os
from pathlib import Path

FRAMES_FILE = 'frames.csv'
PARAMETERS_FILE = 'parameters.yaml'


@dataclass
class Account:
    """
    What only the starter of the nodes knows of a run.

    ``published`` counts the frames that the source sent, ``restarts`` how often each node was
    started again, by its label; ``summed_up`` says whether the evaluator came to its end.
    """

    published: int = 0
    restarts: Mapping[str, int] = field(default_factory=dict)
    summed_up: bool = False


def fresh_folder(wanted: Path) -> Path:
    """
    Make a folder for results, never one that holds earlier ones.

    Parameters
    ----------
    wanted
        The folder asked for.  It is made, or taken where it is empty; otherwise the first of
        ``<wanted>-2``, ``<wanted>-3`` ... for which that can be done.

    Returns
    -------
    Path
        The folder, absolute; an empty ``frames.csv`` in it keeps other runs away.

    Raises
    ------
    ValueError
        One line that names the path and the mend, if it cannot be made or written to.

    """
    wanted = Path(os.path.abspath(wanted))
    folder, number = wanted, 1
    while not _claim(folder):
        number += 1
        folder = wanted.with_name(f'{wanted.name}-{number}')
    return folder


def _claim(folder: Path) -> bool:
    """Make a folder ours; False if it holds anything or another run claims it first."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            return False
        (folder / FRAMES_FILE).touch(exist_ok=False)
    except FileExistsError as error:
        if folder.is_dir():
            return False
        raise cannot_write(folder, error) from None
    except OSError as error:
        raise cannot_write(folder, error) from None
    return True


def cannot_write(folder: Path, error: OSError) -> ValueError:
    """Return the error of a folder that cannot be written to."""
    return ValueError(
        f'{folder}: results cannot be written there: {error.strerror}; '
        'choose another folder with --results')
