# SPDX-License-Identifier: Apache-2.0
"""
A study: an example of Section VI as cases, methods, chains and blocks of runs.

Besides the runs of the example it has runs without the object, which measure how often each
chain raises a false alarm, and runs at the SNRs of the other examples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_detect.parts.detector import Detector
from lowsnr_eval.study.examples import Example
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.offline_chain import Chain
from lowsnr_sensor.scenario import Scenario
from lowsnr_track.pda_mmpf import PdaMmpf

POINTS = ('nominal', 'matched')
LEVELS = ('detection', 'tracking')
OBJECT, EMPTY, SWEEP = 'object', 'empty', 'sweep'
# Operating points of the curve of P_D against P_FA, by the offset of their threshold from the
# matched one [nat].
_ROC_OFFSETS = {f'matched{offset:+g}': offset for offset in (-6., -4.5, -3., -2., -1., 1., 2.5)}
# The same and the matched one, at rising thresholds.
ROC_POINTS = sorted((*_ROC_OFFSETS, 'matched'), key=lambda name: _ROC_OFFSETS.get(name, 0.0))
BLOCK_RUNS = 20
_LEAST_RUNS = 10
# With 150 runs a calibration counts 60 false alarms, which is enough for the few runs of a sweep.
_SWEEP_CALIBRATION_RUNS = 150
# What is calibrated: detector, false-alarm probability, shape, and runs if not the default.
Calibrated = tuple[Detector, float, tuple[int, int], int | None]
Thresholds = Mapping[Calibrated, float]


@dataclass(frozen=True)
class StudyOptions:
    """What a user asks for; None where the example decides."""

    example: int
    runs: int = 500
    snrs_db: tuple[float, ...] | None = None
    detectors: tuple[str, ...] | None = None
    seed: int = 0

    @property
    def few_runs(self) -> int:
        """Return the runs of a method that the paper does not compare."""
        return min(self.runs, max(_LEAST_RUNS, self.runs // 20))

    @property
    def empty_runs(self) -> int:
        """Return the runs without the object, of a method that the paper compares."""
        return min(self.runs, max(_LEAST_RUNS, self.runs // 10))

    @property
    def crowded_runs(self) -> int:
        """Return the runs in which the tracker follows a chain that declares dozens of objects."""
        return min(self.runs, max(2, self.runs // 50))


@dataclass(frozen=True)
class Method:
    """A detector before its calibration, with its tracker and the number of its runs."""

    label: str
    detector: Detector
    tracker: PdaMmpf
    false_alarm_prob: float
    runs: int


@dataclass(frozen=True)
class Case:
    """
    The runs at one SNR: with the object, without it, or as a point of the SNR curve.

    ``few_runs`` is the number of runs for the curve of P_D against P_FA.
    """

    kind: str
    snr_db: float
    few_runs: int
    scenario: Scenario
    sensor: SensorModel
    evaluation: Evaluation
    methods: tuple[Method, ...]

    @property
    def name(self) -> str:
        """Return the name of the case, also of its files."""
        return f'{self.kind}{self.snr_db:g}dB'

    def calibration(self, method: Method) -> Calibrated:
        """Return what the matched threshold of a method follows from."""
        runs = _SWEEP_CALIBRATION_RUNS if self.kind == SWEEP else None
        return method.detector, method.false_alarm_prob, self.scenario.shape, runs

    def chains(self, thresholds: Thresholds) -> tuple[Chain, ...]:
        """Return the chains that run, given the matched thresholds [nat]."""
        chains = []
        for method in self.methods:
            threshold = thresholds[self.calibration(method)]
            detectors = method.detector.nominal(), replace(method.detector, threshold=threshold)
            tracker = None if self.kind == SWEEP else method.tracker
            chains += [Chain(method.label, point, detector, tracker, method.runs)
                       for point, detector in zip(POINTS, detectors)]
            chains += [
                Chain(method.label, point, replace(method.detector, threshold=threshold + offset),
                      None, min(method.runs, self.few_runs))
                for point, offset in _ROC_OFFSETS.items() if self.kind != SWEEP]
        return tuple(chains)


@dataclass(frozen=True)
class Study:
    """An example with all its cases; ``labels`` are those of its methods."""

    example: Example
    options: StudyOptions
    labels: tuple[str, ...]
    cases: tuple[Case, ...]

    @property
    def snrs_db(self) -> tuple[float, ...]:
        """Return the SNRs that are studied [dB]."""
        return tuple(case.snr_db for case in self.cases if case.kind == OBJECT)

    def calibrations(self) -> set[Calibrated]:
        """Return what has to be calibrated."""
        return {case.calibration(method) for case in self.cases for method in case.methods}

    def blocks(self, thresholds: Thresholds) -> dict[str, Block]:
        """Return the tasks by name, given the matched thresholds [nat]."""
        blocks = {}
        for case in self.cases:
            chains = case.chains(thresholds)
            most = max(chain.runs for chain in chains)
            crowded = self.options.crowded_runs
            for first in range(0, most, BLOCK_RUNS):
                blocks[f'{case.name}-{first:05d}'] = Block(
                    case.scenario, case.sensor, case.evaluation, chains, self.options.seed,
                    first, min(BLOCK_RUNS, most - first),
                    crowded if case.kind == OBJECT else 1)
        return blocks
