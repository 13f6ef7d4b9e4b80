# SPDX-License-Identifier: Apache-2.0
"""A run as cron, systemd or a container starts it: no home, no terminal, any umask."""

import os

from graph_runs import own_domain
from graph_runs import start_bringup


def test_run_needs_no_home_and_leaves_nothing_that_others_may_write(tmp_path, monkeypatch):
    for name in ('HOME', 'USER', 'ROS_HOME', 'ROS_LOG_DIR', 'TERM'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    before = os.umask(0)
    try:
        run = start_bringup(
            tmp_path / 'run', '--detector', 'cdt', '--lockstep', '--frames', '5', '--record',
            str(tmp_path / 'bag'), domain_id=own_domain())
    finally:
        os.umask(before)
    with run:
        code, _, err = run.finish()
    assert (code, '\r' in err) == (0, False), err
    assert run.summary()['frames']['scored'] == 5
    written = [path for path in tmp_path.rglob('*') if not path.is_symlink()]
    assert {'cache', 'bag', 'run', 'frames.csv', 'metadata.yaml', 'evaluator.log'} <= {
        path.name for path in written}
    assert [path for path in written if path.stat().st_mode & 0o022] == []
