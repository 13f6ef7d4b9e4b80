# SPDX-License-Identifier: Apache-2.0
"""What the user should know before a run starts, one line each."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.graph import Values
from lowsnr_bringup.plan.sources import MATCHED
from lowsnr_bringup.plan.sources import Source
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.calibration.operating_point import known_curve
from lowsnr_detect.parts.detector import Detector
from lowsnr_track.pda_mmpf import PdaMmpf

_ROUNDING = 1.001


def start_at_once(
    source: Source, detectors: Mapping[str, Detector], parameters: Mapping[str, Values],
    overrides: graph.Layer,
) -> tuple[str, ...]:
    """
    Make matched detectors of a camera nominal if they would have to be calibrated first.

    A camera waits for no simulation, unless ``--set`` asks for it.  Return a line for each.
    """
    notes = []
    for path, detector in detectors.items() if source.camera else ():
        values, node = parameters[path], path.rpartition('/')[2]
        shape = (values['rows'], values['cols'])
        if (values.get('operating_point', MATCHED) == MATCHED
                and 'operating_point' not in overrides.get(node, ())
                and known_curve(detector, shape) is None):
            values['operating_point'] = 'nominal'
            name = node.removesuffix('_detector')
            notes.append(
                f'{name} is not calibrated for frames of {shape[1]} x {shape[0]} cells: it starts '
                'with its nominal threshold, whose false-alarm rate is not known: --detector auto '
                f'needs no calibration; python scripts/calibrate.py --detector {name} --snr '
                f'{detector.sensor.snr_db:g} --rows {shape[0]} --cols {shape[1]} makes one for '
                'later starts')
    return tuple(notes)


def too_fast(
    source: Source, detectors: Mapping[str, Detector], nodes: Sequence[graph.Node],
    parameters: Mapping[str, Values],
) -> tuple[str, ...]:
    """Return a line if objects of the scenario are faster than models of motion allow."""
    models: dict[str, MotionModes] = {
        node.label: graph.build(PdaMmpf, parameters[node.path], node.label).motion
        for node in nodes if node.name == 'tracker'} | {
        path.rpartition('/')[2].removesuffix('_detector'): detector.motion
        for path, detector in detectors.items()
        if hasattr(detector, 'motion') and getattr(detector, 'move_prior', True)}
    slower = {name: motion.max_speed_mps for name, motion in models.items()
              if source.fastest_mps > _ROUNDING * motion.max_speed_mps}
    if not slower:
        return ()
    limits = ', '.join(f'{name} {limit:g}' for name, limit in slower.items())
    return (f'{source.name}: an object moves at up to {source.fastest_mps:.3g} m/s, more than '
            f'motion.max_speed_mps ({limits}): --set tracker.motion.max_speed_mps='
            f'{source.fastest_mps:.3g} raises that of the tracker',)


def blurred(detectors: Mapping[str, Detector]) -> tuple[str, ...]:
    """Return a line with the SNR of the brightest cell where objects are blurred."""
    sensors = dict.fromkeys(detector.sensor for detector in detectors.values())
    return tuple(
        f'SNR {sensor.snr_db:g} dB is that of the energy of a blurred object; in the middle of a '
        f'cell its brightest cell has {sensor.peak_snr_db:.1f} dB'
        for sensor in sensors if sensor.blur_m > 0.0)
