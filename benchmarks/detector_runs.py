# SPDX-License-Identifier: Apache-2.0
"""What the tables of detectors share: calibrated detectors on simulated runs, and intervals."""

from collections.abc import Callable
from collections.abc import Iterable
import csv
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from dataclasses import replace
from pathlib import Path
import time
from typing import Any
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lowsnr_detect.calibration.curve import Calibration
    from lowsnr_detect.parts.detector import Detector

# Runs that are detected side by side.
BLOCK = 20
BOOTSTRAPS = 1000
# Added to the seed: noise that no calibration and no run with an object has.
_OTHER = 1_000_003


@dataclass(frozen=True)
class Method:
    """A registered detector with its settings."""

    label: str
    detector: str
    settings: dict[str, Any] = field(default_factory=dict)


def build(method: Method, sensor: Any, motion: Any) -> 'Detector':
    """Return the detector of a method, with the motion if it has a motion model."""
    from lowsnr_common.settings.flat_values import build_settings
    from lowsnr_common.settings.flat_values import flat_values
    from lowsnr_detect.parts.registry import detector_class

    cls = detector_class(method.detector)
    values = {f'sensor.{key}': value for key, value in flat_values(sensor).items()}
    if any(item.name == 'motion' for item in fields(cls)):
        values |= {f'motion.{key}': value for key, value in flat_values(motion).items()
                   if not (key == 'turn_rates_deg_s' and method.detector in ('tbd1', 'tbd2'))}
    return build_settings(cls, values | method.settings)


def matched(
    detector: 'Detector', shape: tuple[int, int], runs: int | None = None,
) -> tuple['Detector', 'Calibration']:
    """Return the detector with a declaration in 1 % of empty frames, and its calibration."""
    from lowsnr_detect.calibration.operating_point import calibrated

    options: dict[str, Any] = {} if runs is None else {'runs': runs}
    found = calibrated(detector, 0.01, shape, **options)
    return replace(detector, threshold=found.threshold), found


def empty_alarms(detector: Any, scenario: Any, runs: int, seed: int) -> Any:
    """Return the share of empty frames with a declaration in every run, (runs,)."""
    from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
    from lowsnr_detect.calibration.empty_frames import Simulation

    simulation = Simulation(runs, scenario.frames, scenario.shape, seed + _OTHER)
    return (empty_frame_peaks(detector, simulation) > detector.threshold).mean(axis=1)


def declared(
    detector: 'Detector', scenario: Any, sensor: Any, runs: int, seed: int,
    simulate: Callable[[Any, Any, int, int], tuple[Any, Any]] | None = None,
) -> tuple[Any, Any, float]:
    """
    Run a detector on simulated runs.

    Parameters
    ----------
    detector, scenario, sensor, runs, seed
        What runs on what; the frames are those of ``sensor``.
    simulate
        Returns states (K, 4), NaN where there is no object, and frames (K, rows, cols) for a
        scenario, sensor, seed and number of a run; ``simulate_run`` unless given.

    Returns
    -------
    tuple
        Positions of the object (runs, K, 2), NaN where there is none; positions of the
        declarations (runs, K, D, 2), NaN in slots that are not used; the CPU time [s].

    """
    from lowsnr_eval.study.experiment import simulate_run
    from lowsnr_eval.study.offline_chain import detect
    import numpy as np

    truths, founds, spent_s = [], [], 0.0
    for first in range(0, runs, BLOCK):
        truth, frames = map(np.stack, zip(*(
            (simulate or simulate_run)(scenario, sensor, seed, run)
            for run in range(first, min(runs, first + BLOCK)))))
        start = time.process_time()
        (answers,) = detect([detector], frames, seed, first)
        spent_s += time.process_time() - start
        truths.append(truth[..., ::2])
        founds.append(np.stack([answer.state[..., ::2] for answer in answers], axis=1))
    return np.concatenate(truths), np.concatenate(founds), spent_s


def within_gate(truth: Any, found: Any) -> Any:
    """Return whether a declaration lies within the gate of the object, (runs, K, D)."""
    from lowsnr_common.settings.node_settings import Evaluation
    import numpy as np

    return np.linalg.norm(found - truth[:, :, None], axis=-1) <= Evaluation().gate_m


def bootstrap(fractions: Any, seed: int) -> tuple[float, float]:
    """Return the 95 % interval of the mean, drawing whole runs."""
    import numpy as np

    rng = np.random.default_rng(seed)
    means = fractions[rng.integers(len(fractions), size=(BOOTSTRAPS, len(fractions)))].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def with_interval(values: Any, seed: int, digits: int) -> str:
    """Return a mean with its interval as text."""
    low, high = bootstrap(values, seed)
    return f'{values.mean():.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]'


def write_rows(
    out: Path, names: tuple[str, ...], rows: Iterable[dict[str, Any]],
    line: Callable[[dict[str, Any]], str],
) -> list[dict[str, Any]]:
    """Print each row as a line, and write it to a CSV file, as it comes; return all."""
    out.parent.mkdir(parents=True, exist_ok=True)
    written = []
    with out.open('w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        for row in rows:
            print(line(row), flush=True)
            writer.writerow(row)
            file.flush()
            written.append(row)
    print(f'written to {out}')
    return written
