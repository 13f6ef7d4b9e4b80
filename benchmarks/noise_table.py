# SPDX-License-Identifier: Apache-2.0
"""
Table of detectors in other noise than Gaussian, and for blurred and fluctuating objects.

Every row has frames of one sensor.  Detectors get the likelihood of that sensor, and that of
Gaussian noise, a point and a constant intensity; both are calibrated to 1 % of the empty frames
of that sensor.  In the row ``empirical`` they are so for what was learned from Student t noise,
and the frames have that noise itself.  ``transferred`` is the share of empty frames in which the
second declares with the threshold for Gaussian noise.  Scenario, scored frames and intervals are
those of detector_table.py.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from dataclasses import replace
import functools
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'benchmarks')]

import _environment  # noqa: E402
from detector_runs import build  # noqa: E402
from detector_runs import empty_alarms  # noqa: E402
from detector_runs import with_interval  # noqa: E402
from detector_table import METHODS  # noqa: E402
from detector_table import run_scores  # noqa: E402

SENSORS: dict[str, dict[str, Any]] = {
    'gaussian': {},
    'student_t': {'noise.model': 'student_t'},
    'rayleigh': {'noise.model': 'rayleigh'},
    'k': {'noise.model': 'k'},
    'poisson': {'noise.model': 'poisson'},
    'empirical': {'noise.model': 'empirical'},
    'swerling1': {'fluctuation': 'swerling1'},
    'swerling2': {'fluctuation': 'swerling2'},
    'swerling4': {'fluctuation': 'swerling4'},
    'unknown': {'fluctuation': 'unknown'},
    'blur': {'blur_m': 0.7},
    'k swerling2': {'noise.model': 'k', 'fluctuation': 'swerling2'},
}
LABELS = ('sdt s_m=8', 'cusum', 'hmm order 1', 'hmm order 2')


def main() -> int:
    """Measure and print the table as Markdown; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/noise_table.py --runs 300 --sensor student_t poisson')
    parser.add_argument('--runs', type=int, default=300, help='runs with an object (300)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--snr', type=float, default=6.0, metavar='DB', help='SNR (6)')
    parser.add_argument('--sensor', nargs='+', choices=SENSORS, default=list(SENSORS))
    parser.add_argument(
        '--method', nargs='+', default=LABELS, choices=[m.label for m in METHODS])
    parser.add_argument('--processes', type=int, default=1, help='processes (1)')
    options = parser.parse_args()
    _environment.ensure()
    tasks = [(sensor, label, options.snr, options.runs, options.seed)
             for sensor in options.sensor for label in options.method]
    print(f'{options.snr:g} dB, {options.runs} runs, seed {options.seed}\n\n'
          '| sensor | detector | P_D [95 %] | empty frames [95 %] | P_D, Gaussian likelihood '
          '[95 %] | difference [95 %] | transferred |\n|---|---|---|---|---|---|---|', flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        for row in pool.map(measure, *zip(*tasks)):
            print(row, flush=True)
    return 0


def measure(name: str, label: str, snr_db: float, runs: int, seed: int) -> str:
    """Return a row of the table."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_common.noise.settings import Noise
    from lowsnr_common.settings.flat_values import build_settings
    from lowsnr_sensor.scenario import load_scenario

    values = dict(SENSORS[name])
    if name == 'empirical':
        values['noise.quantiles'] = learned()
    known = build_settings(SensorModel, {'snr_db': snr_db, **values})
    actual = replace(known, noise=Noise(model='student_t')) if name == 'empirical' else known
    plain = replace(SensorModel(), snr_db=snr_db)
    scenario = load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml')
    method = next(method for method in METHODS if method.label == label)
    frames = Frames(known, actual, scenario, runs, seed)
    hits, alarms, _ = scored(method, known, frames)
    other, _, transferred = scored(method, plain, frames)
    cells = [with_interval(each, seed, 4) for each in (hits, alarms, other, hits - other)]
    return f'| {name} | {label} | {" | ".join(cells)} | {transferred:.3f} |'


@dataclass(frozen=True)
class Frames:
    """Frames of a ``known`` sensor for the calibration, of the ``actual`` one to detect in."""

    known: Any
    actual: Any
    scenario: Any
    runs: int
    seed: int


def scored(method: Any, design: Any, frames: Frames) -> tuple[Any, Any, float]:
    """
    Calibrate a detector of one likelihood on the noise that is known of a sensor.

    Return the fractions of hits and of empty frames with a declaration in every run, and that of
    empty frames with the threshold for the noise of the likelihood.
    """
    from lowsnr_detect.calibration.operating_point import calibrate

    scenario, runs, seed = frames.scenario, frames.runs, frames.seed
    own = build(method, design, scenario.objects[0].random)
    calibrated = replace(own, sensor=mismatched(design, frames.known))
    at = [calibrate(each, 0.01, scenario.shape).threshold for each in (calibrated, own)]
    detectors = [replace(own, sensor=mismatched(design, frames.actual), threshold=one)
                 for one in at]
    alarms, transferred = (empty_alarms(each, scenario, runs, seed) for each in detectors)
    scores, _ = run_scores(detectors[0], scenario, frames.actual, runs, seed)
    return scores[:, 0], alarms, float(transferred.mean())


def mismatched(design: Any, actual: Any) -> Any:
    """Return a sensor model with the likelihood of one sensor and the noise of another."""
    from lowsnr_common.core.measurement import SensorModel

    @dataclass(frozen=True, kw_only=True)
    class Mismatched(SensorModel):

        def draw_noise(self, shape: tuple[int, ...], rng: Any) -> Any:
            """Return frames without an object."""
            return actual.draw_noise(shape, rng)

    return Mismatched(**{name: getattr(design, name) for name in SensorModel.__dataclass_fields__})


@functools.cache
def learned() -> list[float]:
    """Return quantiles learned from 2500 frames of Student t noise."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_common.noise.empirical import learned_quantiles
    from lowsnr_common.noise.settings import Noise
    import numpy as np

    sensor = SensorModel(noise=Noise(model='student_t'))
    return list(learned_quantiles(
        sensor.draw_noise((2500, 20, 20), np.random.default_rng(7))))


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
