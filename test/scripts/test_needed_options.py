# SPDX-License-Identifier: Apache-2.0
"""Options that do nothing without another one are rejected, where that is not given."""

import bringup
import pytest


@pytest.mark.parametrize(('option', 'value', 'needed'), [
    ('--expect-within', '5', '--expect'), ('--camera-within', '5', '--camera'),
    ('--storage', 'mcap', '--record'), ('--view-port', '9000', '--view'),
    ('--no-browser', None, '--view'), ('--frames-topic', '/a', '--replay'),
    ('--truth-topic', '/a', '--replay'), ('--select', 'a', '--replay'),
    ('--pattern', '*', '--replay'), ('--period=2', None, '--replay'),
    ('--truth', '.', '--replay'), ('--truth-columns', 'x=a', '--truth'),
    ('--truth-from', '1', '--truth'), ('--truth-origin', '1', '--truth')])
def test_option_that_does_nothing_without_another_is_rejected(capsys, option, value, needed):
    arguments = [option, *filter(None, [value])]
    with pytest.raises(SystemExit) as end:
        bringup.parse_arguments(arguments)
    out, err = capsys.readouterr()
    named = option.partition('=')[0]
    assert (end.value.code, out, err) == (2, '', f'bringup.py: {named}: only with {needed}\n')
    other = [needed] if needed == '--view' else [needed, '.']
    also = ['--replay', '.'] if needed == '--truth' else []
    assert bringup.parse_arguments(arguments + other + also)


@pytest.mark.parametrize(('option', 'why'), [
    ('frames_topic', '--frames-topic: not allowed with --camera: --camera names the topic'),
    ('truth_topic', '--truth-topic: not allowed with --camera: a camera publishes no truth')])
def test_topic_of_a_bag_beside_a_camera_is_rejected_with_the_reason(
        monkeypatch, capsys, option, why):
    arguments = ['--camera', '/c', f'--{option.replace("_", "-")}', '/x']
    monkeypatch.setattr('sys.argv', ['bringup.py', *arguments])
    assert bringup.main() == 2
    assert why in capsys.readouterr().err


@pytest.mark.parametrize(('options', 'detectors', 'conditioner'), [
    ('--detector cdt sdt', ['cdt', 'sdt'], False),
    ('--detector cdt sdt --only evaluator', [], False),
    ('--detector cdt sdt --only cdt sdt.tracker', ['cdt'], False),
    ('--detector cdt sdt --only sdt.sdt_detector', ['sdt'], False),
    ('--detector cdt sdt --expect cdt', ['sdt'], False),
    ('--tiles 1x2 --only sdt_2', ['sdt'], False),
    ('--tiles 1x2 --expect sdt sdt_2', ['sdt'], False),
    ('--camera /a --only conditioner', [], True), ('--camera /a --only sdt', ['sdt'], False),
    ('--camera /a --expect conditioner', ['sdt'], False), ('--camera /a', ['sdt'], True)])
def test_server_of_nodes_loads_what_this_host_needs(options, detectors, conditioner):
    found = bringup.modules_of(bringup.parse_arguments(options.split()))
    assert [item[1] for item in found if len(item) > 1] == detectors
    assert (('lowsnr_sensor.conditioner_node',) in found) == conditioner
