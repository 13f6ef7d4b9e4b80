"""Settings of the nodes that record a run and replay one."""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting

STORAGES = ('mcap', 'sqlite3')


@dataclass(frozen=True, kw_only=True)
class RecordingSettings:
    """Where the bag goes and what it says of the run."""

    bag: str = setting('bag', 'folder of the bag, which must not exist')
    storage: str = setting('mcap', 'storage of the bag', choices=STORAGES)
    run_parameters: str = setting('', 'parameter file of the run, which the bag shall carry')
    topics: tuple[str, ...] = setting((), 'topics that there must be before the run begins')
    rows: int = setting(0, 'rows of a frame, 0 where not known', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 where not known', ge=0, le=16384)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class PlayerSettings:
    """Which topics of which bag are played, and how fast."""

    bag: str = setting('', 'path of the bag')
    frames_topic: str = setting('/image_raw', 'topic of the frames in the bag')
    truth_topic: str = setting(
        '/ground_truth', 'topic of the truth in the bag, its odometry below it; empty for none')
    simulated: bool = setting(
        False, 'whether the frames are of a simulation, which a recording of the replay tells on')
    frames: int = setting(0, 'frames to publish, 0 for all', ge=0)
    cell_size_m: float = setting(1.0, 'side of a cell [m]', gt=0.0)
    rows: int = setting(0, 'rows of a frame, 0 where not known', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 where not known', ge=0, le=16384)
    rate_hz: float = setting(
        0.0, 'frames a second of wall time, 0 for the pace at which they were recorded', ge=0.0,
        le=100_000.0)
    lockstep: bool = setting(
        False, 'publish a frame when the one before has been scored, not by the clock')
    patience_s: float = setting(
        15.0, 'longest wait, in lockstep, for a frame to be scored [s]', gt=0.0)
    resume_after_ns: int = setting(
        -1, 'stamp after which the frames go on where the node was started again [ns]', ge=-1)

    def __post_init__(self) -> None:
        check_settings(self)
