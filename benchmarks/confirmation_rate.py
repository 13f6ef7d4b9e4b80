# SPDX-License-Identifier: Apache-2.0
"""
False tracks that are measured where a rate was asked, by recorded and by simulated frames.

``python benchmarks/confirmation_rate.py`` makes frames of a camera in three kinds of noise, lets
``lowsnr.confirm`` set the confirmation by some of them, or ``tracker.life.false_tracks`` by white
noise, and counts the tracks that are confirmed in others.
"""

import argparse
from collections.abc import Callable
from collections.abc import Iterator
from typing import Any

import lowsnr
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2

ASKED, SIDE = (0.01, 0.001), 64
Cells = Iterator[np.ndarray]


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--runs', type=int, default=3, help='pairs of sequences (3)')
    parser.add_argument('--empty', type=int, default=500, help='frames without objects (500)')
    parser.add_argument('--frames', type=int, default=1500, help='frames that are scored (1500)')
    parser.add_argument('--alarms', type=float, nargs='+', default=(0.01, 0.1),
                        help='shares of empty frames with a declaration (.01 .1)')
    parser.add_argument('--noise', nargs='+', default=list(NOISES), choices=NOISES)
    given = parser.parse_args()
    print('| noise | false alarms asked | false tracks a frame asked | recorded frames: threshold '
          '| measured | simulated frames: measured |\n|---|---|---|---|---|---|')
    for noise in given.noise:
        for alarms in given.alarms:
            for asked in ASKED:
                print(row(noise, alarms, asked, given), flush=True)


def row(noise: str, alarms: float, asked: float, given: argparse.Namespace) -> str:
    """Return the row of one noise, rate of false alarms and rate of false tracks."""
    how: dict[str, Any] = {'snr_db': 8.0, 'false_alarm_prob': alarms, 'progress': False}
    thresholds, counts = [], {'recorded': 0, 'simulated': 0}
    for run in range(given.runs):
        found = lowsnr.confirm(sequence(noise, given.empty, 2 * run), asked, **how)
        thresholds.append(found.probability)
        scored = sequence(noise, given.frames, 2 * run + 1)
        simulated: dict[str, Any] = {'settings': {'tracker.life.false_tracks': asked}, **how}
        for name, arguments in (
                ('recorded', found.arguments | {'progress': False}), ('simulated', simulated)):
            tracks = lowsnr.track(scored, **arguments).tracks
            counts[name] += len(np.unique(tracks.id))
    frames = given.runs * given.frames
    measured = (with_interval(count, frames) for count in counts.values())
    return (f'| {noise} | {alarms:g} | {asked:g} | {min(thresholds):.2f} to '
            f'{max(thresholds):.2f} | {" | ".join(measured)} |')


def with_interval(count: int, frames: int) -> str:
    """Return a rate a frame with its 95 % Poisson interval."""
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    return f'{count / frames:.4f} [{low / frames:.4f}, {high / frames:.4f}]'


def sequence(noise: str, frames: int, seed: int) -> np.ndarray:
    """Return frames (frames, SIDE, SIDE) of a camera of 16 bits."""
    rng, found = np.random.default_rng(seed), np.empty((frames, SIDE, SIDE), np.uint16)
    for k, cells in enumerate(NOISES[noise](frames, rng)):
        found[k] = np.clip(np.round(1000.0 + 20.0 * cells), 0, 65535)
    return found


def white(frames: int, rng: np.random.Generator) -> Cells:
    """Yield white noise."""
    for _ in range(frames):
        yield rng.standard_normal((SIDE, SIDE))


def student_t(frames: int, rng: np.random.Generator) -> Cells:
    """Yield noise of Student t with 4 degrees of freedom, of standard deviation one."""
    for _ in range(frames):
        yield rng.standard_t(4, (SIDE, SIDE)) / np.sqrt(2.0)


def clouds(frames: int, rng: np.random.Generator) -> Cells:
    """Yield white noise on a texture of twice its deviation that changes in 20 frames."""
    texture = np.zeros((SIDE, SIDE))
    for k in range(frames):
        new = gaussian_filter(rng.standard_normal((SIDE, SIDE)), 1.5)
        keep = 0.95 if k else 0.0
        texture = keep * texture + np.sqrt(1.0 - keep**2) * new / new.std()
        yield 2.0 * texture + rng.standard_normal((SIDE, SIDE))


NOISES: dict[str, Callable[[int, np.random.Generator], Cells]] = {
    'white': white, 'student_t': student_t, 'clouds': clouds}

if __name__ == '__main__':
    main()
