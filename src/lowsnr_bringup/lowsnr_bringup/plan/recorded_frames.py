# SPDX-License-Identifier: Apache-2.0
"""What a run must know about frames that it does not simulate, before it starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from typing import Any

FRAMES = '/image_raw'


@dataclass(frozen=True)
class RecordedRun:
    """
    The frames of a bag, a camera or an array, and the run that they belong to.

    Attributes
    ----------
    name
        Name of the scenario; that of the bag if its metadata do not name a scenario.
    frames
        Their number; 0 for a camera, whose frames have no end.
    rows, cols
        Size of a frame.
    period_s
        Median time between frames [s]; 1 for a single frame.
    truth
        Whether the bag has truth.
    raw
        Whether the frames have a background and noise of their own, and need a conditioner.
    simulated
        Whether the frames are simulated: then the settings of motion apply as they are.
    encoding
        Encoding of the images.
    seed, sensor
        Seed and settings ``sensor.*`` of the run, if the metadata hold them.
    notes : list of str
        A line for each thing that is damaged or missing.
    frames_topic
        Topic of the frames.
    compressed
        Whether a camera sends compressed images.
    left_out : tuple of int
        Indices of the frames whose stamps are not in order, see
        :func:`lowsnr_common.core.timeline.increasing`.
    blank
        The first frame with a pixel that is not a finite number up to 1e9; empty if none has.

    """

    name: str
    frames: int
    rows: int
    cols: int
    period_s: float
    truth: bool
    raw: bool
    simulated: bool = False
    encoding: str = '32FC1'
    seed: int | None = None
    sensor: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    frames_topic: str = FRAMES
    compressed: bool = False
    left_out: tuple[int, ...] = ()
    blank: str = ''
