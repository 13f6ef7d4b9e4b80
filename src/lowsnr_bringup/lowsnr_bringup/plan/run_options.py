"""What a user says of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields
from pathlib import Path
import re

_TOPIC = re.compile(r'/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
# What has no meaning where the frames come from a camera, and why.
_MOOT = {
    'frames': ('--frames', 'a camera has no last frame'),
    'loop': ('--loop', 'a camera is never repeated'),
    'rate_hz': ('--rate', 'a camera has its own pace'),
    'lockstep': ('--lockstep', 'a camera waits for nobody'),
    'frames_topic': ('--frames-topic', '--camera names the topic'),
    'truth_topic': ('--truth-topic', 'a camera knows no truth')}


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What a user says of a run; None where the configuration decides."""

    detectors: Sequence[str]
    scenario: str
    snr_db: float | None = None
    frames: int | None = None
    seed: int | None = None
    rate_hz: float | None = None
    lockstep: bool = False
    loop: bool = False
    overrides: Sequence[str] = ()
    record: Path | None = None
    storage: str = 'mcap'
    replay: Path | None = None
    frames_topic: str | None = None
    truth_topic: str = '/ground_truth'
    condition: str = 'auto'
    view: bool = False
    respawn: bool | None = None
    camera: str | None = None

    @property
    def endless(self) -> bool:
        """Whether the run goes on until it is interrupted."""
        return self.loop or self.camera is not None

    @property
    def frames_from(self) -> str:
        """Name, for people, of where frames that are not simulated come from."""
        return str(self.replay or self.camera)


def camera_topic(options: RunOptions) -> str:
    """
    Return the full name of the camera's topic, or nothing without a camera.

    Raises
    ------
    ValueError
        One line, if it is no topic's name, or an option has no meaning for a camera.

    """
    if options.camera is None:
        return ''
    defaults = {item.name: item.default for item in fields(RunOptions)}
    for name, (option, why) in _MOOT.items():
        if getattr(options, name) != defaults[name]:
            raise ValueError(f'{option}: not allowed with --camera: {why}')
    if not _TOPIC.fullmatch(options.camera):
        raise ValueError(
            f'--camera: {options.camera!r} is not the name of a topic, such as /camera/image_raw')
    return '/' + options.camera.lstrip('/')
