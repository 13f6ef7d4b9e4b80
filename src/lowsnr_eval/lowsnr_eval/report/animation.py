# SPDX-License-Identifier: Apache-2.0
"""The animation of a report: frames that a reader can step through, with marks over them."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
import json
from typing import Any

from lowsnr_eval.report.html_page import asset
from lowsnr_eval.report.html_page import fill
from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.report.palette import DETECTION
from lowsnr_eval.report.palette import excess_range
from lowsnr_eval.report.palette import grey_range
from lowsnr_eval.report.palette import IDENTITIES
from lowsnr_eval.report.palette import to_greys
from lowsnr_eval.report.palette import to_levels
from lowsnr_eval.report.palette import TRUTH
from lowsnr_eval.scene.scene_files import Plane
from lowsnr_eval.scene.scene_files import Scene
import numpy as np

Line = Mapping[str, Any]
# What a page holds at most: cells of pictures, and letters of lines.  That is up to 15 MB.
_MOST_CELLS, _MOST_LETTERS = 2**23, 2**22
# Frames before the first one that shows anything, where a page does not hold all.
_BEFORE = 20
_SIGMAS = 2.0


@dataclass(frozen=True)
class Facts:
    """
    What an animation says about its run.

    ``unit`` is that of positions and ``cell_size`` the side of a cell in it, ``gate_cells`` the
    largest distance of a hit, ``asked`` the false-alarm probability of each chain, and
    ``intensity`` the name of what a frame holds.
    """

    unit: str = 'm'
    cell_size: float = 1.0
    gate_cells: float = 1.5
    asked: Mapping[str, float | None] = field(default_factory=dict)
    intensity: str = 'intensity'


def animation(scene: Scene, scored: int, facts: Facts) -> Markup:
    """
    Return the animation of a run, with its script.

    Parameters
    ----------
    scene
        The scene of the run, with at least one frame.
    scored
        Number of frames of the whole run.
    facts
        What is known of the run.

    """
    shown = _shown(scene)
    lines, frames = scene.lines[shown], scene.frames[shown]
    cells, statistics = scene.cells[shown], scene.statistics[shown]
    of_frames, of_cells = _limits(frames), _limits(cells)
    return element(facts, _note(lines, scored), {
        'chains': list(dict.fromkeys(name for line in lines for name in line['chains'])),
        'frames': _greys(frames, of_frames), 'cells': _greys(cells, of_cells),
        'values': {'frames': [*of_frames, facts.intensity],
                   'cells': [*of_cells, 'noise σ']},
        'statistics': {
            name: _levels([own.get(name) for own in statistics])
            for name in dict.fromkeys(name for own in statistics for name in own)},
        'lines': [
            {**line, 'place': place, 'cells_place': cells_place}
            for line, place, cells_place in zip(
                lines, _places(frames), _places(cells), strict=True)]})


def element(facts: Facts, note: str, data: Mapping[str, Any], *scripts: str) -> Markup:
    """Return the elements of an animation of this data, with its scripts and further ones."""
    text = json.dumps({
        'colours': {'truth': TRUTH, 'detection': DETECTION, 'identities': IDENTITIES},
        'unit': {'name': facts.unit, 'size': facts.cell_size}, 'gate': facts.gate_cells,
        'asked': dict(facts.asked), 'sigmas': _SIGMAS, **data})
    return fill(
        'animation.html', note=note, truth=TRUTH, detection=DETECTION, sigmas=f'{_SIGMAS:g}',
        script='\n'.join(map(asset, ('plot.js', 'animation.js', *scripts))),
        data=text.replace('<', '\\u003c'))  # so that no text can end the element that holds it


def to_text(greys: np.ndarray) -> str:
    """Return greys, uint8 of any shape, in base64."""
    return base64.b64encode(greys.tobytes()).decode()


def _shown(scene: Scene) -> slice:
    """Return which frames the page holds: all, or from shortly before the first with a mark."""
    lines = scene.lines
    sizes = np.cumsum([0, *(
        sum(plane.size for plane in (frame, cells, *own.values()) if plane is not None)
        for _, frame, cells, own in zip(*scene, strict=True))])
    letters = np.cumsum([0, *(len(json.dumps(line)) for line in lines)])

    def stop(start: int) -> int:
        fits = (sizes - sizes[start] <= _MOST_CELLS) & (letters - letters[start] <= _MOST_LETTERS)
        return max(int(np.flatnonzero(fits)[-1]), start + 1)

    if stop(0) == len(lines):
        return slice(None)
    first = next((n for n, line in enumerate(lines) if line['truth']), 0)
    start = max(0, first - _BEFORE)
    return slice(start, stop(start))


def _limits(planes: Sequence[Plane]) -> tuple[float, float]:
    """Return the intensities that are black and white in all planes."""
    known = [plane.ravel() for plane in planes if plane is not None]
    return grey_range(np.concatenate(known)) if known else (0.0, 0.0)


def _greys(planes: Sequence[Plane], limits: tuple[float, float]) -> str:
    """Return planes as greys, one after the other, in base64."""
    greys = [to_greys(plane, limits).ravel() for plane in planes if plane is not None]
    return to_text(np.concatenate(greys)) if greys else ''


def _levels(planes: Sequence[Plane]) -> dict[str, Any]:
    """Return the statistic of a chain in each frame: levels, their limits, and their places."""
    known = [plane.ravel() for plane in planes if plane is not None]
    limits = excess_range(np.concatenate(known))
    return {'levels': to_text(to_levels(np.concatenate(known), limits)), 'limits': limits,
            'places': _places(planes)}


def _places(planes: Sequence[Plane]) -> list[int]:
    """Return where the greys of each plane begin, -1 where there are none."""
    sizes = [0 if plane is None else plane.size for plane in planes]
    return [int(end) - size if size else -1 for size, end in zip(sizes, np.cumsum(sizes))]


def _note(lines: Sequence[Line], scored: int) -> str:
    """Return sentences on what the animation leaves out or reduces."""
    notes = []
    if scored > len(lines):
        first, last = lines[0]['frame'], lines[-1]['frame']
        notes.append(f'Shown are {len(lines)} of {scored} frames, {first} to {last}, in pictures '
                     'and curves up to here.')
    if (step := max(line['step'] for line in lines)) > 1:
        notes.append(f'A pixel is the brightest of {step} x {step} cells.')
    return ' '.join(notes)
