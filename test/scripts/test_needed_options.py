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
