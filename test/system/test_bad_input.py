"""What cannot be run: exit 2, one line that names culprit and mend, nothing written."""

from graph_runs import run_bringup
from keystores import empty_keystore
import pytest

SCENARIO = 'objects: [{id: a, first_frame: 1, last_frame: 9, start: {x_m: 3.0, y_m: 3.0}, legs: '


@pytest.mark.parametrize(('arguments', 'said'), [
    (['--detector', 'stt'], 'did you mean sdt?'),
    (['--scenario', 'exmaple3'], 'did you mean example3?'),
    (['--snr', 'loud'], "'loud' is not a number"),
    (['--snr', 'nan'], "'nan' is not a number"),
    (['--frames', '0'], "'0' is not a whole number of at least 1"),
    (['--set', 'sdt.max_iteration=3'], 'did you mean max_iterations?'),
    (['--set', 'sdt.max_iterations=3.5'], 'must be a whole number in [1, 64]'),
    (['--set', 'cdt.alpha=0.1'], 'cdt is not one of sdt, sensor, tracker, evaluator'),
    (['--set', 'sensor.sensor.noise_std=0'], 'must be a number in (0.0, inf)'),
    (['--lockstep', '--rate', '5'], 'not allowed with argument'),
    (['--camera', '/camera/image_raw', '--replay', 'bag'], 'not allowed with argument --camera'),
    (['--camera', '/camera/image_raw', '--lockstep'], '--lockstep: not allowed with --camera'),
    (['--camera', '/camera/image_raw', '--camera-within', '0'], "'0' is not a number above 0"),
    (['--domain-id', 'x'], "'x' is not a whole number"),
    (['--domain-id', '233'], "ROS_DOMAIN_ID = '233', must be a whole number in [0, 232]"),
])
def test_bad_option_ends_with_one_line(tmp_path, arguments, said):
    check_refused(run_bringup('--results', str(tmp_path / 'run'), *arguments), said, tmp_path)


@pytest.mark.parametrize(('text', 'said'), [
    (SCENARIO + '[{until_frame: 9, speed_mps: 3.0}]}]', 'object a leaves the frame at frame 7'),
    (SCENARIO + '[{until_frame: 9, speed: 1.0}]}]', 'did you mean speed_mps?'),
    (SCENARIO + '[{until_frame: nine}]}]', "until_frame = 'nine', must be a whole number"),
    ('frames: [', 'not YAML'),
    ('- 1', 'must be a mapping'),
])
def test_bad_scenario_file_ends_with_one_line(tmp_path, text, said):
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    done = run_bringup('--results', str(tmp_path / 'run'), '--scenario', str(path))
    check_refused(done, said, tmp_path)
    assert str(path) in done.stderr


def test_results_folder_that_cannot_be_made_ends_with_one_line(tmp_path):
    (tmp_path / 'file').touch()
    done = run_bringup('--results', str(tmp_path / 'file' / 'run'))
    check_refused(done, str(tmp_path / 'file'), tmp_path)
    assert '--results' in done.stderr


def test_folder_that_is_no_keystore_ends_with_one_line(tmp_path):
    done = run_bringup('--results', str(tmp_path / 'run'), '--secure', str(tmp_path))
    check_refused(done, f'{tmp_path}: is not a keystore', tmp_path)
    assert f'ros2 security create_keystore {tmp_path}\n' in done.stderr


def test_enclaves_that_are_lacking_end_with_one_line(tmp_path):
    keys = empty_keystore(tmp_path / 'keys', ['/bringup', '/evaluator', '/cdt/tracker', '/sensor'])
    done = run_bringup('--results', str(tmp_path / 'run'), '--detector', 'cdt', 'sdt', '--secure',
                       str(keys))
    check_refused(
        done, 'lacks the enclaves /cdt/cdt_detector, /sdt/tracker, /sdt/sdt_detector: ', tmp_path)
    for node in ('/cdt/cdt_detector', '/sdt/tracker', '/sdt/sdt_detector'):
        assert f'ros2 security create_enclave {keys} {node}' in done.stderr


def test_enclaves_that_no_middleware_takes_end_with_one_line(tmp_path):
    keys = empty_keystore(
        tmp_path / 'keys', ['/bringup', '/evaluator', '/tracker', '/cdt_detector', '/sensor'])
    done = run_bringup('--results', str(tmp_path / 'run'), '--detector', 'cdt', '--secure',
                       str(keys))
    check_refused(
        done, 'the middleware does not start a node in its enclave (/bringup: ', tmp_path)


def check_refused(done, said, folder):
    """Check status, the one line, and that no results folder was made."""
    assert done.returncode == 2
    assert done.stdout == ''
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr
    assert not (folder / 'run').exists()
