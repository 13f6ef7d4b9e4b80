"""config/tracker.yaml holds the defaults of the code."""

from pathlib import Path

from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.flat_values import flatten
from lowsnr_track.pda_mmpf import PdaMmpf
import yaml

FILE = Path(__file__).resolve().parents[2] / 'config' / 'tracker.yaml'


FILLED_IN = {'rows', 'cols', 'frames_per_detection'}


def test_file_holds_every_setting_with_its_default():
    text = FILE.read_text(encoding='utf-8')
    values = flatten(yaml.safe_load(text)['/**/tracker']['ros__parameters'])
    expected = {
        name: value for name, value in flat_values(PdaMmpf()).items()
        if not name.startswith('sensor.') and name not in FILLED_IN}
    assert values == expected
    assert all(f'# {name}: ' in text for name in FILLED_IN)
