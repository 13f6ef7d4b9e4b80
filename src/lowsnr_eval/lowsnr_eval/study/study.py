"""
A study: an example of Section VI, from options to blocks of runs, all checked beforehand.

Besides the runs of the example there are runs without the object, which say how often each
chain raises a false alarm, and runs at the SNRs of the other examples.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_bringup.plan.run_plan import RunPlan
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.config import declared_settings
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import SimulationSettings
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_eval.study.examples import Example
from lowsnr_eval.study.examples import EXAMPLES
from lowsnr_eval.study.examples import Variant
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.offline_chain import Chain
from lowsnr_eval.study.study_options import StudyOptions
from lowsnr_sensor.scenario import load_scenario
from lowsnr_sensor.scenario import Scenario
from lowsnr_track.pda_mmpf import PdaMmpf

POINTS = ('nominal', 'matched')
OBJECT, EMPTY, SWEEP = 'object', 'empty', 'sweep'
# Thresholds of the curve of P_D against P_FA, from the matched one [nat].
ROC_OFFSETS = (-6.0, -4.5, -3.0, -2.0, -1.0, 1.0, 2.5)
BLOCK_RUNS = 20
_SWEEP_SNRS_DB = (1.0, 3.0, 6.0, 9.0, 12.0)
# Few runs need no better thresholds than these calibrations give, with 60 false alarms each.
_SWEEP_CALIBRATION_RUNS = 150
# What is calibrated: detector, false-alarm probability, shape, and runs if not the default.
Calibrated = tuple[Any, float, tuple[int, int], int | None]
Thresholds = Mapping[Calibrated, float]


@dataclass(frozen=True)
class Method:
    """A detector, not yet calibrated, with its tracker and the runs it takes part in."""

    label: str
    detector: Any
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
        """Return what is run, given the matched thresholds."""
        chains = []
        for method in self.methods:
            matched = replace(method.detector, threshold=thresholds[self.calibration(method)])
            tracker = None if self.kind == SWEEP else method.tracker
            chains += [
                Chain(method.label, point, detector, tracker, method.runs)
                for point, detector in zip(POINTS, (method.detector.nominal(), matched))]
            chains += [
                Chain(method.label, roc_point(offset),
                      replace(matched, threshold=matched.threshold + offset), None,
                      min(method.runs, self.few_runs))
                for offset in ROC_OFFSETS if self.kind != SWEEP]
        return tuple(chains)


def roc_point(offset: float) -> str:
    """Return the name of the operating point at an offset from the matched threshold [nat]."""
    return f'matched{offset:+g}'


@dataclass(frozen=True)
class Study:
    """An example with all its cases."""

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
        """Return the tasks by name, given the matched thresholds."""
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


def plan_study(options: StudyOptions, config_folder: Path) -> Study:
    """
    Check the options and plan the study.

    Raises
    ------
    ValueError
        One line that names the culprit and what is allowed.

    """
    if options.example not in EXAMPLES:
        raise ValueError(
            f'example {options.example} is not one of {", ".join(map(str, EXAMPLES))}')
    if options.runs < 1:
        raise ValueError(f'runs = {options.runs}, must be at least 1')
    example = EXAMPLES[options.example]
    variants = _variants(example, options.detectors)
    scenario = load_scenario(config_folder / 'scenarios' / f'{example.scenario}.yaml')
    snrs_db = options.snrs_db or scenario.snrs_db
    sweep = [snr for snr in _SWEEP_SNRS_DB if snr not in snrs_db]
    methods = [_method(variant, example, options, config_folder) for variant in variants]
    common = plan_run(RunOptions(
        detectors=['cdt'], scenario=example.scenario, seed=options.seed), config_folder)
    case = _case(scenario, common, options.few_runs)
    kinds = [(kind, snr) for snr in snrs_db for kind in (OBJECT, EMPTY)]
    cases = [_at_snr(case, kind, snr, methods, example, options)
             for kind, snr in [*kinds, *((SWEEP, snr) for snr in sweep)]]
    return Study(example, options, tuple(v.label for v in variants), tuple(cases))


def _variants(example: Example, wanted: Sequence[str] | None) -> list[Variant]:
    """Return the methods of a study, those that the paper compares first."""
    for name in wanted or ():
        detector_class(name)
    detector_class('sdt')  # has every detector register itself
    special = {variant.label: variant for variant in example.variants}
    labels = list(dict.fromkeys([*example.compared, *special, *sorted(DETECTORS)]))
    chosen = [special.get(label, Variant(label, label)) for label in labels]
    return [variant for variant in chosen if wanted is None or variant.detector in wanted]


def _method(
    variant: Variant, example: Example, options: StudyOptions, config_folder: Path,
) -> Method:
    """Return a method with the settings that a run of the node graph gives it."""
    plan = plan_run(RunOptions(
        detectors=[variant.detector], scenario=example.scenario, seed=options.seed,
        overrides=_overrides(example, variant)), config_folder)
    (node, detector), = plan.detectors.items()
    tracker = graph.build(PdaMmpf, plan.parameters['/tracker'], 'tracker')
    prob = plan.parameters[node].get('false_alarm_prob', DetectionSettings.false_alarm_prob)
    return Method(variant.label, detector, tracker, prob, options.few_runs)


def _case(scenario: Scenario, plan: RunPlan, few_runs: int) -> Case:
    """Return a case with the sensor and the evaluation of a run of the node graph."""
    simulation = graph.build(SimulationSettings, plan.parameters['/sensor'], 'sensor')
    evaluation = graph.build(Evaluation, plan.parameters['/evaluator'], 'evaluator')
    return Case(OBJECT, scenario.snr_db, few_runs, scenario, simulation.sensor, evaluation, ())


def _at_snr(
    case: Case, kind: str, snr_db: float, methods: Sequence[Method], example: Example,
    options: StudyOptions,
) -> Case:
    """Return the case of a kind at an SNR, which all that has a sensor reckons with."""
    def tuned(item: Any) -> Any:
        return replace(item, sensor=replace(item.sensor, snr_db=snr_db))

    scenario = replace(case.scenario, objects=()) if kind == EMPTY else case.scenario
    return replace(
        case, kind=kind, snr_db=snr_db, scenario=scenario,
        sensor=replace(case.sensor, snr_db=snr_db), evaluation=tuned(case.evaluation),
        methods=tuple(
            replace(
                method, detector=tuned(method.detector), tracker=tuned(method.tracker),
                runs=_runs(kind, method, example, options))
            for method in methods))


def _runs(kind: str, method: Method, example: Example, options: StudyOptions) -> int:
    if kind == SWEEP or method.label not in example.compared:
        return options.few_runs
    return options.empty_runs if kind == EMPTY else options.runs


def _overrides(example: Example, variant: Variant) -> tuple[str, ...]:
    if not example.max_speed_mps:
        return variant.overrides
    speed = f'motion.max_speed_mps={example.max_speed_mps}'
    own = [f'tracker.{speed}']
    if 'motion.max_speed_mps' in declared_settings(detector_class(variant.detector)):
        own.append(f'{variant.detector}.{speed}')
    return (*variant.overrides, *own)
