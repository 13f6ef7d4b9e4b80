# SPDX-License-Identifier: Apache-2.0
"""The table ``smoothed.csv`` of a results folder, and the errors of its paths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from collections.abc import Mapping
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.graph import parameters
from lowsnr_bringup.run import results_folder as files
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.text import read_yaml
from lowsnr_eval.scoring import score_rows as rows
from lowsnr_eval.scoring.camera_table import read_views
from lowsnr_eval.smoothing.path_smoothing import PathErrors
from lowsnr_eval.smoothing.path_smoothing import smooth_path
from lowsnr_eval.smoothing.path_smoothing import Smoothed
from lowsnr_eval.smoothing.recorded_paths import read_paths
from lowsnr_eval.smoothing.recorded_paths import TrackPath
from lowsnr_track.pda_mmpf import PdaMmpf

_STATE = ('x', 'y', 'v_x', 'v_y')
_PAIRS = tuple(combinations_with_replacement(range(4), 2))
# Pixels of the frame and pixels a second, as in tracks.csv; covariances in their products.
COLUMNS = ('frame', 'stamp_s', 'detector', 'id', *_STATE, *(
    f'cov_{_STATE[n]}_{_STATE[m]}' for n, m in _PAIRS))


def write_smoothed(
    folder: Path, summary: Mapping[str, Any], config: Mapping[str, Mapping[str, Any]],
) -> dict[str, dict[str, Any]]:
    """
    Write ``smoothed.csv``, whole or not at all, and return the errors of each chain.

    Parameters
    ----------
    folder
        Results folder.
    summary
        Its summary.
    config
        The configuration, for results that do not hold the parameters of their tracker.

    Raises
    ------
    OSError
        If a table cannot be read or written.
    ValueError
        One line, if a table is damaged or the motion of the camera is not known.

    """
    told = _parameters(folder)
    evaluation, detectors = summary['evaluation'], summary['detectors']
    motions = {name: _motion(told, name, config) for name in detectors}
    errors = {name: PathErrors() for name in detectors}
    left_out: Counter[str] = Counter()
    draft = folder / f'{files.SMOOTHED_FILE}.tmp'
    try:
        with draft.open('wb') as file:
            file.write(rows.as_lines([COLUMNS]))
            for path in _paths(folder, told, evaluation['gate_cells'], left_out):
                if path.detector not in errors:
                    raise ValueError(f'{folder / files.TRACKS_FILE}: {path.detector!r} is not a '
                                     'detector of this run')
                smoothed = smooth_path(
                    path.points, motions[path.detector], evaluation['sensor.cell_size_m'])
                errors[path.detector].add(path.points, smoothed)
                file.write(rows.as_lines(_rows(path, smoothed)))
        draft.replace(folder / files.SMOOTHED_FILE)
    finally:
        draft.unlink(missing_ok=True)
    return {name: {**each.figures(), 'left_out': left_out[name]}
            for name, each in errors.items()}


def _paths(
    folder: Path, told: Mapping[str, Any], gate_cells: float, left_out: Counter[str],
) -> Iterator[TrackPath]:
    """Yield the paths; ValueError where there are tracks and the camera is known at none."""
    views, found = read_views(folder), False
    if views is not None or not any(node.endswith('/conditioner') for node in told):
        for path in read_paths(folder, views, gate_cells, left_out):
            found = True
            yield path
        if found or not left_out:
            return
    raise ValueError(
        f'{folder / files.CAMERA_FILE}: does not hold the motion of the camera; run again with '
        'room on the disk, or evaluate a bag with conditioned/camera_info')


def _rows(path: TrackPath, smoothed: Smoothed) -> Iterator[list[Any]]:
    for point, state, cov in zip(path.points, smoothed.states, smoothed.covs, strict=True):
        values = [*state.tolist(), *(float(cov[pair]) for pair in _PAIRS)]
        yield [point.frame, rows.stamp_text(point.stamp_ns), path.detector, path.name,
               *(f'{value:.9g}' for value in values)]


def _parameters(folder: Path) -> dict[str, Any]:
    """Return the parameters of each node of a run; nothing where the folder has none."""
    path = folder / files.PARAMETERS_FILE
    if not path.is_file():
        return {}
    try:
        return {str(node): dict(body['ros__parameters'].items())
                for node, body in read_yaml(path).items()}
    except (LookupError, TypeError, AttributeError):
        raise ValueError(f'{path}: holds no parameters of nodes') from None


def _motion(
    told: Mapping[str, Any], detector: str, config: Mapping[str, Mapping[str, Any]],
) -> MotionModes:
    """Return how the tracker of a chain takes objects to move."""
    node = Node('tracker', '')
    values = parameters([node], config)[node.path]
    found = told.get(f'/{detector}/tracker', told.get('/tracker', {}))
    tracker: PdaMmpf = build(PdaMmpf, {**values, **found}, 'tracker')
    return tracker.motion
