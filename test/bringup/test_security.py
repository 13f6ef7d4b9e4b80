"""The keystore of a secured run: what is lacking is said, and what cannot be is not started."""

import os
import subprocess
import sys

from keystores import empty_keystore
from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.security import ENCLAVE_FILES
from lowsnr_bringup.run.security import secured_environment
from lowsnr_bringup.run.security import try_enclaves
import pytest

NODES = ['/bringup', '/sdt/tracker']
ENVIRONMENT = {
    **os.environ, 'ROS_DOMAIN_ID': '0', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF',
    'PYTHONPATH': os.pathsep.join(sys.path)}
ENFORCED = {
    **ENVIRONMENT, 'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce'}


@pytest.fixture
def keystore(tmp_path):
    """Return a folder with every file of a keystore, all of them empty."""
    return empty_keystore(tmp_path / 'my keys', NODES)


def refusal(keystore, **environment):
    """Return the line that says why a run is not secured."""
    with pytest.raises(ValueError) as caught:
        secured_environment(keystore, NODES, {**ENVIRONMENT, **environment})
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_folder_that_is_not_there_is_named_with_the_command_that_makes_it(tmp_path):
    path = tmp_path / 'none'
    assert refusal(path) == f'{path}: no such folder: ros2 security create_keystore {path}'


@pytest.mark.parametrize('name', ['public/identity_ca.cert.pem', 'enclaves/governance.p7s'])
def test_folder_that_is_no_keystore_is_refused(keystore, name):
    (keystore / name).unlink()
    assert refusal(keystore) == (
        f'{keystore}: is not a keystore, it lacks {name}: '
        f"ros2 security create_keystore '{keystore}'")


def test_missing_enclaves_are_named_with_the_commands_that_make_them(keystore):
    for name in ENCLAVE_FILES:
        (keystore / 'enclaves' / 'sdt' / 'tracker' / name).unlink()
    (keystore / 'enclaves' / 'bringup' / 'key.pem').unlink()
    create = f"ROS_DOMAIN_ID=65 ros2 security create_enclave '{keystore}'"
    assert refusal(keystore, ROS_DOMAIN_ID='65') == (
        f'{keystore}: lacks the enclaves /bringup (key.pem), /sdt/tracker: '
        f'{create} /bringup && {create} /sdt/tracker')


@pytest.mark.parametrize('name', ENCLAVE_FILES)
def test_every_file_of_an_enclave_is_needed(keystore, name):
    path = keystore / 'enclaves' / 'sdt' / 'tracker' / name
    path.unlink()
    path.symlink_to('nowhere')
    assert f'lacks the enclaves /sdt/tracker ({name}): ' in refusal(keystore)


def test_enclaves_that_no_middleware_takes_are_refused(keystore):
    said = refusal(keystore)
    assert said.startswith('--secure: the middleware does not start a node in its enclave (/bring')
    assert said.endswith('source an installed ROS 2 Jazzy, whose middleware has security, or mend '
                         'the enclave')


def test_middleware_that_takes_no_notice_of_enclaves_is_refused():
    # As one without security is: it makes every node, whatever its enclave.
    with pytest.raises(ValueError, match='lets in a node whose enclave is forged'):
        try_enclaves(NODES, {**ENVIRONMENT, 'ROS_SECURITY_ENABLE': 'false'})


@pytest.mark.parametrize('given', ['', 'none'])
def test_enforced_security_without_a_keystore_ends_in_one_line(tmp_path, given):
    environment = {**ENFORCED, 'ROS_SECURITY_KEYSTORE': str(tmp_path / given)}
    done = subprocess.run(
        [sys.executable, '-m', 'lowsnr_bringup.ros.enclave_trial', '/bringup'], env=environment,
        capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 1
    assert len(done.stdout.splitlines()) == 1
    assert done.stdout.startswith('/bringup: ')
    assert f'{tmp_path / given}' in done.stdout
    assert 'Traceback' not in done.stderr


def test_every_process_looks_for_its_own_enclave(keystore, tmp_path):
    # What it looks for is said by ROS itself, before the middleware refuses the empty files.
    parameters = tmp_path / 'parameters.yaml'
    parameters.write_text('{/evaluator: {ros__parameters: {seed: 0}}}')
    nodes = {node.path: node for node in run_nodes(['cdt', 'sdt'])}
    environment = {
        **ENFORCED, 'ROS_SECURITY_KEYSTORE': str(keystore), 'ROS_SECURITY_ENCLAVE_OVERRIDE': ''}
    with ProcessGroup(tmp_path, environment) as group:
        member = group.start(nodes['/sdt/tracker'], parameters)
        assert member.process.wait(60.0) == 1
    said = member.log.read_text()
    assert f'Found security directory: {keystore}/enclaves/sdt/tracker\n' in said
