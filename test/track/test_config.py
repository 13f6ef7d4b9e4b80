# SPDX-License-Identifier: Apache-2.0
"""config/tracker.yaml holds the defaults of the code."""

from dataclasses import fields
from pathlib import Path

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.flat_values import flatten
from lowsnr_track.pda_mmpf import PdaMmpf
import yaml

FILE = Path(__file__).resolve().parents[2] / 'config' / 'tracker.yaml'


FILLED_IN = {'rows', 'cols', 'frames_per_detection', 'detection.resolution'}
# Lists that are empty by default, for which a file of ROS parameters has no type.
NONE = {f'destinations.{item.name}' for item in fields(Destinations)}


def test_file_holds_every_setting_with_its_default():
    text = FILE.read_text(encoding='utf-8')
    values = flatten(yaml.safe_load(text)['/**/tracker']['ros__parameters'])
    expected = {
        name: value for name, value in flat_values(PdaMmpf()).items()
        if not name.startswith('sensor.') and name not in FILLED_IN | NONE}
    assert values == expected
    assert all(f'# {name.rpartition(".")[2]}: ' in text for name in FILLED_IN | NONE)
