# SPDX-License-Identifier: Apache-2.0
"""The results folder of a study: its identity, and the blocks of runs that are finished."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
import hashlib
import json
import os
from pathlib import Path
from typing import Any
import warnings

from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_common.settings.text import one_line
from lowsnr_eval.study.experiment import BlockResults
from lowsnr_eval.study.experiment import ChainResult
from lowsnr_eval.study.run_scores import RunScores
from lowsnr_eval.study.study import Study
from lowsnr_eval.study.study_identity import differences
from lowsnr_eval.study.study_identity import identity
import numpy as np

FORMAT = 2
STUDY_FILE = 'study.json'
_RUNS = 'runs'
_SEAL = 'seal'
# A message names this many differences.
_MOST_NAMED = 3


class OtherStudyError(ValueError):
    """A folder holds another study; ``changed`` has old and new value by path in the study."""

    def __init__(self, folder: Path, changed: Mapping[str, tuple[Any, Any]]) -> None:
        named = [one_line(f'{path} was {old}, is {new}')
                 for path, (old, new) in list(changed.items())[:_MOST_NAMED]]
        more = len(changed) - len(named)
        super().__init__(
            f'{folder}: holds another study: {"; ".join(named)}'
            + (f'; and {more} more' if more else '') + '; leave out --resume')
        self.changed = dict(changed)


class StudyFolder:
    """
    The folder of one study, with the finished blocks of runs; see :func:`open_folder`.

    ``warn`` receives a line for each file that does not hold what :meth:`save` wrote.
    """

    def __init__(self, path: Path, warn: Callable[[str], None] = warnings.warn) -> None:
        self.path, self._warn = path, warn
        (path / _RUNS).mkdir(exist_ok=True)

    def save(self, name: str, results: BlockResults) -> None:
        """Write the results of a block; a reader sees all of them or none."""
        arrays: dict[str, Any] = {}
        for (label, point), result in results.items():
            place = f'{label}/{point}'
            arrays[f'{place}/time'] = np.array([result.detector_s, result.tracker_s])
            for level, scores in (('detection', result.detection), ('tracking', result.tracking)):
                for key, values in scores.arrays().items() if scores else ():
                    arrays[f'{place}/{level}/{key}'] = values
        arrays[_SEAL] = np.array(_seal(name, arrays))
        draft = self._file(name).with_suffix('.tmp')
        with draft.open('wb') as file:
            np.savez_compressed(file, **arrays)
        draft.replace(self._file(name))

    def load(self, name: str) -> BlockResults | None:
        """Return the results of a block; None if it is not finished, or its file is damaged."""
        try:
            with self._file(name).open('rb') as file, np.load(file) as archive:
                arrays = dict(archive)
            if str(arrays.pop(_SEAL)) != _seal(name, arrays):
                raise ValueError('its values are not those that were written')
        except FileNotFoundError:
            return None
        except UNREADABLE as error:
            self._warn(f'{self._file(name)}: cannot be used: {one_line(error)}; '
                       'its runs are done again')
            return None
        levels: dict[tuple[str, str], dict[str, dict[str, np.ndarray]]] = {}
        for key, values in arrays.items():
            label, point, level, *field = key.split('/')
            part = levels.setdefault((label, point), {}).setdefault(level, {})
            part[field[0] if field else level] = values
        return {
            key: ChainResult(
                RunScores(**part['detection']),
                RunScores(**part['tracking']) if 'tracking' in part else None,
                *map(float, part['time']['time']))
            for key, part in levels.items()}

    def _file(self, name: str) -> Path:
        return self.path / _RUNS / f'{name}.npz'


def _seal(name: str, arrays: Mapping[str, np.ndarray]) -> str:
    """Return a digest of the arrays of a block and its name."""
    digest = hashlib.sha256(name.encode())
    for key in sorted(arrays):
        values = np.ascontiguousarray(arrays[key])
        digest.update(f'\0{key} {values.dtype.str} {values.shape}\0'.encode() + values.tobytes())
    return digest.hexdigest()


def open_folder(
    wanted: Path, study: Study, resume: bool, warn: Callable[[str], None] = warnings.warn,
) -> StudyFolder:
    """
    Create the folder of a study, or continue in it.

    Parameters
    ----------
    wanted
        The folder that the user asked for; if it holds results, a new study takes
        ``<wanted>-2`` and so on.
    study
        The study.
    resume
        Whether to continue the study that the folder holds.
    warn
        Receives a line for each damaged file.

    Raises
    ------
    OtherStudyError
        If the study in the folder differs from this one in any value.
    ValueError
        One line that names the folder, if it holds something else or cannot be written to.

    """
    continues = check_folder(wanted, study, resume)
    wanted = Path(os.path.abspath(wanted))
    try:
        if continues:
            return StudyFolder(wanted, warn)
        folder, number = wanted, 1
        while folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            number += 1
            folder = wanted.with_name(f'{wanted.name}-{number}')
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({'format': FORMAT, 'identity': identity(study)}, indent=1)
        (folder / STUDY_FILE).write_text(f'{text}\n', encoding='utf-8')
        return StudyFolder(folder, warn)
    except OSError as error:
        raise ValueError(f'{wanted}: cannot be written to: {error.strerror}; choose another '
                         'folder with --results') from None


def check_folder(wanted: Path, study: Study, resume: bool) -> bool:
    """Return whether a study would continue in a folder; raise what :func:`open_folder` does."""
    try:
        found = _found(wanted)
    except OSError as error:
        raise ValueError(f'{wanted}: cannot be read: {error.strerror}') from None
    if found is None or not resume:
        return False
    if changed := differences(found, identity(study)):
        raise OtherStudyError(wanted, changed)
    return True


def _found(folder: Path) -> Mapping[str, Any] | None:
    """Return the identity of the study in a folder; None if the folder is free."""
    if not folder.is_dir() or not any(folder.iterdir()):
        return None
    try:
        found = json.loads((folder / STUDY_FILE).read_text(encoding='utf-8'))
    except (FileNotFoundError, ValueError, RecursionError):
        found = None
    known: Any = found.get('identity') if isinstance(found, dict) else None
    if not isinstance(known, dict) or found.get('format') != FORMAT:
        raise ValueError(f'{folder}: holds results of another version or other files; choose '
                         'another folder with --results')
    return known
