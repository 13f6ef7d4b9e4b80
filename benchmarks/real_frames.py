# SPDX-License-Identifier: Apache-2.0
"""
Run conditioner, detector and tracker on real sequences: as recorded, and erased.

They run in this process, or with --graph as a user runs them: each sequence becomes a bag, which
bringup.py replays in lockstep and records, and what is scored is read from that recording.

All sequences have the same settings, those of the library, with adaptive thresholds.  Erased
means that a seamless patch of background replaces the object, by its median over the frames in
scene coordinates; what is declared within 12 pixels of the object's place is not counted.  As
recorded, a declaration or a confirmed track is on the object within 5 pixels of it, and false if
no object in the file is as near.  Scored are the frames from the tenth on; hits, from the tenth
with the object on.

A sequence is an .npz file with frames (T, rows, cols), truth (T, 2) as x, y or NaN, and where
known t_s (T,), box_wh, camera_offset (T, 2), other_truth and uncatalogued_truth (n, T, 2).
"""

import argparse
from pathlib import Path
import sys
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

DATA = ROOT.parent / 'shared' / 'data'
GATE_PX, PATCH_PX, SETTLING = 5.0, 12.0, 9


def main() -> int:
    """Measure, print and draw; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/real_frames.py --detector bank --folder my_sequences')
    parser.add_argument('--folder', type=Path, default=DATA, help='folder of .npz files')
    parser.add_argument('--sequence', nargs='+', help='names without .npz; all by default')
    parser.add_argument('--detector', default='auto', help='a detector of cells (auto)')
    parser.add_argument('--prob', type=float, default=0.01, help='false-alarm share asked (0.01)')
    parser.add_argument('--snr', type=float, default=8.0, help='design SNR [dB] (8)')
    parser.add_argument('--graph', action='store_true', help='through the graph')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'real_frames')
    options = parser.parse_args()
    _environment.ensure()
    import numpy as np
    names = options.sequence or sorted(path.stem for path in options.folder.glob('*.npz'))
    if not names:
        parser.error(f'no .npz files in {options.folder}')
    options.out.mkdir(parents=True, exist_ok=True)
    print('| sequence | detections P_D / false | tracks P_D / false | first track | erased: '
          'frames with a declaration | with a track | measured | ms |\n|' + '---|' * 8)
    for name in names:
        with np.load(options.folder / f'{name}.npz') as archive:
            data = dict(archive)
        print(row(name, data, options), flush=True)
    print(f'\nasked: {options.prob:g} of the frames; pictures in {options.out}')
    return 0


def row(name: str, data: Any, options: Any) -> str:
    """Run a sequence as recorded and erased; draw it and return its row of the table."""
    start = time.perf_counter()
    from real_frames_erased import erased
    from real_frames_graph import through_graph
    follow = through_graph if options.graph else followed
    found, tracks, _ = follow(data, data['frames'], options)
    spent = 1e3 * (time.perf_counter() - start) / len(found)
    draw(options.out / f'{name}.png', data, tracks)
    kept, ghosts, measured = follow(data, erased(data), options)
    hit, false, _ = score(found, data)
    tracked, false_tracks, first = score(tracks, data)
    shares = ' | '.join(f'{share_elsewhere(each, data):.2f}' for each in (kept, ghosts))
    return (f'| {name} | {hit:.2f} / {false:.2f} | {tracked:.2f} / {false_tracks:.2f} | '
            f'{first if first >= 0 else "-"} | {shares} | {measured:.3f} | {spent:.0f} |')


def conditioned(frames: Any) -> tuple[Any, Any, Any]:
    """Return cells in scene coordinates (T, rows, cols), what gave them, and their corner."""
    from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
    import numpy as np

    settings = ConditioningSettings()
    memory, outputs = settings.init(frames[0].shape), []
    for frame in frames:
        memory, output = settings.step(memory, frame)
        outputs.append(output)
    origins = np.array([output.origin for output in outputs])
    corner = origins.min(axis=0)
    size = outputs[0].cells.shape
    scene = np.zeros((len(outputs), *(size + origins.max(axis=0) - corner)), np.float32)
    for plane, output, (top, left) in zip(scene, outputs, origins - corner):
        plane[top:top + size[0], left:left + size[1]] = output.cells
    return scene, outputs, corner


def followed(data: Any, frames: Any, options: Any) -> tuple[list[Any], list[Any], float]:
    """Return positions x, y [pixels] of detections and tracks in each frame, and the rate."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_common.core.streams import stream
    from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
    from lowsnr_detect.parts.cell_detector import resolution_of
    from lowsnr_detect.parts.registry import detector_class
    from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
    from lowsnr_track.detection_model import DetectionModel
    from lowsnr_track.pda_mmpf import PdaMmpf
    import numpy as np

    scene, outputs, corner = conditioned(frames)
    shape = scene.shape[1:]
    kind: Any = detector_class(options.detector)
    plain = kind(sensor=SensorModel(snr_db=options.snr))
    detector = AdaptiveDetector(plain, options.prob, shape)
    tracker = PdaMmpf(
        rows=shape[0], cols=shape[1], frames_per_detection=plain.frames_per_declaration,
        detection=DetectionModel(resolution=resolution_of(plain)))
    times = np.asarray(data.get('t_s', np.arange(len(frames))), float)
    stamps = 1.0 + times / np.median(np.diff(times))
    rng = stream(0, 'tracker')
    memory, state = detector.init(shape), tracker.init()
    found: list[Any] = []
    tracks: list[Any] = []
    for cells, output, stamp in zip(scene, outputs, stamps):
        if output.event == 'cut':
            memory, state = detector.init(shape), tracker.restart(state)
        memory, declared = detector.step(memory, cells, rng)
        state, answer = tracker.step(state, declared.estimates(), float(stamp), rng)
        for places, items in ((found, declared.estimates()), (tracks, answer.confirmed)):
            place = np.array([item.state[[0, 2]] for item in items]).reshape(-1, 2)
            shift = (np.array(output.origin) - corner)[::-1]
            where = ConditioningSettings().frame_map(output, '', frames[0].shape)
            places.append(where.pixels(place - shift))
    return found, tracks, detector.measured(memory)


def distances(places: Any, data: Any, k: int) -> Any:
    """Return the distances of positions from the known objects, (n, objects), first the one."""
    import numpy as np

    others = [data[key] for key in ('other_truth', 'uncatalogued_truth') if key in data]
    known = np.concatenate([data['truth'][None], *others])[:, k]
    gaps = np.linalg.norm(places[:, None] - known, axis=-1)
    return np.where(np.isfinite(gaps), gaps, np.inf)


def score(found: list[Any], data: Any) -> tuple[float, float, int]:
    """Return P_D, false ones a frame, and the frames from the appearance to the first hit."""
    import numpy as np

    present = np.isfinite(data['truth']).all(axis=1)
    appears = int(np.argmax(present))
    gaps = [distances(places, data, k) for k, places in enumerate(found)]
    hit = np.array([bool((gap[:, 0] <= GATE_PX).any()) for gap in gaps])
    false = [int(np.sum(gap.min(axis=1, initial=np.inf) > GATE_PX)) for gap in gaps]
    scored = present & (np.arange(len(found)) >= appears + SETTLING)
    first = int(np.argmax(hit)) - appears if hit.any() else -1
    return float(hit[scored].mean()), float(np.mean(false[SETTLING:])), first


def share_elsewhere(found: list[Any], data: Any) -> float:
    """Return the share of frames with a position that is not near the patch or an object."""
    import numpy as np

    return float(np.mean([
        bool((distances(places, data, k).min(axis=1, initial=np.inf) > PATCH_PX).any())
        for k, places in enumerate(found)][SETTLING:]))


def draw(path: Path, data: Any, tracks: list[Any]) -> None:
    """Draw a frame as recorded with its tracks, and the tracks over the frames."""
    from matplotlib.figure import Figure
    import numpy as np

    k = len(tracks) * 3 // 5
    figure = Figure(figsize=(11.0, 4.2), layout='constrained')
    raw, over = figure.subplots(1, 2)
    raw.imshow(data['frames'][k], cmap='gray')
    raw.plot(*data['truth'][k], 'o', mec='C1', mfc='none', ms=14)
    raw.plot(*tracks[k].T, '+', color='C0', ms=9)
    raw.set_title(f'frame {k + 1}: object (ring) and tracks [pixels]')
    for axis, mark, style in ((0, 'x', '-'), (1, '+', '--')):
        name, frames = 'xy'[axis], np.arange(1, len(tracks) + 1)
        over.plot(frames, data['truth'][:, axis], style, color='C1', label=f'truth {name}')
        number = np.repeat(frames, [len(places) for places in tracks])
        over.plot(number, np.concatenate(tracks)[:, axis], mark, color='C0', ms=5,
                  label=f'tracks {name}')
    over.set(xlabel='frame', ylabel='position [pixels]', title='confirmed tracks over the frames')
    over.legend(fontsize='small')
    figure.savefig(path, dpi=110)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
