# SPDX-License-Identifier: Apache-2.0
"""The results folder of a run: its files, and that no two runs share one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
import os
from pathlib import Path

from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.middleware import PROFILE_FILE
from lowsnr_common.core.records import AlarmRate

FRAMES_FILE = 'frames.csv'
LATENCY_FILE = 'latency.csv'
DETECTIONS_FILE = 'detections.csv'
TRACKS_FILE = 'tracks.csv'
TRUTH_FILE = 'truth.csv'
CAMERA_FILE = 'camera.csv'
SMOOTHED_FILE = 'smoothed.csv'
SUMMARY_FILE = 'summary.json'
PARAMETERS_FILE = 'parameters.yaml'
RESTARTS_FILE = 'restarts.csv'


@dataclass
class Account:
    """
    What only the process that starts the nodes knows of a run.

    ``ledger`` counts the frames that the source published and where they went; None where only
    the tables are known.  ``restarts`` is how often each node was started again, by its label,
    ``alarm_rates`` the false-alarm rate of each detector at the end, by the name of its node.
    """

    ledger: FrameLedger | None = None
    restarts: Mapping[str, int] = field(default_factory=dict)
    alarm_rates: Mapping[str, AlarmRate] = field(default_factory=dict)


def fresh_folder(wanted: Path) -> Path:
    """
    Make a folder for results; one that holds anything is left alone.

    Parameters
    ----------
    wanted
        The folder asked for.  It is made where it is missing and used where it is empty; else
        this holds for the first of ``<wanted>-2``, ``<wanted>-3`` ... that is missing or empty.

    Returns
    -------
    Path
        The folder, absolute; an empty ``frames.csv`` in it keeps other runs away.

    Raises
    ------
    ValueError
        One line that names the path and the option to change it, if the folder cannot be made
        or written to.

    """
    wanted = Path(os.path.abspath(wanted))
    folder, number = wanted, 1
    while not _claim(folder):
        number += 1
        folder = wanted.with_name(f'{wanted.name}-{number}')
    return folder


def start_files(folder: Path) -> dict[Path, str]:
    """Return the texts of the files that nodes read when they start, the parameters first."""
    paths = [folder / PARAMETERS_FILE, folder / PROFILE_FILE]
    return {path: path.read_text(encoding='utf-8') for path in paths if path.exists()}


def _claim(folder: Path) -> bool:
    """Reserve a folder for this run; False if it holds anything or another run reserves it."""
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
