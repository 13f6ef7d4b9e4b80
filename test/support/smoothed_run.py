# SPDX-License-Identifier: Apache-2.0
"""A run of one object whose tables are smoothed, with a camera that stands or moves."""

from contextlib import closing
import csv

from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.scoring.run_scoring import TRUTH
from lowsnr_eval.smoothing.smoothed_table import COLUMNS
from lowsnr_eval.smoothing.smoothed_table import write_smoothed
import numpy as np
import yaml

NAN = np.nan
SECOND = 1_000_000_000
FRAMES, DENSITY, NOISE_CELLS = 12, 0.02, 0.5
STRAIGHT = {'tracker': {'motion.turn_rates_deg_s': [0.0], 'motion.acceleration_density': DENSITY}}


class Run:
    """A run of one object: its tables, and what was given to them by frame, in pixels."""

    def __init__(self, folder, binning=1, moving=False):
        self.folder, self.binning, self.moving = folder, binning, moving
        rng = np.random.default_rng(4)
        self.truth = np.cumsum(np.full((FRAMES, 2), [1.5, 0.75]), axis=0) + 20.0
        self.camera = np.cumsum(rng.normal(0.0, 2.0, (FRAMES, 2)), axis=0) * moving
        spread = NOISE_CELLS * binning
        self.detected = self.truth + spread * rng.standard_normal((FRAMES, 2)) + self.camera
        self.tracked = self.truth + 0.3 * binning * rng.standard_normal((FRAMES, 2)) + self.camera
        self.settings = RunSettings(results=str(folder), scenario='s')
        if moving:
            (folder / 'parameters.yaml').write_text(yaml.safe_dump(
                {'/conditioner': {'ros__parameters': {'binning': binning}}}))

    def write(self, skipped=(), only=None, velocity=(1.5, 0.75), maps=True, names=None):
        """Write the tables of all frames but the skipped ones."""
        with closing(RunScorer(self.settings, Evaluation(), lambda *_: None,
                               conditioned=self.moving)) as scorer:
            for k in range(FRAMES):
                if k in skipped:
                    continue
                stamp = (k + 1) * SECOND
                if self.moving and (maps is True or k in maps):
                    scorer.add_map(stamp, FrameMap(
                        'camera', (90, 90), self.binning, (0, 0), tuple(self.camera[k])))
                v = np.array(velocity)
                name = names[k] if names else '1'
                self._add(scorer, TRUTH, stamp, self.truth[k] + self.camera[k], (1.5, 0.75), 'a')
                self._add(scorer, 'detections', stamp, self.detected[k], (NAN, NAN), '')
                here = only is None or k in only
                self._add(scorer, 'tracks', stamp, self.tracked[k], v, name if here else None)
                scorer.score()
        return self.smoothed()

    def _add(self, scorer, topic, stamp, place, velocity, name):
        state = np.array([place[0], velocity[0], place[1], velocity[1]])
        side = {'tracks': 0.3, 'detections': NOISE_CELLS}.get(topic, 0.0) * self.binning
        item = Estimate(state, np.diag([side**2, 0.01, side**2, 0.01]), 0.9, name or '')
        if name:
            scorer.add_state(topic, stamp, item)
        scorer.add_array(topic, stamp, [] if name is None else [item], 0.0)

    def smoothed(self):
        """Return the rows of the table by column, and the errors."""
        summary = summarize(self.folder, self.settings, Evaluation(), 0, Account())
        self.evaluation = summary['evaluation']
        errors = write_smoothed(self.folder, summary, STRAIGHT)
        with (self.folder / 'smoothed.csv').open(newline='') as file:
            rows = list(csv.DictReader(file))
        columns = {name: np.array([float(row[name]) for row in rows])
                   for name in COLUMNS if name not in ('detector', 'id')}
        return columns | {'id': [row['id'] for row in rows]}, errors['sdt']
