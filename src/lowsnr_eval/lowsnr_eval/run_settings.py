"""Settings of the evaluator that say which run it scores and where the scores go."""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_sensor.config import check_settings
from lowsnr_sensor.config import setting


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
