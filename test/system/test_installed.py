# SPDX-License-Identifier: Apache-2.0
"""What ``colcon build`` installs: commands and configuration, used outside the checkout."""

from pathlib import Path
import subprocess
import sys

from graph_runs import own_domain
import lowsnr
from lowsnr_bringup.cli.commands import COMMANDS
import pytest

ROOT = Path(__file__).resolve().parents[2]
ROS2 = [sys.executable, str(ROOT / 'scripts' / 'ros2.py')]
EVERYTHING = pytest.param('src', marks=pytest.mark.slow, id='all packages')


@pytest.fixture(scope='module', params=['src/lowsnr_bringup', EVERYTHING])
def installed(request, tmp_path_factory):
    """Return a folder outside with what colcon built beside it, and the sourced environment."""
    folder = tmp_path_factory.mktemp('workspace')
    subprocess.run(
        [sys.executable, '-m', 'colcon', '--log-base', folder / 'log', 'build', '--base-paths',
         ROOT / request.param, '--build-base', folder / 'build', '--install-base',
         folder / 'install'],
        cwd=folder, check=True, capture_output=True, timeout=300.0)
    # What is not built is taken from the checkout, after what is installed.
    shown = subprocess.check_output(
        ['bash', '-c', f'. {folder}/install/setup.bash && env -0'], timeout=240.0)
    environ = dict(line.split('=', 1) for line in shown.decode().split('\0') if line)
    outside = folder / 'outside'
    outside.mkdir()
    return outside, environ


def run(installed, *words):
    """Run a command of the installation; return what it printed."""
    folder, environ = installed
    environ = environ | {'ROS_DOMAIN_ID': str(own_domain())}
    done = subprocess.run(
        [*ROS2, 'run', 'lowsnr_bringup', *words], cwd=folder, env=environ, text=True,
        capture_output=True, timeout=240.0, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_command_runs_a_graph_outside_the_checkout(installed):
    folder, _ = installed
    out = run(installed, 'bringup', '--detector', 'cdt', '--frames', '3', '--lockstep')
    results = folder / 'results' / 'example4-cdt'
    assert out.splitlines()[-2:] == [
        'results in results/example4-cdt', 'report: results/example4-cdt/report.html']
    assert (results / 'summary.json').is_file()
    page = (results / 'report.html').read_text(encoding='utf-8')
    assert 'ros2 run lowsnr_bringup bringup --detector cdt' in page
    run(installed, 'evaluate', 'results/example4-cdt')
    assert [path.name for path in folder.iterdir()] == ['results']


def test_every_command_is_installed(installed):
    folder, _ = installed
    lib = folder.parent / 'install' / 'lowsnr_bringup' / 'lib' / 'lowsnr_bringup'
    assert {path.name for path in lib.iterdir()} == {
        *COMMANDS, 'player_node', 'recorder_node'}
    assert run(installed, 'calibrate', '--version') == f'lowsnr {lowsnr.__version__}\n'


def test_configuration_and_layouts_are_installed(installed):
    folder, _ = installed
    share = folder.parent / 'install' / 'lowsnr_bringup' / 'share' / 'lowsnr_bringup' / 'config'

    def files(root):
        return {path.relative_to(root): path.read_bytes() for path in root.rglob('*')
                if path.is_file()}

    assert files(share) == files(ROOT / 'config')
    for kind in ('.rviz', '.json', '.yaml'):
        assert [path for path in files(share) if path.suffix == kind]
    out = run(installed, 'bringup', '--list', 'scenarios')
    assert [line.split()[0] for line in out.splitlines()] == sorted(
        path.stem for path in (share / 'scenarios').iterdir())
