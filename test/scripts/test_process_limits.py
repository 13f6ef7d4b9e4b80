# SPDX-License-Identifier: Apache-2.0
"""What scripts do about limits of their process: open files, new files, a read-only checkout."""

import resource
import subprocess
import sys

import _steps
import pytest


@pytest.mark.parametrize(('soft', 'hard', 'code'), [(24, 24, 2), (24, 4096, 0), (64, 64, 0)])
def test_too_few_open_files_are_raised_or_refused_in_one_line(checkout, ros, soft, hard, code):
    def limit():
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))

    (checkout / 'scripts' / 'script.py').write_text(
        'import resource, _environment\n_environment.ensure(())\n'
        'print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])')
    done = subprocess.run(
        [sys._base_executable, checkout / 'scripts' / 'script.py'], text=True, timeout=60,
        capture_output=True, preexec_fn=limit, env=_steps.environ() | {'PYTHONPATH': str(ros)})
    assert done.returncode == code
    assert done.stdout == ('' if code else '64\n')
    assert len(done.stderr.splitlines()) == bool(code)
    assert ('ulimit -n 64' in done.stderr) == bool(code)


@pytest.mark.parametrize(('before', 'after'), [(0o000, 0o022), (0o077, 0o077)])
def test_nobody_else_may_write_to_new_files(checkout, ros, before, after):
    (checkout / 'scripts' / 'script.py').write_text(
        'import os, _environment\n_environment.ensure(())\nprint(os.umask(0))')
    done = subprocess.run(
        [sys._base_executable, checkout / 'scripts' / 'script.py'], text=True, timeout=60,
        capture_output=True, umask=before, env=_steps.environ() | {'PYTHONPATH': str(ros)})
    assert done.stdout == f'{after}\n'


def test_read_only_checkout_is_named_with_the_remedy(checkout, require_program):
    mounted = (f'mount --bind {checkout} {checkout} && mount -o remount,ro,bind {checkout} && '
               f'exec {sys._base_executable} {checkout}/scripts/script.py')
    dropped = {'PYTHONPATH', 'ROS_DISTRO'}
    done = subprocess.run(
        [require_program('unshare'), '--map-root-user', '--mount', 'sh', '-c', mounted],
        capture_output=True, text=True, timeout=60,
        env={key: value for key, value in _steps.environ().items() if key not in dropped})
    assert (done.returncode, done.stdout) == (2, '')
    line, = done.stderr.splitlines()
    assert str(checkout / '.venv.log') in line
    assert f'git clone {checkout}' in line


def test_environment_that_is_a_link_is_named(checkout, tmp_path):
    (checkout / '.venv').symlink_to(tmp_path)
    dropped = {'PYTHONPATH', 'ROS_DISTRO'}
    done = subprocess.run(
        [sys._base_executable, checkout / 'scripts' / 'script.py'], capture_output=True, text=True,
        timeout=60, env={key: value for key, value in _steps.environ().items()
                         if key not in dropped})
    assert done.returncode == 2
    assert f'{checkout / ".venv"}: ' in done.stderr.splitlines()[-1]
    assert tmp_path.is_dir()
