# SPDX-License-Identifier: Apache-2.0
"""Whether detectors and tracker fit the frames that they get, and the memory of the machine."""

from __future__ import annotations

from collections.abc import Mapping
import os
from typing import Any

from lowsnr_common.core.destination import Destination
from lowsnr_detect.grid.fixed_lag import FixedLag
from lowsnr_detect.parts.detector import Detector


def check_destinations(label: str, settings: Any, shape: tuple[int, int]) -> None:
    """
    Check the destinations in the settings of a node, if it has any, for frames of a shape.

    The shape is (rows, cols), 0 x 0 if it is not known.

    Raises
    ------
    ValueError
        One line, if a destination lies outside the frame.

    """
    destination = getattr(settings, 'destination', None)
    destinations = getattr(settings, 'destinations', None)
    bound = {f'destinations[{number}]': each
             for number, each in enumerate(destinations.densities if destinations else ())}
    if isinstance(destination, Destination) and destination.probability:
        bound['destination'] = destination
    for name, each in bound.items() if all(shape) else ():
        _check_inside(
            f'{label}: {name}', (each.x_m, each.y_m), settings.sensor.cell_size_m, shape)


def check_detector(label: str, detector: Detector, values: Mapping[str, Any]) -> None:
    """
    Check a detector with the parameters of its node, which may state the size of a frame.

    Raises
    ------
    ValueError
        One line, if its destination lies outside the frame, if it needs more memory than the
        machine has, or if its statistic is published and the threshold is one of another.

    """
    shape = values.get('rows', 0), values.get('cols', 0)
    if values.get('statistic_map'):
        _check_map(label, detector)
    check_destinations(label, detector, shape)
    if isinstance(detector, FixedLag) and all(shape):
        _check_memory(label, detector, shape)


def _check_map(label: str, detector: Detector) -> None:
    decision = getattr(detector, 'decision', None)
    if decision and decision.places:
        raise ValueError(
            f'{label}: statistic_map shows existence, of which decision.rule '
            f'{decision.rule!r} has no threshold; set decision.rule to existence, or '
            'statistic_map to false')


def _check_inside(
    what: str, place_m: tuple[float, float], cell_size_m: float, shape: tuple[int, int],
) -> None:
    rows, cols = shape
    x, y = (value / cell_size_m for value in place_m)
    if not (-0.5 <= x < cols - 0.5 and -0.5 <= y < rows - 0.5):
        raise ValueError(
            f'{what}: x_m = {place_m[0]:g}, y_m = {place_m[1]:g} is column {x:.1f}, row {y:.1f}, '
            f'outside the frame of {cols} x {rows} cells; set them to a place inside')


def _check_memory(label: str, detector: FixedLag, shape: tuple[int, int]) -> None:
    needed = detector.memory_bytes(shape)
    there = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES')
    if needed > there:
        rows, cols = shape
        raise ValueError(
            f'{label}: {detector.state_planes:,} states in each of {cols} x {rows} cells and a '
            f'lag of {detector.lag} need {needed / 2**30:.1f} GiB, and the machine has '
            f'{there / 2**30:.1f} GiB; reduce {", ".join(detector.costly)} or lag')
