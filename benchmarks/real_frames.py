"""
Run conditioner, detector and tracker on real sequences, without ROS, and draw each.

All sequences use the settings of config/, and the detector that suits their kind.  Positions are
in conditioned cells of two pixels.  A confirmed track follows the object within 2.5 cells of it,
and is false if no object in the file of the sequence is within 2.5 cells.
"""

import argparse
from dataclasses import replace
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

DATA = ROOT.parent / 'shared' / 'data'
SEQUENCES = (('lasco_c3_8dB', 'mmtbd2'), ('ir_helicopter_049', 'sdt'))
SNR_DB = 8.0
FALSE_ALARM_PROB = 0.01
GATE_CELLS = 2.5
# Frames after the object has appeared that are not scored.
SETTLING = 10


def main() -> int:
    """Measure, print and draw; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/real_frames.py --sequence lasco_c3_8dB=hmm')
    parser.add_argument(
        '--sequence', nargs='+', metavar='FILE=DETECTOR',
        default=['='.join(pair) for pair in SEQUENCES],
        help='files of the data folder without .npz, each with its detector')
    parser.add_argument('--data', type=Path, default=DATA, help='folder of the sequences')
    parser.add_argument('--seeds', type=int, default=5, help='seeds of detector and tracker (5)')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'real_frames')
    options = parser.parse_args()
    _environment.ensure()
    import numpy as np
    options.out.mkdir(parents=True, exist_ok=True)
    print('| sequence | detector | seed | followed | false |\n|---|---|---|---|---|')
    for text in options.sequence:
        name, _, detector = text.partition('=')
        with np.load(options.data / f'{name}.npz') as archive:
            data = dict(archive)
        cells = conditioned(data['frames'])
        for seed in range(options.seeds):
            tracks = tracked(detector, cells, data['t_s'], seed)
            followed, present, false = score(tracks, data)
            print(f'| {name} | {detector} | {seed} | {followed} of {present} frames | '
                  f'{false} of {len(tracks)} frames |', flush=True)
            if seed == 0:
                draw(options.out / f'{name}.png', data, cells, tracks)
    print(f'\npictures in {options.out}')
    return 0


def conditioned(frames: Any) -> Any:
    """Return the conditioned frames (T, rows, cols)."""
    from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
    import numpy as np

    settings = ConditioningSettings()
    memory, answers = settings.init(frames[0].shape), []
    for frame in frames:
        memory, output = settings.step(memory, frame)
        answers.append(output.cells.astype(float))
    return np.stack(answers)


def tracked(name: str, cells: Any, times_s: Any, seed: int) -> list[list[Any]]:
    """Return the confirmed tracks of every frame; the unit of time is the median period."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_common.core.streams import stream
    from lowsnr_detect.calibration.operating_point import calibrated
    from lowsnr_detect.parts.registry import detector_class
    from lowsnr_track.pda_mmpf import PdaMmpf
    import numpy as np

    shape = cells.shape[1:]
    cls: Any = detector_class(name)
    detector: Any = cls(sensor=SensorModel(snr_db=SNR_DB))
    found = calibrated(detector, FALSE_ALARM_PROB, shape)
    detector = replace(detector, threshold=found.threshold)
    tracker = PdaMmpf(
        rows=shape[0], cols=shape[1], frames_per_detection=detector.frames_per_declaration)
    stamps = 1.0 + times_s / np.median(np.diff(times_s))
    own, following = stream(seed, 'detector'), stream(seed, 'tracker')
    memory, state, answers = detector.init(shape), tracker.init(), []
    for frame, stamp in zip(cells, stamps):
        memory, declared = detector.step(memory, frame, own)
        state, output = tracker.step(state, declared.estimates(), float(stamp), following)
        answers.append(output.confirmed)
    return answers


def objects(data: Any) -> Any:
    """Return the known objects in cells, first the one to follow, (n, T, 2)."""
    from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
    import numpy as np

    others = [data[key] for key in ('other_truth', 'uncatalogued_truth') if key in data]
    return ConditioningSettings().cells(np.concatenate([data['truth'][None], *others]))


def score(tracks: list[list[Any]], data: Any) -> tuple[int, int, int]:
    """Return the numbers of frames with a track of the object, with it, and with a false track."""
    import numpy as np

    known = objects(data)
    present = np.isfinite(known[0]).all(axis=-1)
    scored = present & (np.arange(len(tracks)) >= np.argmax(present) + SETTLING)
    followed = false = 0
    for k, found in enumerate(tracks):
        places = np.array([item.state[[0, 2]] for item in found]).reshape(-1, 1, 2)
        near = np.linalg.norm(places - known[:, k], axis=-1) <= GATE_CELLS
        followed += bool(scored[k] and near[:, 0].any())
        false += bool((~near.any(axis=1)).any())
    return followed, int(scored.sum()), false


def draw(path: Path, data: Any, cells: Any, tracks: list[list[Any]]) -> None:
    """Draw a frame, recorded and conditioned, and the tracks over the frames."""
    from matplotlib.figure import Figure
    import numpy as np

    known, k = objects(data), len(tracks) * 3 // 5
    figure = Figure(figsize=(13.0, 4.2), layout='constrained')
    raw, clean, over = figure.subplots(1, 3)
    raw.imshow(data['frames'][k], cmap='gray')
    raw.set_title(f'frame {k + 1} as recorded')
    clean.imshow(cells[k], cmap='gray', vmin=-4.0, vmax=4.0)
    clean.set_title('conditioned, with object and tracks')
    clean.plot(*known[0, k], 'o', mec='C1', mfc='none', ms=14)
    for item in tracks[k]:
        clean.plot(item.state[0], item.state[2], '+', color='C0', ms=9)
    for axis, name, style in ((0, 'x', '-'), (1, 'y', '--')):
        over.plot(np.arange(1, len(tracks) + 1), known[0, :, axis], style, color='C1',
                  label=f'truth {name}')
        for on, colour, label in ((False, '0.8', 'others'), (True, 'C0', 'on the object')):
            points = [(n, item.state[2 * axis]) for n, found in enumerate(tracks, 1)
                      for item in found if on == is_near(item, known[0, n - 1])]
            if points:
                over.plot(*zip(*points), 'x+'[axis], color=colour, ms=5, label=f'{name}, {label}')
    over.set(xlabel='frame', ylabel='position [cells]', title='confirmed tracks over the frames')
    over.legend(fontsize='small')
    figure.savefig(path, dpi=110)


def is_near(item: Any, place: Any) -> bool:
    """Return whether a track is within the gate of a position in cells."""
    return bool(abs(complex(item.state[0] - place[0], item.state[2] - place[1])) <= GATE_CELLS)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
