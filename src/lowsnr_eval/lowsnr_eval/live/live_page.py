# SPDX-License-Identifier: Apache-2.0
"""The live page: the animation of the report, to which a server adds frames as they come."""

from __future__ import annotations

from collections.abc import Mapping
import json
import os
import subprocess
import sys
from threading import Thread
from typing import Any

from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.report.animation import element
from lowsnr_eval.report.animation import Facts
from lowsnr_eval.report.animation import to_text
from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.report.html_page import page
from lowsnr_eval.report.palette import excess_range
from lowsnr_eval.report.palette import to_levels
from lowsnr_eval.scene.scene_files import reduced
from lowsnr_eval.scene.scene_files import reduction
from lowsnr_eval.scene.scene_marks import marks
from lowsnr_eval.scene.scene_marks import track_marks
from lowsnr_eval.scene.scene_writer import place_in_frame
import numpy as np

# A page shows one chain, which needs no name.
_CHAIN = 'chain'
_SCREENS = ('BROWSER', 'DISPLAY', 'WAYLAND_DISPLAY')


def live_page(settings: ViewSettings) -> Markup:
    """Return the page of a viewer."""
    cell_size = 1.0 if settings.pixels else settings.sensor.cell_size_m
    facts = Facts('px' if settings.pixels else 'm', cell_size, settings.gate_cells)
    data: Mapping[str, Any] = {
        'live': True, 'chains': [_CHAIN], 'frames': '', 'cells': '', 'lines': [],
        'sigmas': settings.ellipse_sigmas}
    return page(settings.title or 'live', [
        Markup('<p id="status" role="status">waiting for frames</p>'),
        element(facts, '', data, 'live.js')], connects=True)


def frame_text(
    stamp_s: float, greys: np.ndarray, limits: tuple[float, float],
    answers: tuple[list[Estimate] | None, ...], rate: AlarmRate, cell_size_m: float,
    statistic: Mapping[str, Any] | None = None,
) -> str:
    """
    Return what a server sends of a frame.

    Parameters
    ----------
    stamp_s
        Stamp of the frame [s].
    greys, limits
        The frame (rows, cols) in greys, and the intensities that are black and white.
    answers
        Truth, detections and tracks; None for one that is not known.
    rate
        False-alarm rate of the detector.
    cell_size_m
        Side of a cell [m].
    statistic
        What :func:`statistic_picture` returns; None where there is none.

    """
    truth, detections, tracks = answers
    step = reduction((greys.shape[0], greys.shape[1]))
    kept = reduced(greys, step).astype(np.uint8)
    return json.dumps({
        'stamp_s': stamp_s, 'step': step, 'shape': kept.shape, 'greys': to_text(kept),
        'values': [*limits, 'intensity'], 'asked': rate.asked,
        'truth': marks(truth, cell_size_m),
        'chains': {_CHAIN: {
            'detections': marks(detections, cell_size_m),
            'tracks': track_marks(tracks, cell_size_m), 'measured': rate.measured,
            'statistic': statistic}}})


def statistic_picture(excess: np.ndarray, where: FrameMap | None) -> dict[str, Any]:
    """
    Return the picture of a statistic minus its threshold (rows, cols) [nat].

    ``where`` is the map of its frame, None if it was not conditioned.
    """
    place, step = place_in_frame((excess.shape[0], excess.shape[1]), where)
    kept, limits = reduced(excess, step), excess_range(excess)
    return place | {
        'shape': kept.shape, 'limits': limits, 'levels': to_text(to_levels(kept, limits))}


def open_page(address: str) -> None:
    """Open a page in the user's browser, if there is a screen; this waits for nothing."""
    if any(map(os.environ.get, _SCREENS)):
        Thread(target=subprocess.run, args=([sys.executable, '-m', 'webbrowser', '-t', address],),
               kwargs={'start_new_session': True, **dict.fromkeys(
                   ('stdin', 'stdout', 'stderr'), subprocess.DEVNULL)}, daemon=True).start()
