# SPDX-License-Identifier: Apache-2.0
"""From the arguments of a call to the settings of its chain, by the plan of a graph."""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Iterator
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import replace
import difflib
import operator
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_bringup.plan.sources import MATCHED
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.flat_values import build_settings
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_common.settings.node_settings import NodeSettings
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.parts.registry import detector_class
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np

CONFIG = Path(__file__).resolve().parent / 'config'
DEFAULT_FOR_CAMERAS, DEFAULT = 'auto', 'sdt'
SENSOR, TRACKER, CONDITIONER, EVERY_PART = 'sensor', 'tracker', 'conditioner', 'all'
_MAP = 'statistic_map'
# Settings of a detector's node that are no settings here.
_OF_THE_GRAPH = ('rows', 'cols', 'sensor.frame_period_s', _MAP)
# The declarations of the settings that have arguments of their own.
_DECLARED = {
    'snr_db': (SensorModel, 'snr_db'), 'period_s': (SensorModel, 'frame_period_s'),
    'seed': (NodeSettings, 'seed'), 'false_alarm_prob': (DetectionSettings, 'false_alarm_prob')}


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the functions of :mod:`lowsnr` have in common; None leaves a choice to them."""

    detector: str | None = None
    snr_db: float | None = None
    period_s: float = 1.0
    false_alarm_prob: float | None = None
    seed: int = 0
    settings: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class Chain:
    """
    The parts that process frames, with all their settings.

    ``shape`` are the rows and columns that the detector gets.
    """

    name: str
    detector: Detector
    operating: DetectionSettings
    tracker: PdaMmpf
    conditioner: ConditioningSettings | None
    shape: tuple[int, int]
    period_s: float
    seed: int

    def settings(self) -> dict[str, Any]:
        """Return the settings of all parts by their full names."""
        parts = [(self.name, self.operating), (self.name, self.detector), (TRACKER, self.tracker)]
        if self.conditioner is not None:
            parts.append((CONDITIONER, self.conditioner))
        return {f'{part}.{key}': value for part, own in parts
                for key, value in flat_values(own).items() if key not in _OF_THE_GRAPH}


def plan_chain(shape: tuple[int, int, int], conditioned: bool, options: Options) -> Chain:
    """
    Return the chain for (K, rows, cols) frames.

    Raises
    ------
    ValueError
        One line that names the argument and what is allowed.

    """
    name = _detector_name(options.detector, conditioned)
    count, rows, cols = shape
    given = {key: checked(key, getattr(options, key)) for key in _DECLARED}
    found = RecordedRun(
        name='frames', frames=count, rows=rows, cols=cols, period_s=given['period_s'],
        truth=False, raw=conditioned)
    plan = plan_run(RunOptions(
        detectors=[name], scenario='', seed=given['seed'], snr_db=given['snr_db'],
        overrides=dict(_overrides(name, conditioned, options))), CONFIG, array=found)
    values = plan.parameters[path := f'/{graph.node_of(name)}']
    return Chain(
        name=name, detector=plan.detectors[path],
        operating=graph.build(DetectionSettings, values, name),
        tracker=graph.build(PdaMmpf, plan.parameters[f'/{TRACKER}'], TRACKER),
        conditioner=graph.build(
            ConditioningSettings, plan.parameters[f'/{CONDITIONER}'], CONDITIONER)
        if conditioned else None,
        shape=(values['rows'], values['cols']), period_s=given['period_s'],
        seed=given['seed'])


def _overrides(
    name: str, conditioned: bool, options: Options,
) -> Iterator[tuple[str, Any]]:
    """Yield the settings that win over the files, by full name."""
    if not conditioned:  # white noise is what a calibration simulates
        yield f'{name}.operating_point', MATCHED
    if options.false_alarm_prob is not None:
        yield f'{name}.false_alarm_prob', checked(
            'false_alarm_prob', options.false_alarm_prob)
    allowed = _allowed(name, conditioned)
    parts = f'{name}, {TRACKER}{f" or {CONDITIONER}" * conditioned}'
    yield from checked_settings(options.settings, allowed, parts).items()


def checked_settings(
    given: Mapping[str, Any] | None, allowed: Collection[str], parts: str,
) -> dict[str, Any]:
    """Return settings whose full names are among the allowed ones, those of some parts."""
    if given is not None and not isinstance(given, Mapping):
        raise ValueError(f'settings = {given!r}, must be a mapping of names to values')
    for key in given or {}:
        if key in allowed:
            continue
        if str(key).endswith('sensor.frame_period_s'):
            raise ValueError(f'settings: {key!r} is that of the frames: pass period_s')
        if str(key).endswith(f'.{_MAP}'):
            raise ValueError(
                f'settings: {key!r} has a node publish pictures, which are not returned here: '
                'leave it out')
        near = [f'{EVERY_PART}.{key}'] if f'{EVERY_PART}.{key}' in allowed else (
            difflib.get_close_matches(str(key), allowed, n=1))
        hint = f'; did you mean {near[0]!r}?' if near else ''
        raise ValueError(f'settings: {key!r} is no setting of {parts}{hint}')
    return {key: plain(value) for key, value in (given or {}).items()}


def checked_shape(shape: Any) -> tuple[int, int]:
    """Return the rows and columns of a frame, each a whole number of at least one."""
    try:
        rows, cols = map(operator.index, shape)
    except (TypeError, ValueError):
        rows = cols = 0
    if min(rows, cols) < 1:
        raise ValueError(
            f'shape = {shape!r}, must be (rows, cols), two whole numbers of at least 1')
    return rows, cols


def sensor_of(snr_db: float, given: Mapping[str, Any] | None) -> SensorModel:
    """Return the sensor of a simulation."""
    names = {f'{SENSOR}.{key}': key for key in declared_settings(SensorModel)}
    found = checked_settings(given, names, SENSOR)
    values = {'snr_db': checked('snr_db', snr_db)} | {names[key]: found[key] for key in found}
    try:
        return build_settings(SensorModel, values)
    except ValueError as error:
        raise ValueError(f'settings: {error}') from None


def _detector_name(given: str | None, conditioned: bool) -> str:
    if given is not None and not isinstance(given, str):
        raise ValueError(f'detector = {given!r}, must be a name, such as {DEFAULT!r}')
    name = (DEFAULT_FOR_CAMERAS if conditioned else DEFAULT) if given is None else given
    detector_class(name)
    return name


def _allowed(name: str, conditioned: bool) -> list[str]:
    parts: list[tuple[str, type]] = [
        (name, DetectionSettings), (name, detector_class(name)), (TRACKER, PdaMmpf)]
    if conditioned:
        parts.append((CONDITIONER, ConditioningSettings))
    return [f'{part}.{key}' for own, cls in parts for part in (own, EVERY_PART)
            for key in declared_settings(cls) if key not in _OF_THE_GRAPH]


def plain(value: Any) -> Any:
    """Return numbers of NumPy as those of Python."""
    return value.tolist() if isinstance(value, (np.generic, np.ndarray)) else value


def checked(argument: str, value: Any) -> Any:
    """Return the value of an argument, None for one that was not given; checked as declared."""
    if value is None and argument in ('snr_db', 'false_alarm_prob'):
        return None
    cls, name = _DECLARED[argument]
    return replace(declared_settings(cls)[name], name=argument).check(plain(value))
