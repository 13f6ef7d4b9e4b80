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
    lines: Sequence[Mapping[str, Any]], frames: Sequence[np.ndarray | None], scored: int,
) -> Markup:
    """
    Return the animation of a run, with its script.

    Parameters
    ----------
    lines, frames
        As :func:`lowsnr_eval.scoring.scene.read_scene` returns them, with at least one frame.
    scored
        Number of frames of the whole run.

    """
    pixels = np.concatenate([frame.ravel() for frame in frames if frame is not None])
    sizes = [0 if frame is None else frame.size for frame in frames]
    places = np.where(np.array(sizes) > 0, np.cumsum(sizes) - sizes, -1)
    data = json.dumps({
        'chains': sorted({name for line in lines for name in line['chains']}),
        'colours': {'truth': TRUTH, 'detection': DETECTION, 'track': TRACK},
        'pixels': base64.b64encode(stretch(pixels).tobytes()).decode(),
        'lines': [{**line, 'place': int(place)} for line, place in zip(lines, places)]})
    return fill(
        'animation.html', last=len(lines) - 1, note=_note(lines, scored), truth=TRUTH,
        detection=DETECTION, track=TRACK, script=asset('animation.js'),
        data=data.replace('<', '\\u003c'))  # so that no text can end the element that holds it


def _note(lines: Sequence[Mapping[str, Any]], scored: int) -> str:
    """Return sentences on what the animation leaves out or reduces."""
    notes = []
    if scored > len(lines):
        notes.append(f'Shown are the first {len(lines)} of {scored} frames.')
    if (step := max(line['step'] for line in lines)) > 1:
        notes.append(f'A pixel is the brightest of {step} x {step} cells.')
    return ' '.join(notes)
