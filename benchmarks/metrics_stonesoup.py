# SPDX-License-Identifier: Apache-2.0
"""
Compare the metrics of tracks with Stone Soup's on the same tracks.

The tracks are those of crossing objects, from the library.  Stone Soup gets their paths, and for
SIAP which track is assigned to which object when, found here with loops.  Its OSPA has one frame:
it is compared with OSPA(2) over windows of one.  It needs the package ``stonesoup``, see
requirements.txt in this folder.
"""

import argparse
from collections.abc import Iterable
from collections.abc import Sequence
from dataclasses import replace
import datetime
import math

from crossing_identities import frames_of  # finds the environment, and comes first
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.track_metrics.chain_metrics import ChainMetrics
from lowsnr_eval.track_metrics.ospa2 import WindowedOspa2
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np
from stonesoup.measures import Euclidean
from stonesoup.metricgenerator.manager import MultiManager
from stonesoup.metricgenerator.ospametric import GOSPAMetric
from stonesoup.metricgenerator.ospametric import OSPAMetric
from stonesoup.metricgenerator.tracktotruthmetrics import SIAPMetrics
from stonesoup.types.association import AssociationSet
from stonesoup.types.association import TimeRangeAssociation
from stonesoup.types.groundtruth import GroundTruthPath
from stonesoup.types.groundtruth import GroundTruthState
from stonesoup.types.state import State
from stonesoup.types.time import TimeRange
from stonesoup.types.track import Track

START = datetime.datetime(2000, 1, 1)
EVALUATION = Evaluation()
NAMES = {
    'completeness': 'SIAP Completeness', 'ambiguity': 'SIAP Ambiguity',
    'spuriousness': 'SIAP Spuriousness', 'position_error_m': 'SIAP Position Accuracy',
    'track_number_changes_per_s': 'SIAP Rate of Track Number Change',
    'longest_segment': 'SIAP Longest Track Segment'}


def main() -> None:
    """Compare run by run; print the largest difference of each metric and its mean value."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().partition('\n')[0])
    parser.add_argument('--runs', type=int, default=30, help='runs of each scenario (30)')
    parser.add_argument('--seed', type=int, default=0, help='seed of the first run (0)')
    options = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {}
    for scenario in ('three_crossing', 'crossing', 'three_objects'):
        for seed in range(options.seed, options.seed + options.runs):
            frames = without_moments(list(frames_of(scenario, 'sdt', 9.0, seed)))
            one, other = ours(frames), theirs(frames)
            pairs = [pair for pair, _ in stretches(frames)]
            for name, value in one.items():
                # Stone Soup adds up all stretches of a track with an object, we take the longest.
                if name != 'longest_segment' or len(pairs) == len(set(pairs)):
                    found.setdefault(name, []).append((value, other[name]))
    print(f'{"metric":<28} {"mean":>9} {"Stone Soup":>11} {"largest difference":>19}  runs')
    for name, values in found.items():
        value, there = np.array(values).T
        print(f'{name:<28} {value.mean():>9.4f} {there.mean():>11.4f} '
              f'{abs(value - there).max():>19.2g}  {len(values)}')


def ours(frames: Sequence[TrackFrame]) -> dict[str, float]:
    """Return our metrics of a run."""
    metrics, single = ChainMetrics(EVALUATION), WindowedOspa2(EVALUATION.gospa_cutoff_m, 1)
    for frame in frames:
        metrics.add(frame)
        single.add(frame)
    figures = metrics.figures() or {}
    return {**{f'GOSPA {name}': value for name, value in figures['gospa_parts_m2'].items()},
            'OSPA': single.value or 0.0,
            **{name: figures['siap'][name] or 0.0 for name in NAMES}}


def theirs(frames: Sequence[TrackFrame]) -> dict[str, float]:
    """Return Stone Soup's metrics of a run."""
    objects, tracks = paths_of(frames)
    position = Euclidean(mapping=[0, 1])
    generators = [
        GOSPAMetric(p=2, c=EVALUATION.gospa_cutoff_m, measure=position),
        OSPAMetric(p=1, c=EVALUATION.gospa_cutoff_m, measure=position,
                   generator_name='ospa_generator'),
        SIAPMetrics(position_measure=position, velocity_measure=position)]
    manager = MultiManager(generators)
    manager.add_data({
        'groundtruth_paths': set(objects.values()), 'tracks': set(tracks.values())})
    manager.association_set = AssociationSet({
        TimeRangeAssociation(
            {objects[name], tracks[track]}, time_range=TimeRange(times[0], times[-1]))
        for (name, track), times in stretches(frames)})
    metrics = manager.generate_metrics()
    times = metrics['gospa_generator']['GOSPA Metrics'].value
    single = metrics['ospa_generator']['OSPA distances'].value
    siap = metrics['siap_generator']
    return {
        **{f'GOSPA {name}': math.fsum(each.value[name] for each in times) / len(frames)
           for name in ('localisation', 'missed', 'false')},
        # Frames without object and track are not in its list; their distance is 0.
        'OSPA': math.fsum(each.value for each in single) / len(frames),
        **{name: float(siap[title].value) for name, title in NAMES.items()}}


def paths_of(
    frames: Iterable[TrackFrame],
) -> tuple[dict[str, GroundTruthPath], dict[str, Track]]:
    """Return objects and tracks by name in Stone Soup's types."""
    objects: dict[str, GroundTruthPath] = {}
    tracks: dict[str, Track] = {}
    for frame in frames:
        for name, place in zip(frame.object_ids, frame.objects):
            objects.setdefault(name, GroundTruthPath()).append(
                GroundTruthState(place[:, None], timestamp=when(frame)))
        for name, place in zip(frame.track_ids, frame.tracks):
            tracks.setdefault(name, Track()).append(
                State(place[:, None], timestamp=when(frame)))
    return objects, tracks


def without_moments(frames: Sequence[TrackFrame]) -> list[TrackFrame]:
    """
    Return frames without the tracks that are assigned to an object for this one frame alone.

    Stone Soup has no association of a single frame.
    """
    single = {(pair[1], times[0]) for pair, times in stretches(frames) if len(times) == 1}
    kept = []
    for frame in frames:
        chosen = [n for n, name in enumerate(frame.track_ids) if (name, when(frame)) not in single]
        kept.append(replace(
            frame, track_ids=[frame.track_ids[n] for n in chosen], tracks=frame.tracks[chosen],
            existence=frame.existence[chosen]))
    return kept


def stretches(
    frames: Iterable[TrackFrame],
) -> Iterable[tuple[tuple[str, str], list[datetime.datetime]]]:
    """Yield object, track and times of each stretch of frames in which they are assigned."""
    lasting: dict[tuple[str, str], list[datetime.datetime]] = {}
    for frame in frames:
        now = set()
        for track, place in zip(frame.track_ids, frame.tracks):
            away = {name: math.dist(place, other)
                    for name, other in zip(frame.object_ids, frame.objects)}
            nearest = min(away, key=lambda name: away[name]) if away else None
            if nearest is not None and away[nearest] <= EVALUATION.gate_m:
                now.add((nearest, track))
        for pair in [pair for pair in lasting if pair not in now]:
            yield pair, lasting.pop(pair)
        for pair in now:
            lasting.setdefault(pair, []).append(when(frame))
    yield from lasting.items()


def when(frame: TrackFrame) -> datetime.datetime:
    """Return the time of a frame."""
    return START + datetime.timedelta(seconds=frame.stamp_s)


if __name__ == '__main__':
    main()
