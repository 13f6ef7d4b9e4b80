"""The results folder of a study: which study it is, and the runs that are finished."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import hashlib
import json
import os
from pathlib import Path
from typing import Any
import zipfile

import lowsnr_common
from lowsnr_common.settings.config import flat_values
import lowsnr_detect
from lowsnr_eval.study.experiment import ChainResult
from lowsnr_eval.study.run_scores import RunScores
from lowsnr_eval.study.study import Study
import lowsnr_sensor
import lowsnr_track
import numpy as np

FORMAT = 1
STUDY_FILE = 'study.json'
_RUNS = 'runs'
_PACKAGES = (lowsnr_common, lowsnr_sensor, lowsnr_detect, lowsnr_track)
Results = dict[tuple[str, str], ChainResult]


class StudyFolder:
    """
    A folder that is ours, with the finished blocks of runs.

    Parameters
    ----------
    path
        The folder, as :func:`open_folder` returns it.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        (path / _RUNS).mkdir(exist_ok=True)

    def save(self, name: str, results: Results) -> None:
        """Keep the results of a block, at once or not at all."""
        arrays: dict[str, Any] = {}
        for (label, point), result in results.items():
            place = f'{label}/{point}'
            arrays[f'{place}/time'] = np.array([result.detector_s, result.tracker_s])
            for level, scores in (('detection', result.detection), ('tracking', result.tracking)):
                for key, values in scores.arrays().items() if scores else ():
                    arrays[f'{place}/{level}/{key}'] = values
        draft = self._file(name).with_suffix('.tmp')
        with draft.open('wb') as file:
            np.savez_compressed(file, **arrays)
        draft.replace(self._file(name))

    def load(self, name: str) -> Results | None:
        """Return the results of a block; None where it is not finished."""
        try:
            with self._file(name).open('rb') as file, np.load(file) as archive:
                arrays = dict(archive)
        except (OSError, ValueError, zipfile.BadZipFile):
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


def open_folder(wanted: Path, study: Study, resume: bool) -> StudyFolder:
    """
    Make the folder of a study, or go on in it.

    Parameters
    ----------
    wanted
        The folder asked for; a new study takes ``<wanted>-2`` and so on where it holds
        results already.
    study
        The study.
    resume
        Whether to go on with what the folder holds.

    Raises
    ------
    ValueError
        One line that names the folder, if it holds something else or cannot be written to.

    """
    goes_on = check_folder(wanted, study, resume)
    wanted = Path(os.path.abspath(wanted))
    try:
        if goes_on:
            return StudyFolder(wanted)
        folder, number = wanted, 1
        while folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            number += 1
            folder = wanted.with_name(f'{wanted.name}-{number}')
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(describe(study), indent=1)
        (folder / STUDY_FILE).write_text(f'{text}\n', encoding='utf-8')
        return StudyFolder(folder)
    except OSError as error:
        raise ValueError(f'{wanted}: results cannot be written there: {error.strerror}; choose '
                         'another folder with --results') from None


def check_folder(wanted: Path, study: Study, resume: bool) -> bool:
    """Return whether a study would go on in a folder; raise what :func:`open_folder` raises."""
    try:
        found = _found(wanted)
    except OSError as error:
        raise ValueError(f'{wanted}: cannot be read: {error.strerror}') from None
    if found is not None and resume:
        _check_same(wanted, found, describe(study))
        return True
    return False


def describe(study: Study) -> dict[str, Any]:
    """Return all that the numbers of a study follow from, of JSON types."""
    methods = {
        f'{case.name}/{method.label}': {
            'runs': method.runs, 'false_alarm_prob': method.false_alarm_prob,
            'detector': flat_values(method.detector), 'tracker': flat_values(method.tracker)}
        for case in study.cases for method in case.methods}
    options = {key: list(value) if isinstance(value, tuple) else value
               for key, value in asdict(study.options).items()}
    return {'format': FORMAT, 'code': code_digest(), 'options': options, 'methods': methods}


def code_digest() -> str:
    """Return a digest of the code that the numbers of a study come from."""
    files = [path for package in _PACKAGES for path in Path(package.__path__[0]).rglob('*.py')
             if path.parent.name != 'ros' and not path.stem.endswith('_node')]
    files += Path(__file__).parent.glob('*.py')
    digest = hashlib.sha256()
    for path in sorted(files, key=lambda path: path.name):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _found(folder: Path) -> Mapping[str, Any] | None:
    """Return the description of the study in a folder; None where the folder is free."""
    if not folder.is_dir() or not any(folder.iterdir()):
        return None
    try:
        found = json.loads((folder / STUDY_FILE).read_text(encoding='utf-8'))
    except (FileNotFoundError, ValueError):
        found = None
    if not isinstance(found, dict) or found.get('format') != FORMAT:
        raise ValueError(f'{folder}: holds results of another version or of something else; '
                         'choose another folder with --results')
    return found


def _check_same(folder: Path, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    if found == wanted:
        return
    if found.get('code') != wanted['code']:
        what = 'was made by another version of the code'
    else:
        old, new = found.get('options', {}), wanted['options']
        changed = [f'{key} was {old.get(key)}' for key in new if old.get(key) != new[key]]
        what = f'is another study ({", ".join(changed) or "other settings"})'
    raise ValueError(f'{folder}: {what}, cannot go on with it; leave out --resume')
