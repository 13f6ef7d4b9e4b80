"""The animation of a report: frames that a reader can step through, with marks over them."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from collections.abc import Sequence
import json
from typing import Any

from lowsnr_eval.report.html_page import asset
from lowsnr_eval.report.html_page import fill
from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.report.palette import DETECTION
from lowsnr_eval.report.palette import stretch
from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
import numpy as np


def animation(
    lines: Sequence[Mapping[str, Any]], frames: Sequence[np.ndarray | None],
    cells: Sequence[np.ndarray | None], scored: int,
) -> Markup:
    """
    Return the animation of a run, with its script.

    Parameters
    ----------
    lines, frames, cells
        As :func:`lowsnr_eval.scoring.scene.read_scene` returns them, with at least one frame.
    scored
        Number of frames of the whole run.

    """
    data = json.dumps({
        'chains': sorted({name for line in lines for name in line['chains']}),
        'colours': {'truth': TRUTH, 'detection': DETECTION, 'track': TRACK},
        'frames': _greys(frames), 'cells': _greys(cells),
        'lines': [
            {**line, 'place': place, 'cells_place': of_cells} for line, place, of_cells in zip(
                lines, _places(frames), _places(cells), strict=True)]})
    return fill(
        'animation.html', last=len(lines) - 1, note=_note(lines, scored), truth=TRUTH,
        detection=DETECTION, track=TRACK, script=asset('animation.js'),
        data=data.replace('<', '\\u003c'))  # so that no text can end the element that holds it


def _greys(planes: Sequence[np.ndarray | None]) -> str:
    """Return planes as greys, one after the other, in base64."""
    known = [plane.ravel() for plane in planes if plane is not None]
    greys = stretch(np.concatenate(known)) if known else np.zeros(0, np.uint8)
    return base64.b64encode(greys.tobytes()).decode()


def _places(planes: Sequence[np.ndarray | None]) -> list[int]:
    """Return where the greys of each plane begin, -1 where there are none."""
    sizes = [0 if plane is None else plane.size for plane in planes]
    return [int(end) - size if size else -1 for size, end in zip(sizes, np.cumsum(sizes))]


def _note(lines: Sequence[Mapping[str, Any]], scored: int) -> str:
    """Return sentences on what the animation leaves out or reduces."""
    notes = []
    if scored > len(lines):
        notes.append(f'Shown are the first {len(lines)} of {scored} frames.')
    if (step := max(line['step'] for line in lines)) > 1:
        notes.append(f'A pixel is the brightest of {step} x {step} cells.')
    return ' '.join(notes)
