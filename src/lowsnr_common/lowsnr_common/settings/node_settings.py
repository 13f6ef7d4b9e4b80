# SPDX-License-Identifier: Apache-2.0
"""
The settings of nodes, apart from those of their algorithms.

In the order of the data: sensor, player, conditioner, detector, viewer, evaluator, recorder.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting


class _Checked:
    """Settings that are checked when they are made."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class NodeSettings(_Checked):
    """Settings of every node."""

    autostart: bool = setting(
        True, 'whether the node configures and activates itself; false if a manager does it')
    consumers: int = setting(
        0, 'subscribers that the output must have before the node becomes active; above 0 the '
        'node also waits for a publisher of every input', ge=0, le=100)
    observers: int = setting(
        0, 'subscribers, such as a recorder, that every output must have besides the consumers',
        ge=0, le=100)
    queue_depth: int = setting(
        1000, 'messages kept for a slow subscriber; of frames at most 256 MiB', ge=1, le=100_000)
    seed: int = setting(0, 'root seed of the random streams', ge=0)
    lives: int = setting(
        0, 'how often the node was started before in the same run; above 0 it continues where it '
        'stopped', ge=0)
    live: bool = setting(
        False, 'whether image_raw comes from a camera, which may stop and start again: the node '
        'does not wait for it')
    compressed: bool = setting(
        False, 'whether the camera sends compressed images (sensor_msgs/CompressedImage)')
    silence_s: float = setting(
        10.0, 'wall time without a message after which /diagnostics reports an input as silent '
        '[s]', gt=0.0)


@dataclass(frozen=True, kw_only=True)
class SimulationSettings(_Checked):
    """Settings of the sensor: what it simulates, and how fast it publishes frames."""

    sensor: SensorModel = field(default_factory=SensorModel)
    scenario: str = setting('', 'path of the scenario file')
    frames: int = setting(0, 'frames to publish, 0 for the length of the scenario', ge=0)
    rate_hz: float = setting(
        10.0, 'frames a second of wall time, independent of the frame period', gt=0.0,
        le=100_000.0)
    lockstep: bool = setting(
        False, 'whether a frame is published once the one before is scored, not at rate_hz')
    loop: bool = setting(False, 'whether the scenario is repeated, with new noise, until stopped')
    lag: int = setting(
        0, 'longest lag of the detectors: in lockstep so many frames more are under way', ge=0)
    patience_s: float = setting(
        15.0, 'longest wait, in lockstep, for a frame to be scored [s]', gt=0.0)
    resume_after_ns: int = setting(
        -1, 'stamp after which a restarted node continues with the frames [ns]; -1 for the first '
        'start', ge=-1)


@dataclass(frozen=True, kw_only=True)
class PlayerSettings(_Checked):
    """Settings of the player: which topics of which bag it publishes, and how fast."""

    bag: str = setting('', 'path of the bag')
    frames_topic: str = setting('/image_raw', 'topic of the frames in the bag')
    truth_topic: str = setting(
        '/ground_truth', 'topic of the truth in the bag, its odometry below it; empty for none')
    truth_bag: str = setting('', 'path of the bag that has the truth; empty for the same bag')
    left_out: tuple[int, ...] = setting(
        (), 'numbers of the frames in the bag, from 0, whose stamps are not in order', ge=0)
    simulated: bool = setting(
        False, 'whether the frames are simulated; a recording of the replay carries it on')
    frames: int = setting(0, 'frames to publish, 0 for all', ge=0)
    cell_size_m: float = setting(1.0, 'side of a cell [m]', gt=0.0)
    rows: int = setting(0, 'rows of a frame, 0 if not known', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 if not known', ge=0, le=16384)
    rate_hz: float = setting(
        0.0, 'frames a second of wall time, 0 for the rate at which they were recorded', ge=0.0,
        le=100_000.0)
    lockstep: bool = setting(
        False, 'whether a frame is published once the one before is scored, not at rate_hz')
    lag: int = setting(
        0, 'longest lag of the detectors: in lockstep so many frames more are under way', ge=0)
    patience_s: float = setting(
        15.0, 'longest wait, in lockstep, for the score of a frame [s]', gt=0.0)
    resume_after_ns: int = setting(
        -1, 'stamp after which a restarted node continues with the frames [ns]; -1 for the first '
        'start', ge=-1)


@dataclass(frozen=True, kw_only=True)
class FrameSettings(_Checked):
    """Settings of detector, tracker and evaluator about where their frames come from."""

    conditioned: bool = setting(
        False, 'whether a conditioner stands before the detector: the node then waits for the map '
        'of every frame, on camera_info')


@dataclass(frozen=True, kw_only=True)
class CameraFrameSettings(_Checked):
    """Settings of the conditioner's node: the size of the camera's frames."""

    rows: int = setting(
        0, 'rows of a frame, 0 if not known; large frames have a short queue', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 if not known', ge=0, le=16384)


@dataclass(frozen=True, kw_only=True)
class DetectionSettings(_Checked):
    """Settings of the node of a detector: its operating point, and the size of its frames."""

    operating_point: str = setting(
        'matched', "'matched': the threshold is calibrated to false_alarm_prob; 'adaptive': it is "
        "learned from earlier frames, for false_alarm_prob; 'nominal': the threshold of the "
        "test's design; 'manual': the parameter threshold",
        choices=('matched', 'adaptive', 'nominal', 'manual'), live=True)
    false_alarm_prob: float = setting(
        0.01, 'share of empty frames with any declaration, if matched or adaptive', gt=0.0, lt=1.0,
        live=True)
    statistic_map: bool = setting(
        False, 'whether the test statistic of every cell is published on statistic')
    rows: int = setting(0, 'rows of a frame; 0 takes those of the first frame', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame; 0 takes those of the first frame', ge=0, le=16384)


@dataclass(frozen=True, kw_only=True)
class TileSettings(_Checked):
    """Settings of the nodes of a divided detector: its tiles, and how long they are waited for."""

    tiles_down: int = setting(0, 'rows of tiles of a frame', ge=0, le=16)
    tiles_across: int = setting(0, 'columns of tiles of a frame', ge=0, le=16)
    tile_within_s: float = setting(
        5.0, 'longest wait of a frame for a tile, after the first one [s]', gt=0.0)


@dataclass(frozen=True, kw_only=True)
class ViewSettings(_Checked):
    """Settings of the viewer: how overlay, markers and live page look."""

    sensor: SensorModel = field(default_factory=SensorModel)
    side: int = setting(
        480, 'least length of the longer side of the overlay [pixels]', ge=1, le=4096)
    trail_frames: int = setting(40, 'length of the trail of a track [frames]', ge=1, le=1000)
    lag: int = setting(
        0, 'lag of the detector: frames for whose answers the viewer waits more', ge=0)
    ellipse_sigmas: float = setting(
        2.0, 'half axes of the ellipse of a track [standard deviations]', gt=0.0, le=10.0)
    page: bool = setting(True, 'whether to serve a live page on the loopback address')
    page_port: int = setting(
        0, 'port of the live page; 0 for the first free one from 8470 on', ge=0, le=65535)
    browser: bool = setting(False, "whether to open the live page in the user's browser")
    statistic_map: bool = setting(
        False, 'whether the live page shows what the detector publishes on statistic')
    title: str = setting('', 'title of the live page')
    pixels: bool = setting(False, 'whether the live page states positions in pixels, not metres')
    gate_cells: float = setting(
        1.5, 'largest distance of a track from the object that it is on [cells]', gt=0.0)


@dataclass(frozen=True, kw_only=True)
class RunSettings(_Checked):
    """Settings of the evaluator: which chains it scores, and the folder of the results."""

    results: str = setting('results/run', 'folder for the scores; a missing one is made')
    scenario: str = setting('', 'name of the scenario, bag or camera, for the summary')
    detectors: tuple[str, ...] = setting(('sdt',), 'names of the chains')
    operating_points: tuple[str, ...] = setting(
        ('matched',), 'operating point of each chain, for the summary')
    lags: tuple[int, ...] = setting(
        (), 'frames by which the answers of each chain are late; empty if none is', ge=0)
    statistic_maps: tuple[str, ...] = setting(
        (), 'names of the chains that publish statistic, for the report')
    false_tracks: tuple[float, ...] = setting(
        (), 'false tracks a frame asked of each chain; empty if of none', ge=0.0, lt=1.0)
    namespaces: bool = setting(
        False, 'whether the topics of each chain are in a namespace of its name')
    truth: bool = setting(
        True, 'whether a truth is published; without it declarations are only counted')
    expected_frames: int = setting(
        0, 'frames that the source is to publish, 0 for a run without end', ge=0)
    answer_within_s: float = setting(
        10.0, 'wall time after which a frame counts as unanswered [s]', gt=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.operating_points) != len(self.detectors):
            raise ValueError('RunSettings.operating_points must name one for each detector')
        if self.lags and len(self.lags) != len(self.detectors):
            raise ValueError('RunSettings.lags must name one for each detector')

    @property
    def longest_lag(self) -> int:
        """Frames by which the latest answer is late."""
        return max(self.lags, default=0)


@dataclass(frozen=True, kw_only=True)
class Evaluation(_Checked):
    """Settings of the evaluator: the largest distance of a hit, and the cutoff of GOSPA."""

    sensor: SensorModel = field(default_factory=SensorModel)
    gate_cells: float = setting(
        1.5, 'largest distance of an estimate from an object that counts as a hit [cells]', gt=0.0)
    gospa_cutoff_cells: float = setting(
        5.0, 'cutoff c of GOSPA: the distance from which an object counts as missed [cells]',
        gt=0.0)
    pixels: bool = setting(
        False, 'whether tables and figures state positions in pixels instead of metres')

    @property
    def gate_m(self) -> float:
        """Largest distance of a hit [m]."""
        return self.gate_cells * self.sensor.cell_size_m

    @property
    def gospa_cutoff_m(self) -> float:
        """Cutoff of GOSPA [m]."""
        return self.gospa_cutoff_cells * self.sensor.cell_size_m


@dataclass(frozen=True, kw_only=True)
class RecorderSettings(_Checked):
    """Settings of the recorder: where it writes, and which topics it waits for."""

    bag: str = setting('bag', 'folder of the bag, which must not exist')
    storage: str = setting('mcap', 'storage format of the bag', choices=('mcap', 'sqlite3'))
    run_parameters: str = setting('', 'parameter file of the run, which is copied into the bag')
    topics: tuple[str, ...] = setting(
        (), 'topics that must be received before the recorder becomes active')
    rows: int = setting(0, 'rows of a frame, 0 if not known', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 if not known', ge=0, le=16384)
