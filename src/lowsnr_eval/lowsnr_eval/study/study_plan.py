# SPDX-License-Identifier: Apache-2.0
"""
From what a user asks for to a study, all checked before anything runs.

Detectors, trackers, the sensor and the evaluation have the settings that a run of the node
graph would give them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from typing import TypeVar

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import SimulationSettings
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_eval.study.examples import Example
from lowsnr_eval.study.examples import EXAMPLES
from lowsnr_eval.study.examples import Variant
from lowsnr_eval.study.study import Case
from lowsnr_eval.study.study import EMPTY
from lowsnr_eval.study.study import Method
from lowsnr_eval.study.study import OBJECT
from lowsnr_eval.study.study import Study
from lowsnr_eval.study.study import StudyOptions
from lowsnr_eval.study.study import SWEEP
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.pda_mmpf import PdaMmpf

T = TypeVar('T')
_SWEEP_SNRS_DB = (1.0, 3.0, 6.0, 9.0, 12.0)


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
    methods = [_method(variant, example, options, config_folder) for variant in variants]
    plan = plan_run(RunOptions(
        detectors=['cdt'], scenario=example.scenario, seed=options.seed), config_folder)
    sensor = graph.build(SimulationSettings, plan.parameters['/sensor'], 'sensor').sensor
    evaluation = graph.build(Evaluation, plan.parameters['/evaluator'], 'evaluator')

    def case(kind: str, snr_db: float) -> Case:
        tuned = [replace(
            method, detector=_at_snr(method.detector, snr_db),
            tracker=_at_snr(method.tracker, snr_db), runs=_runs(kind, method, example, options))
            for method in methods]
        return Case(
            kind, snr_db, options.few_runs,
            replace(scenario, objects=()) if kind == EMPTY else scenario,
            replace(sensor, snr_db=snr_db), _at_snr(evaluation, snr_db), tuple(tuned))

    cases = [case(kind, snr) for snr in snrs_db for kind in (OBJECT, EMPTY)]
    cases += [case(SWEEP, snr) for snr in _SWEEP_SNRS_DB if snr not in snrs_db]
    return Study(example, options, tuple(v.label for v in variants), tuple(cases))


def _variants(example: Example, wanted: Sequence[str] | None) -> list[Variant]:
    """Return the methods of a study, those that the paper compares first."""
    for name in wanted or ():
        detector_class(name)
    detector_class('sdt')  # makes every detector register itself
    special = {variant.label: variant for variant in example.variants}
    labels = list(dict.fromkeys([*example.compared, *special, *sorted(DETECTORS)]))
    chosen = [special.get(label, Variant(label, label)) for label in labels]
    return [variant for variant in chosen if wanted is None or variant.detector in wanted]


def _method(
    variant: Variant, example: Example, options: StudyOptions, config_folder: Path,
) -> Method:
    plan = plan_run(RunOptions(
        detectors=[variant.detector], scenario=example.scenario, seed=options.seed,
        overrides=_overrides(example, variant)), config_folder)
    (node, detector), = plan.detectors.items()
    tracker = graph.build(PdaMmpf, plan.parameters['/tracker'], 'tracker')
    if tracker.life.false_tracks:
        raise ValueError(
            f'tracker.yaml: life.false_tracks = {tracker.life.false_tracks:g}: a study takes '
            'life.confirm_probability; set life.false_tracks to 0')
    prob = plan.parameters[node].get('false_alarm_prob', DetectionSettings.false_alarm_prob)
    return Method(variant.label, detector, tracker, prob, options.few_runs)


def _at_snr(item: T, snr_db: float) -> T:
    """Return settings with another SNR in their sensor model."""
    settings: Any = item
    changed: T = replace(settings, sensor=replace(settings.sensor, snr_db=snr_db))
    return changed


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
