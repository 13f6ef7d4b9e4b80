# SPDX-License-Identifier: Apache-2.0
"""What no script reads, a pipe or a device, is refused before it blocks."""

import os

import bringup
import convert
import evaluate
import pytest


@pytest.mark.parametrize(('script', 'arguments'), [
    (bringup, ['--replay', 'PLACE']), (bringup, ['--replay', '.', '--truth', 'PLACE']),
    (convert, ['PLACE', '--out', 'bag']), (evaluate, ['PLACE'])])
@pytest.mark.parametrize('name', ['pipe.npz', '/dev/zero'])
def test_pipes_and_devices_are_refused_by_name(tmp_path, capsys, script, arguments, name):
    place = tmp_path / name
    if name == 'pipe.npz':
        os.mkfifo(place)
    with pytest.raises(SystemExit) as end:
        script.parse_arguments([str(place) if item == 'PLACE' else item for item in arguments])
    assert end.value.code == 2
    line, = capsys.readouterr().err.splitlines()
    assert str(place) in line


def test_files_and_folders_are_taken(tmp_path):
    (tmp_path / 'bag').touch()
    for place in (tmp_path, tmp_path / 'bag'):
        assert evaluate.parse_arguments([str(place)]).bag == place
