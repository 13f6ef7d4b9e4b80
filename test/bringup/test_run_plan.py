"""The configuration is checked whole before anything starts, and reaches the right nodes."""

from pathlib import Path
import shutil

from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.graph import to_yaml
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_common.settings.config import flat_values
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_track.pda_mmpf import PdaMmpf
import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'


@pytest.fixture
def config(tmp_path):
    """Return a copy of the configuration that a test may spoil."""
    return shutil.copytree(CONFIG, tmp_path / 'config')


def plan(folder=CONFIG, **options):
    return plan_run(RunOptions(**{'detectors': ['sdt'], 'scenario': 'example3'} | options), folder)


def test_one_chain_stands_at_the_root_consumers_first():
    nodes = [node.path for node in plan().nodes]
    assert nodes == ['/evaluator', '/tracker', '/sdt_detector', '/sensor']


def test_several_chains_stand_in_namespaces_on_the_same_frames():
    nodes = plan(detectors=['cdt', 'sdt', 'cdt']).nodes
    assert [node.path for node in nodes] == [
        '/evaluator', '/cdt/tracker', '/cdt/cdt_detector', '/sdt/tracker', '/sdt/sdt_detector',
        '/sensor']
    assert nodes[2].remaps == nodes[4].remaps == ('image_raw:=/image_raw',)


def test_later_layers_win():
    values = plan(snr_db=9.0, seed=5, overrides=['sdt.sensor.snr_db=6', 'sdt.max_iterations=8'])
    assert values.parameters['/sensor']['sensor.snr_db'] == 9.0
    assert values.parameters['/sdt_detector']['sensor.snr_db'] == 6.0
    assert {own['seed'] for own in values.parameters.values()} == {5}
    assert values.detectors['/sdt_detector'].max_iterations == 8


def test_tracker_knows_how_many_frames_a_declaration_rests_on():
    values = plan(detectors=['cdt', 'sdt'], overrides=['sdt.max_iterations=8']).parameters
    assert values['/cdt/tracker']['frames_per_detection'] == 1
    assert values['/sdt/tracker']['frames_per_detection'] == 8


def test_snr_and_size_come_from_the_scenario():
    values = plan(scenario='example4').parameters['/sdt_detector']
    scenario = yaml.safe_load((CONFIG / 'scenarios' / 'example4.yaml').read_text())
    assert values['sensor.snr_db'] == scenario['snr_db']
    assert (values['rows'], values['cols']) == (20, 20)


@pytest.mark.parametrize(('name', 'text', 'said'), [
    ('detectors.yaml', '/**/sdt_detector: {ros__parameters: {max_iteration: 3}}',
     'max_iteration is not a parameter of this node; did you mean max_iterations?'),
    ('detectors.yaml', '/**/sdt_detector: {ros__parameters: {radius: 1.5}}',
     r'radius = 1.5, must be a whole number in \[0, 16\]'),
    ('common.yaml', '/**: {ros__parameters: {sensor: {noise: 1.0}}}',
     'sensor.noise is not a parameter'),
    ('common.yaml', '/**: {ros__parameters: {sensor: {noise_std: -1.0}}}',
     r'sensor.noise_std = -1.0, must be a number in \(0.0, inf\)'),
    ('tracker.yaml', '/**/traker: {ros__parameters: {}}', 'NODE one of sensor, '),
    ('tracker.yaml', '/**/tracker: {parameters: {}}', 'must hold ros__parameters'),
    ('evaluator.yaml', 'a: [', 'not YAML'),
    ('evaluator.yaml', '3', 'must be a mapping'),
])
def test_bad_configuration_names_file_and_key(config, name, text, said):
    (config / name).write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        plan(config)
    assert str(config / name) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_missing_file_is_named(config):
    (config / 'tracker.yaml').unlink()
    with pytest.raises(ValueError, match='tracker.yaml: cannot be read'):
        plan(config)


def test_settings_that_do_not_fit_each_other_name_the_node():
    with pytest.raises(ValueError, match='tracker: .*must not fall'):
        plan(overrides=['tracker.life.delete_probability=0.99'])


def test_detector_that_answers_late_is_refused():
    with pytest.raises(ValueError, match='lag = 3, must be 0 in a graph'):
        plan(detectors=['hmm'], overrides=['hmm.lag=3'])


def test_parameter_file_reads_back_as_it_was():
    values = plan(detectors=['cdt', 'sdt']).parameters
    tree = yaml.safe_load(to_yaml(values))
    assert set(tree) == set(values)
    for path, own in values.items():
        assert tree[path] == {'ros__parameters': {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in own.items() if value != ()}}


def test_shipped_configuration_says_the_defaults():
    # The comments call the values the defaults, so they must be.
    config = load_config(CONFIG)
    for name in DETECTORS:
        values = flat_values(detector_class(name)())
        for key, value in config[f'{name}_detector'].items():
            assert values[key] == value, (name, key)
    tracker = flat_values(PdaMmpf())
    for key, value in config['tracker'].items():
        assert tracker[key] == (list(value) if isinstance(value, tuple) else value), key
