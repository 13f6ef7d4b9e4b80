# SPDX-License-Identifier: Apache-2.0
"""
Scenarios: which objects exist in which frames, and how they move.

A scenario is a YAML file; the commented files in ``config/scenarios`` are the manual.  Frames are
numbered from 1, as in the paper.  A file describes an object in one of three ways: by the legs of
a manoeuvre, by waypoints, or by motion modes from which its trajectory is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import fields
from pathlib import Path
from typing import Any
from typing import TypeVar

from lowsnr_common.core.bound_motion import DestinationDensity
from lowsnr_common.core.bound_motion import PlaceDensity
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_common.settings.flat_values import check_values
from lowsnr_common.settings.text import one_line
from lowsnr_common.settings.text import read_yaml
from lowsnr_sensor.trajectories import Leg
from lowsnr_sensor.trajectories import MAX_FRAMES
from lowsnr_sensor.trajectories import random_trajectory
from lowsnr_sensor.trajectories import Start
from lowsnr_sensor.trajectories import trajectory_along_legs
from lowsnr_sensor.trajectories import trajectory_through_waypoints
from lowsnr_sensor.trajectories import Waypoint
import numpy as np

T = TypeVar('T')


@dataclass(frozen=True, kw_only=True)
class ScenarioObject:
    """One object: the frames in which it is present, its SNR and its motion."""

    id: str = setting('object', 'name of the object, its id in ground_truth')  # noqa: A003
    first_frame: int = setting(1, 'frame in which it appears', ge=1, le=MAX_FRAMES)
    last_frame: int = setting(
        1, 'last frame in which it is present', ge=1, le=MAX_FRAMES)
    snr_offset_db: float = setting(
        0.0, 'its SNR less that of the scenario [dB]', ge=-60.0, le=60.0)
    start: Start | None = None
    legs: tuple[Leg, ...] = ()
    waypoints: tuple[Waypoint, ...] = ()
    random: MotionModes | None = None
    origin: PlaceDensity | None = None
    destinations: tuple[DestinationDensity, ...] = ()

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.id:
            raise ValueError('id is empty, must be a name')
        if not self.id.isprintable():  # a message could not carry it unchanged
            raise ValueError(f'id = {self.id!r}, must consist of printable characters')
        if self.last_frame < self.first_frame:
            raise ValueError(f'last_frame = {self.last_frame}, must be at least first_frame')
        if sum(map(bool, (self.legs, self.waypoints, self.random))) != 1:
            raise ValueError('an object must have one of legs, waypoints and random')
        if bool(self.legs) != bool(self.start):
            raise ValueError('start and legs must be given together')
        self._check_bound()
        ends = [leg.until_frame for leg in self.legs] or [p.frame for p in self.waypoints]
        if ends != sorted(set(ends)) or (ends and ends[0] < self.first_frame):
            raise ValueError('frames of legs or waypoints must increase, from first_frame on')
        if ends and ends[-1] != self.last_frame:
            raise ValueError(f'legs or waypoints must end at last_frame = {self.last_frame}')
        if self.waypoints and (len(ends) < 2 or ends[0] != self.first_frame):
            raise ValueError('waypoints must be two or more, the first at first_frame')

    def _check_bound(self) -> None:
        """Check origin and destinations."""
        if (self.origin or self.destinations) and not self.random:
            raise ValueError('origin and destinations are for an object with random')
        if self.destinations and self.random and not self.random.acceleration_density:
            raise ValueError(
                'random.acceleration_density = 0.0, must be above 0 for an object with '
                'destinations: without process noise it could not reach them')
        if sum(each.probability for each in self.destinations) > 1.0 + 1e-9:
            raise ValueError('destinations: the sum of probability must be at most 1')
        for number, each in enumerate(self.destinations):
            if not self.first_frame < each.earliest_frame:
                raise ValueError(
                    f'destinations[{number}].earliest_frame = {each.earliest_frame}, must be '
                    f'above first_frame = {self.first_frame}')

    def trajectory(
        self, scenario: Scenario, period_s: float, cell_size_m: float, rng: np.random.Generator,
    ) -> np.ndarray:
        """Return its states from first_frame to last_frame, (frames, 4) [m, m/s]."""
        count = self.last_frame - self.first_frame + 1
        if self.random is not None:
            extent = (scenario.cols * cell_size_m, scenario.rows * cell_size_m)
            return random_trajectory(
                self.random, count, extent, cell_size_m, period_s, rng, self.origin,
                self.destinations, self.first_frame)
        if self.waypoints:
            return trajectory_through_waypoints(self.waypoints, period_s)
        assert self.start is not None
        return trajectory_along_legs(
            self.start, self.legs, self.first_frame, period_s,
            scenario.acceleration_density, rng)

    def fastest_mps(self, scenario: Scenario, period_s: float, cell_size_m: float) -> float:
        """Return the largest speed that it has, or may be drawn with [m/s]."""
        if self.random is not None:
            return self.random.max_speed_mps
        states = self.trajectory(scenario, period_s, cell_size_m, np.random.default_rng(0))
        return float(np.hypot(*states[:, VEL].T).max())


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Size and number of the frames, SNR, and the objects."""

    description: str = setting('', 'purpose of the scenario')
    frames: int = setting(40, 'number of frames K', ge=1, le=MAX_FRAMES)
    rows: int = setting(20, 'rows of a frame', ge=1, le=16384)
    cols: int = setting(20, 'columns of a frame', ge=1, le=16384)
    snr_db: float = setting(6.0, 'SNR of the objects [dB]', ge=-30.0, le=80.0)
    snrs_db: tuple[float, ...] = setting(
        (), 'SNRs of Monte Carlo studies [dB]', ge=-30.0, le=80.0)
    acceleration_density: float = setting(
        0.0, 'process noise v_k of eq. (1) on legs, spectral density [m^2/s^3]', ge=0.0)
    objects: tuple[ScenarioObject, ...] = ()

    def __post_init__(self) -> None:
        check_settings(self)
        for item in self.objects:
            if item.first_frame > self.frames:
                raise ValueError(
                    f'object {item.id}: first_frame = {item.first_frame}, must be at most '
                    f'frames = {self.frames}')
        names = [item.id for item in self.objects]
        if len(set(names)) != len(names):
            raise ValueError(f'objects: ids {names} must differ')

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.rows, self.cols

    def truth(
        self, period_s: float, cell_size_m: float, rng: np.random.Generator,
    ) -> list[list[Truth]]:
        """
        Draw the state of every object in every frame.

        Parameters
        ----------
        period_s
            Time from a frame to the next [s].
        cell_size_m
            Side of a cell [m]; an object outside the frame is absent.
        rng
            Source of randomness for process noise and random objects.

        Returns
        -------
        list of list of Truth
            The objects present in frame k at index k - 1.

        """
        present: list[list[Truth]] = [[] for _ in range(self.frames)]
        limit = np.array([self.cols, self.rows]) * cell_size_m
        for item in self.objects:
            states = item.trajectory(self, period_s, cell_size_m, rng)
            for k, state in enumerate(states, start=item.first_frame):
                corner = state[[0, 2]] + cell_size_m / 2
                if k <= self.frames and np.all(corner >= 0) and np.all(corner < limit):
                    present[k - 1].append(Truth(item.id, state, item.snr_offset_db))
        return present


def load_scenario(path: Path, period_s: float = 1.0, cell_size_m: float = 1.0) -> Scenario:
    """
    Read a scenario file and check all of it.

    Raises
    ------
    ValueError
        One line that names the file, the key and the allowed values; also for a trajectory
        without process noise that leaves the frame.

    """
    tree = read_yaml(path)
    try:
        scenario = _parse(Scenario, tree, '')
        _check_inside(scenario, period_s, cell_size_m)
    except ValueError as error:
        raise ValueError(f'{path}: {one_line(error)}') from None
    return scenario


_PARTS: dict[str, type] = {
    'objects': ScenarioObject, 'start': Start, 'legs': Leg, 'waypoints': Waypoint,
    'random': MotionModes, 'origin': PlaceDensity, 'destinations': DestinationDensity,
}


def _parse(cls: type[T], tree: Any, where: str) -> T:
    """Build a settings class and its nested parts from a YAML tree."""
    if not isinstance(tree, Mapping):
        raise ValueError(f'{where or "the file"} must map keys to values')
    parts = {item.name for item in fields(cls) if item.name in _PARTS}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for key in parts & set(tree):
        part, here = tree[key], f'{where}.{key}'.lstrip('.')
        if key in ('objects', 'legs', 'waypoints', 'destinations'):
            if not isinstance(part, list):
                raise ValueError(f'{here} must be a list')
            values[key] = tuple(
                _parse(_PARTS[key], item, f'{here}[{n}]') for n, item in enumerate(part))
        else:
            values[key] = _parse(_PARTS[key], part, here)
    try:
        values |= check_values(cls, {str(k): v for k, v in tree.items() if k not in parts})
        return cls(**values)
    except ValueError as error:
        raise ValueError(f'{where}: {error}' if where else str(error)) from None


def _check_inside(scenario: Scenario, period_s: float, cell_size_m: float) -> None:
    limit = np.array([scenario.cols, scenario.rows]) - 0.5
    for item in scenario.objects:
        places: dict[str, PlaceDensity] = {
            f'destinations[{number}]': each for number, each in enumerate(item.destinations)}
        for name, place in (places | ({'origin': item.origin} if item.origin else {})).items():
            x, y = place.x_m / cell_size_m, place.y_m / cell_size_m
            if not (-0.5 <= x < limit[0] and -0.5 <= y < limit[1]):
                raise ValueError(
                    f'object {item.id}: {name} is column {x:.1f}, row {y:.1f}, '
                    f'outside the frame of {scenario.cols} x {scenario.rows} cells')
        states = item.trajectory(scenario, period_s, cell_size_m, np.random.default_rng(0))
        if scenario.acceleration_density > 0.0:
            continue
        pixel = states[:, [0, 2]] / cell_size_m
        outside = ~np.all((pixel >= -0.5) & (pixel < limit), axis=1)  # true for NaN
        if outside.any():
            x, y = pixel[k := int(outside.argmax())]
            raise ValueError(
                f'object {item.id} leaves the frame at frame {item.first_frame + k} '
                f'(column {x:.1f}, row {y:.1f} of {scenario.cols} x {scenario.rows} cells)')
