# SPDX-License-Identifier: Apache-2.0
"""Options and configuration are checked before anything starts, and reach the right nodes."""

from contextlib import closing
from pathlib import Path
import shutil

from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.config_files import to_yaml
from lowsnr_bringup.plan.loopback import listen_on
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_track.pda_mmpf import PdaMmpf
import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'


@pytest.fixture
def config(tmp_path):
    """Return a copy of the configuration that a test can change."""
    return shutil.copytree(CONFIG, tmp_path / 'config')


def plan(folder=CONFIG, **options):
    return plan_run(RunOptions(**{'detectors': ['sdt'], 'scenario': 'example3'} | options), folder)


def test_one_chain_stands_at_the_root_consumers_first():
    nodes = [node.path for node in plan().nodes]
    assert nodes == ['/evaluator', '/tracker', '/sdt_detector', '/sensor']


@pytest.mark.parametrize(('options', 'frames'), [
    ({}, 40), ({'frames': 7}, 7), ({'loop': True}, None),
    ({'overrides': ['sensor.frames=9']}, 9), ({'overrides': ['sensor.loop=true']}, None)])
def test_run_knows_how_many_frames_are_to_come(options, frames):
    run = plan(**options)
    assert run.frames == frames
    assert run.parameters['/evaluator']['expected_frames'] == (frames or 0)
    assert run.respawn == (frames is None)


def test_several_chains_stand_in_namespaces_on_the_same_frames():
    nodes = plan(detectors=['cdt', 'sdt', 'cdt']).nodes
    assert [node.path for node in nodes] == [
        '/evaluator', '/cdt/tracker', '/cdt/cdt_detector', '/sdt/tracker', '/sdt/sdt_detector',
        '/sensor']
    assert nodes[2].remaps == nodes[4].remaps == ('image_raw:=/image_raw',)


def test_scenario_yields_to_files_and_both_to_options_and_all_to_set(config):
    def snr(*overrides, snr_db=None):
        run = plan(config, snr_db=snr_db, overrides=overrides)
        return run.parameters['/sdt_detector']['sensor.snr_db']
    assert snr() == 6.0  # of the scenario
    (config / 'evaluator.yaml').write_text('/**: {ros__parameters: {sensor: {snr_db: 4.0}}}')
    assert snr() == 4.0
    assert snr(snr_db=9.0) == 9.0
    assert snr('sdt.sensor.snr_db=7', snr_db=9.0) == 7.0


def test_files_win_over_the_size_of_a_scenario_but_not_over_its_path(config):
    (config / 'evaluator.yaml').write_text(
        '/**: {ros__parameters: {rows: 99}}\n/**/sensor: {ros__parameters: {scenario: other}}')
    run = plan(config).parameters
    assert run['/sdt_detector']['rows'] == 99  # a scenario has only a default
    assert run['/sensor']['scenario'] == str(config / 'scenarios' / 'example3.yaml')


def test_options_and_set_reach_the_nodes_that_they_name():
    values = plan(snr_db=9.0, seed=5, overrides=['sdt.sensor.snr_db=6', 'sdt.max_iterations=8'])
    assert values.parameters['/sensor']['sensor.snr_db'] == 9.0
    assert values.parameters['/sdt_detector']['sensor.snr_db'] == 6.0
    assert {own['seed'] for own in values.parameters.values()} == {5}
    assert values.detectors['/sdt_detector'].max_iterations == 8


def test_set_wins_over_the_wiring_and_over_what_other_nodes_imply():
    run = plan(overrides=[
        'tracker.consumers=5', 'tracker.frames_per_detection=2', 'sensor.patience_s=1.5'])
    assert run.parameters['/tracker']['consumers'] == 5
    assert run.parameters['/tracker']['frames_per_detection'] == 2
    assert run.parameters['/sensor']['patience_s'] == 1.5


def test_source_waits_longer_for_a_frame_than_the_evaluator():
    run = plan(overrides=['evaluator.answer_within_s=3'])
    assert run.parameters['/sensor']['patience_s'] > 3.0


@pytest.mark.parametrize('viewed', [False, True])
@pytest.mark.parametrize('detectors', [['sdt'], ['cdt', 'sdt', 'hmm']])
def test_every_node_waits_for_all_its_subscribers(detectors, viewed):
    own = plan(detectors=detectors, view=viewed).parameters
    chains, per_chain = len(detectors), 1 + viewed  # detector or tracker, viewer
    assert own['/sensor']['consumers'] == chains * per_chain + 1
    for name in detectors:
        space = f'/{name}' if chains > 1 else ''
        assert own[f'{space}/{name}_detector']['consumers'] == per_chain + 1
        assert own[f'{space}/tracker']['consumers'] == per_chain
    assert own['/evaluator']['consumers'] == 1  # the sensor


def test_tracker_gets_the_number_of_frames_that_share_a_declaration():
    values = plan(detectors=['cdt', 'sdt'], overrides=['sdt.max_iterations=8']).parameters
    assert values['/cdt/tracker']['frames_per_detection'] == 1
    assert values['/sdt/tracker']['frames_per_detection'] == 8


def test_snr_and_size_come_from_the_scenario():
    values = plan(scenario='example4').parameters['/sdt_detector']
    scenario = yaml.safe_load((CONFIG / 'scenarios' / 'example4.yaml').read_text())
    assert values['sensor.snr_db'] == scenario['snr_db']
    assert (values['rows'], values['cols']) == (20, 20)


@pytest.mark.parametrize(('name', 'text', 'words'), [
    ('detectors.yaml', '/**/sdt_detector: {ros__parameters: {max_iteration: 3}}',
     ['max_iteration ', 'max_iterations?']),
    ('detectors.yaml', '/**/sdt_detector: {ros__parameters: {radius: 1.5}}',
     ['radius = 1.5', '[0, 16]']),
    ('common.yaml', '/**: {ros__parameters: {sensor: {noise: 1.0}}}', ['sensor.noise ']),
    ('common.yaml', '/**: {ros__parameters: {sensor: {noise_std: -1.0}}}',
     ['sensor.noise_std = -1.0', '(0.0, inf)']),
    ('tracker.yaml', '/**/traker: {ros__parameters: {}}', ['/**/traker', 'sensor, ', 'tracker']),
    ('tracker.yaml', '/**/tracker: {parameters: {}}', ['/**/tracker', 'ros__parameters']),
    ('evaluator.yaml', 'a: [', ['YAML']),
    ('evaluator.yaml', '3', ['ros__parameters']),
])
def test_bad_configuration_names_file_and_key(config, name, text, words):
    (config / name).write_text(text)
    line = refusal(config)
    assert line.startswith(f'{config / name}: ')
    assert not [word for word in words if word not in line], line


def refusal(folder=CONFIG, **options):
    """Return the one line with which a run is refused."""
    with pytest.raises(ValueError) as caught:
        plan(folder, **options)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_missing_file_is_named(config):
    (config / 'tracker.yaml').unlink()
    assert refusal(config).startswith(f'{config / "tracker.yaml"}: ')


def test_settings_that_do_not_fit_each_other_name_the_node_and_the_setting():
    line = refusal(overrides=['tracker.life.delete_probability=0.99'])
    assert line.startswith('tracker: ')
    assert 'delete_' in line
    assert '0.99' in line


def bound(node, y_m):
    """Return options that bind the objects of a node for destinations in some rows."""
    same = {'probability': 0.2, 'x_m': 5.0, 'std_m': 1.0, 'earliest_frame': 20,
            'latest_frame': 20}
    lists = {'y_m': y_m} | {name: [value] * len(y_m) for name, value in same.items()}
    return [f'{node}.destinations.{name}={values}' for name, values in lists.items()]


@pytest.mark.parametrize(('options', 'words'), [
    ({'detectors': ['cdt'], 'overrides': ['cdt.lag=3']}, ['cdt.lag', ' hmm_detector']),
    ({'detectors': ['hmm'], 'overrides': ['hmm.lag=21']}, ['lag = 21', '20']),
    ({'detectors': ['hmm'], 'overrides': [
        'hmm.destination.probability=0.5', 'hmm.destination.x_m=20']},
     ['hmm_detector', 'x_m = 20', '20 x 20 cells']),
    ({'detectors': ['mmtbd2'], 'overrides': bound('mmtbd2', y_m=[5.0, -1.0])},
     ['mmtbd2_detector', 'destinations[1]', 'y_m = -1', '20 x 20 cells']),
    ({'detectors': ['hmm'], 'overrides': bound('hmm', y_m=[25.0])},
     ['hmm_detector', 'destinations[0]', 'y_m = 25', '20 x 20 cells']),
    ({'overrides': bound('tracker', y_m=[25.0])},
     ['tracker', 'destinations[0]', 'y_m = 25', '20 x 20 cells']),
    ({'overrides': [*bound('tracker', y_m=[5.0]), 'tracker.motion.acceleration_density=0.0']},
     ['tracker', 'acceleration_density = 0', 'destinations']),
    ({'detectors': ['mmtbd2'], 'overrides': ['mmtbd2.destinations.probability=[0.5]']},
     ['mmtbd2_detector', 'x_m', 'probability']),
    ({'detectors': ['pmf'], 'overrides': [
        'pmf.lag=20', 'pmf.resolution=8', 'pmf.headings=128', 'pmf.speeds=16',
        'pmf.rows=4096', 'pmf.cols=4096']},
     ['pmf_detector', ' GiB', '4096 x 4096', 'resolution', 'lag']),
    ({'detectors': ['hmm'], 'overrides': [
        *bound('hmm', y_m=[5.0]), 'hmm.destinations.earliest_frame=[1]',
        'hmm.destinations.latest_frame=[4000]', 'hmm.rows=1024', 'hmm.cols=1024']},
     ['hmm_detector', ' GiB', '1024 x 1024', 'destinations']),
    ({'condition': 'on'}, ['--condition on']),
    ({'replay': Path('bag'), 'loop': True}, ['--loop']),
    ({'record': CONFIG}, [str(CONFIG)]),
    ({'overrides': ['evaluator.operating_points=[a, b]']}, ['evaluator', 'operating_points']),
])
def test_options_that_no_run_can_have_are_refused_by_name(options, words):
    line = refusal(**options)
    assert not [word for word in words if word not in line], line


def test_all_nodes_know_the_lags_of_the_detectors():
    values = plan(detectors=['hmm', 'cdt', 'pmf'], view=True,
                  overrides=['hmm.lag=3', 'pmf.lag=2']).parameters
    assert values['/evaluator']['lags'] == [3, 0, 2]
    assert values['/sensor']['lag'] == 3
    assert [values[f'/{name}/viewer']['lag'] for name in ('hmm', 'cdt', 'pmf')] == [3, 0, 2]


def test_parameter_file_reads_back_as_it_was():
    values = plan(detectors=['cdt', 'sdt']).parameters
    tree = yaml.safe_load(to_yaml(values))
    assert set(tree) == set(values)
    for path, own in values.items():
        assert tree[path] == {'ros__parameters': {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in own.items() if value != ()}}


def test_shipped_configuration_has_the_defaults():
    # The comments call the values the defaults, so they must be.
    config = load_config(CONFIG)
    for name in DETECTORS:
        values = flat_values(detector_class(name)())
        for key, value in config[f'{name}_detector'].items():
            assert values[key] == value, (name, key)
    tracker = flat_values(PdaMmpf())
    for key, value in config['tracker'].items():
        assert tracker[key] == (list(value) if isinstance(value, tuple) else value), key


def test_port_that_no_page_can_have_is_rejected():
    with pytest.raises(ValueError, match='--view-port: .*65536'):
        plan(detectors=['cdt', 'sdt'], view=True, view_port=65535)


def test_each_chain_has_a_page_of_its_own_and_the_browser_opens_the_first():
    with closing(listen_on(0)) as free:
        port = free.getsockname()[1]
        with pytest.raises(ValueError, match=f'{port}.*--view-port'):
            plan(view=True, view_port=port)
    values = plan(detectors=['cdt', 'sdt'], view=True, view_port=port + 1).parameters
    assert [(values[f'/{name}/viewer'][key]) for name in ('cdt', 'sdt')
            for key in ('page_port', 'browser')] == [port + 1, True, port + 2, False]
    assert 'cdt' in values['/cdt/viewer']['title']
    assert not plan(view=True, browser=False).parameters['/viewer']['browser']
