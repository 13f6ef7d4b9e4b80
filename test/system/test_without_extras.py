# SPDX-License-Identifier: Apache-2.0
"""A run of simulated frames imports no package that only other commands need."""

import _environment
import _venv
from graph_runs import own_domain
from graph_runs import start_bringup

MODULES = {'opencv-python-headless': 'cv2'}


def test_run_needs_no_extra(tmp_path, monkeypatch):
    folder = tmp_path / 'absent'
    folder.mkdir()
    for package in _venv.asked_of(_environment.EXTRAS):
        name = MODULES.get(package, package)
        (folder / f'{name}.py').write_text(f'raise ModuleNotFoundError("{name} is an extra")')
    monkeypatch.setenv('PYTHONPATH', str(folder))
    with start_bringup(tmp_path / 'run', '--detector', 'cdt', '--frames', '3', '--lockstep',
                       domain_id=own_domain()) as run:
        code, out, err = run.finish()
    assert code == 0, err
    assert out.splitlines()[-1].startswith('report: ')
