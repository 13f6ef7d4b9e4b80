# SPDX-License-Identifier: Apache-2.0
"""The options of a run, as the command line and studies give them, and what they set."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields
from pathlib import Path
import re
from typing import Any

from lowsnr_bringup.plan.graph import EVERY_NODE
from lowsnr_bringup.plan.graph import Layer
from lowsnr_bringup.plan.loopback import check_ports

_TOPIC = re.compile(r'/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
# The options that have no meaning for a camera, and why.
_NOT_FOR_A_CAMERA = {
    'frames': ('--frames', 'a camera has no last frame'),
    'loop': ('--loop', 'a camera cannot be repeated'),
    'rate_hz': ('--rate', 'a camera has its own rate'),
    'lockstep': ('--lockstep', 'a camera waits for no node'),
    'frames_topic': ('--frames-topic', '--camera names the topic'),
    'truth_topic': ('--truth-topic', 'a camera publishes no truth')}


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """
    The options of a run; None leaves a choice to the configuration.

    The names are those of the options of ``bringup.py``, whose ``--help`` explains them.

    Raises
    ------
    ValueError
        One line, if options contradict each other, the camera's topic is malformed, or a port is
        taken.

    """

    detectors: Sequence[str]
    scenario: str
    snr_db: float | None = None
    frames: int | None = None
    seed: int | None = None
    rate_hz: float | None = None
    lockstep: bool = False
    loop: bool = False
    overrides: Sequence[str] | Mapping[str, Any] = ()
    record: Path | None = None
    storage: str = 'mcap'
    replay: Path | None = None
    frames_topic: str | None = None
    truth_topic: str = '/ground_truth'
    truth_bag: Path | None = None
    condition: str = 'auto'
    view: bool = False
    view_port: int = 0
    browser: bool = True
    respawn: bool | None = None
    camera: str | None = None
    statistic_map: bool = False
    composed: bool = False
    tiles: tuple[int, int] = (1, 1)  # down and across

    def __post_init__(self) -> None:
        if self.camera is not None:
            self._check_camera(self.camera)
        elif self.replay is None and self.condition == 'on':
            raise ValueError('--condition on: simulated frames are not conditioned')
        if self.view_port:
            check_ports(self.view_port + n for n in range(len(self.detectors)))
        if self.composed and self.tiles != (1, 1):
            raise ValueError('--tiles: not allowed with --composed, which puts all in one process')
        if self.replay is not None and self.loop:
            raise ValueError('--loop: a bag is replayed once')

    def _check_camera(self, camera: str) -> None:
        defaults = {item.name: item.default for item in fields(self)}
        for name, (option, why) in _NOT_FOR_A_CAMERA.items():
            if getattr(self, name) != defaults[name]:
                raise ValueError(f'{option}: not allowed with --camera: {why}')
        if not _TOPIC.fullmatch(camera):
            raise ValueError(
                f'--camera: {camera!r} is not the name of a topic, such as /camera/image_raw')

    @property
    def camera_topic(self) -> str:
        """Full name of the camera's topic; empty without a camera."""
        return '' if self.camera is None else '/' + self.camera.lstrip('/')

    @property
    def endless(self) -> bool:
        """Whether the run goes on until it is interrupted."""
        return self.loop or self.camera is not None

    def parameters(self) -> Layer:
        """Return the parameters that the options set; a node takes those that it declares."""
        values = {
            'seed': self.seed, 'sensor.snr_db': self.snr_db, 'rate_hz': self.rate_hz,
            'frames': self.frames, 'lockstep': self.lockstep, 'loop': self.loop,
            'storage': self.storage, 'statistic_map': self.statistic_map or None}
        given = {name: value for name, value in values.items() if value is not None}
        bag = {} if self.record is None else {'bag': str(self.record.resolve())}
        page = {'page_port': self.view_port, 'browser': self.browser}
        return {EVERY_NODE: given, 'recorder': bag, 'viewer': page}
