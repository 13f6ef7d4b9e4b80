"""Settings that nodes have beside those of their algorithm."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting


@dataclass(frozen=True, kw_only=True)
class NodeSettings:
    """What every node has."""

    autostart: bool = setting(
        True, 'configure and activate the node by itself; false where a manager does it')
    consumers: int = setting(
        0, 'readers that the output must have, and every input a writer, before the node becomes '
        'active; 0 waits for nobody', ge=0, le=100)
    observers: int = setting(
        0, 'readers that every output must have beside the consumers, such as a recorder', ge=0,
        le=100)
    queue_depth: int = setting(
        1000, 'messages kept for a slow reader; frames at most 256 MiB', ge=1, le=100_000)
    seed: int = setting(0, 'root seed of the random streams', ge=0)
    lives: int = setting(
        0, 'how often the node was started before in the same run; above 0 it goes on where it '
        'was', ge=0)
    live: bool = setting(
        False, 'whether image_raw is that of a camera, which may go and come: nobody waits for it')
    silence_s: float = setting(
        10.0, 'wall time without a message after which /diagnostics calls an input silent [s]',
        gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """What the simulated sensor shows, and how fast."""

    sensor: SensorModel = field(default_factory=SensorModel)
    scenario: str = setting('', 'path of the scenario file')
    frames: int = setting(0, 'frames to publish, 0 for the length of the scenario', ge=0)
    rate_hz: float = setting(
        10.0, 'frames a second of wall time, whatever the frame period', gt=0.0, le=100_000.0)
    lockstep: bool = setting(
        False, 'publish a frame when the one before has been scored, not by the clock')
    loop: bool = setting(False, 'repeat the scenario, with new noise, until stopped')
    patience_s: float = setting(
        15.0, 'longest wait, in lockstep, for a frame to be scored [s]', gt=0.0)
    resume_after_ns: int = setting(
        -1, 'stamp after which the frames go on where the node was started again [ns]', ge=-1)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class DetectionSettings:
    """Where on its curve of detection against false alarm a detector works."""

    operating_point: str = setting(
        'matched', "'matched': threshold calibrated to false_alarm_prob; 'nominal': as the test "
        "is designed; 'manual': the parameter threshold", choices=('matched', 'nominal', 'manual'),
        live=True)
    false_alarm_prob: float = setting(
        0.01, 'share of empty frames with any declaration, when matched', gt=0.0, lt=1.0,
        live=True)
    rows: int = setting(0, 'rows of a frame, 0 to take them from the first', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 to take them from the first', ge=0, le=16384)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class TruthSettings:
    """Whether a node that changes the pixels of frames takes the truth with them."""

    sensor: SensorModel = field(default_factory=SensorModel)
    truth: bool = setting(True, 'whether there is a truth to pass on, in the new pixels')

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Which chains are scored, and the folder of the results."""

    results: str = setting('results/run', 'folder for the scores, made where it is missing')
    scenario: str = setting('', 'name of what the frames show, for the summary')
    detectors: tuple[str, ...] = setting(('sdt',), 'names of the chains')
    operating_points: tuple[str, ...] = setting(
        ('matched',), 'operating point of each chain, for the summary')
    namespaces: bool = setting(
        False, 'whether each chain has its topics in a namespace of its name')
    truth: bool = setting(
        True, 'whether truth comes with the frames; without it what is declared is counted alone')
    answer_within_s: float = setting(
        10.0, 'wall time after which a frame counts as unanswered [s]', gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if len(self.operating_points) != len(self.detectors):
            raise ValueError('RunSettings.operating_points must name one for each detector')


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What counts as a hit, and what an object missed or declared in vain costs."""

    sensor: SensorModel = field(default_factory=SensorModel)
    gate_cells: float = setting(
        1.5, 'largest distance from an object at which an estimate hits it [cells]', gt=0.0)
    gospa_cutoff_cells: float = setting(
        5.0, 'distance c of GOSPA beyond which an object counts as missed [cells]', gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def gate_m(self) -> float:
        """Largest distance of a hit [m]."""
        return self.gate_cells * self.sensor.cell_size_m

    @property
    def gospa_cutoff_m(self) -> float:
        """Cutoff of GOSPA [m]."""
        return self.gospa_cutoff_cells * self.sensor.cell_size_m


@dataclass(frozen=True, kw_only=True)
class ViewSettings:
    """What viewers are shown."""

    sensor: SensorModel = field(default_factory=SensorModel)
    side: int = setting(
        480, 'least length of the longer side of an overlay [pixels]', ge=1, le=4096)
    trail_frames: int = setting(
        40, 'frames over which the past of a track is shown', ge=1, le=1000)
    ellipse_sigmas: float = setting(
        2.0, 'half axes of the ellipse of a track, in standard deviations', gt=0.0, le=10.0)

    def __post_init__(self) -> None:
        check_settings(self)
