# SPDX-License-Identifier: Apache-2.0
"""The plan of a run whose detectors are divided into tiles."""

from pathlib import Path

from lowsnr_bringup.plan.parts import part_of
from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def plan(**options):
    return plan_run(RunOptions(
        **{'detectors': ['sdt'], 'scenario': 'example3', 'tiles': (2, 1)} | options), CONFIG)


def test_divided_detector_has_a_node_for_each_tile_and_one_that_joins_them():
    made, whole = plan(), plan(tiles=(1, 1))
    assert [node.label for node in made.nodes] == [
        'evaluator', 'tracker', 'sdt_detector', 'sdt_1', 'sdt_2', 'sensor']
    assert [node.label for node in whole.nodes] == [
        'evaluator', 'tracker', 'sdt_detector', 'sensor']
    assert made.detectors == whole.detectors
    assert [node.label for node in made.nodes if node.merges] == ['sdt_detector']
    assert [node.label for node in made.nodes if node.tile] == ['sdt_1', 'sdt_2']
    assert made.name == whole.name


def test_tiles_have_the_parameters_of_their_detector_and_know_their_grid():
    made = plan(tiles=(2, 2), overrides=['sdt.max_iterations=8', 'evaluator.answer_within_s=40'])
    grid = {'tiles_down': 2, 'tiles_across': 2, 'tile_within_s': 20.0}
    joins = made.parameters['/sdt_detector']
    for number in range(1, 5):
        values = made.parameters[f'/sdt_{number}']
        assert values['max_iterations'] == 8
        assert {key for key in values if values[key] != joins[key]} == {'consumers'}
    assert grid.items() <= joins.items()
    assert 'tiles_down' not in plan(tiles=(1, 1)).parameters['/sdt_detector']


def test_every_publisher_waits_for_all_its_readers():
    values = plan(detectors=['cdt', 'sdt'], view=True).parameters
    assert values['/sensor']['consumers'] == 4 + 1 + 2  # tiles, evaluator, viewers
    assert values['/sdt/sdt_1']['consumers'] == 1
    assert values['/sdt/sdt_detector']['consumers'] == 3  # tracker, evaluator, viewer


def test_a_tile_runs_on_another_host_by_its_name():
    made = plan()
    part = part_of(made.nodes, made.parameters, [], ['sdt_2'])
    assert [node.label for node in part.expected] == ['sdt_2']
    alone = part_of(made.nodes, made.parameters, ['sdt_2'], [
        'evaluator', 'tracker', 'sdt', 'sdt_1', 'sensor'])
    assert alone.manager == 'bringup_sdt_2'
    across = plan(tiles=(1, 2))
    assert part_of(across.nodes, across.parameters, [], ['sdt_2']).options != part.options


@pytest.mark.parametrize(('options', 'words'), [
    ({'composed': True}, '--composed'), ({'detectors': ['hmm']}, 'hmm_detector: .*posterior'),
    ({'detectors': ['cdt', 'mmtbd2']}, 'mmtbd2.*posterior'),
    ({'overrides': ['sdt.operating_point=adaptive']}, 'sdt_detector: .*adaptive'),
    ({'overrides': ['sdt.restart=unused']}, 'restart'), ({'statistic_map': True}, 'statistic_map'),
    ({'tiles': (16, 1), 'overrides': ['all.rows=8']}, 'sdt_detector: 16 tiles')])
def test_what_cannot_be_divided_is_refused_in_one_line(options, words):
    with pytest.raises(ValueError, match=words) as caught:
        plan(**options)
    assert len(str(caught.value).splitlines()) == 1


def of_camera(**options):
    """Plan a run on a camera that sends frames as detectors take them."""
    def look(topic):
        return RecordedRun(
            name='camera', frames=0, rows=31, cols=48, period_s=0.04, truth=False, raw=False,
            encoding='32FC1')
    return plan_run(RunOptions(**{
        'detectors': ['sdt'], 'scenario': 'example3', 'camera': '/camera', 'tiles': (1, 2),
        'overrides': ['sdt.operating_point=nominal']} | options), CONFIG, look)


def test_tiles_read_the_frames_of_a_camera_and_the_node_that_joins_them_does_not():
    made = of_camera()
    assert [node.label for node in made.nodes if node.live] == ['evaluator', 'sdt_1', 'sdt_2']
    assert [node.label for node in made.nodes if 'image_raw:=/camera' in node.remaps] == [
        'evaluator', 'sdt_1', 'sdt_2']
    assert [path for path, values in made.parameters.items() if values.get('live')] == [
        '/evaluator', '/sdt_1', '/sdt_2']


def test_frames_of_a_conditioner_and_adaptive_thresholds_of_real_frames_are_refused():
    with pytest.raises(ValueError, match='sdt_detector: .*conditioner'):
        of_camera(condition='on')
    with pytest.raises(ValueError, match='sdt_detector: .*adaptive'):
        of_camera(overrides=())
