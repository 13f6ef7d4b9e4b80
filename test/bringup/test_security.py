# SPDX-License-Identifier: Apache-2.0
"""The keystore of a secured run: what it lacks is named with the commands that make it."""

import os
import sys

from keystores import empty_keystore
from lowsnr_bringup.plan.graph import run_nodes
from lowsnr_bringup.ros.bringup_node import check_security
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.security import ENCLAVE_FILES
from lowsnr_bringup.run.security import secured_environment
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
    said = refusal(path)
    assert said.startswith(f'{path}: ')
    assert said.endswith(f': ros2 security create_keystore {path}')


@pytest.mark.parametrize('name', ['public/identity_ca.cert.pem', 'enclaves/governance.p7s'])
def test_folder_that_is_no_keystore_is_refused(keystore, name):
    (keystore / name).unlink()
    said = refusal(keystore)
    assert said.startswith(f'{keystore}: ')
    assert f' {name}: ' in said
    assert said.endswith(f": ros2 security create_keystore '{keystore}'")


def test_missing_enclaves_are_named_with_the_commands_that_make_them(keystore):
    for name in ENCLAVE_FILES:
        (keystore / 'enclaves' / 'sdt' / 'tracker' / name).unlink()
    (keystore / 'enclaves' / 'bringup' / 'key.pem').unlink()
    create = f"ROS_DOMAIN_ID=65 ros2 security create_enclave '{keystore}'"
    said = refusal(keystore, ROS_DOMAIN_ID='65')
    assert said.startswith(f'{keystore}: ')
    assert ' /bringup (key.pem), /sdt/tracker: ' in said
    assert said.endswith(f': {create} /bringup && {create} /sdt/tracker')


@pytest.mark.parametrize('name', ENCLAVE_FILES)
def test_every_file_of_an_enclave_is_needed(keystore, name):
    path = keystore / 'enclaves' / 'sdt' / 'tracker' / name
    path.unlink()
    path.symlink_to('nowhere')
    assert f' /sdt/tracker ({name}): ' in refusal(keystore)


def test_complete_keystore_has_every_node_enforce_security(keystore):
    assert secured_environment(keystore, NODES, ENVIRONMENT) == {
        'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(keystore), 'ROS_SECURITY_ENCLAVE_OVERRIDE': ''}


@pytest.mark.parametrize('given', ['keystore', 'none', ''])
def test_middleware_without_security_or_with_a_wrong_enclave_is_refused_in_one_line(
        keystore, tmp_path, monkeypatch, given):
    # The empty files of the keystore are no certificates: a middleware with security rejects them.
    path = keystore if given == 'keystore' else tmp_path / given
    for name, value in {**ENFORCED, 'ROS_SECURITY_KEYSTORE': str(path)}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ValueError, match='/bringup') as caught:
        check_security()
    assert len(str(caught.value).splitlines()) == 1


def test_run_without_security_makes_its_node(monkeypatch):
    for name, value in {**ENFORCED, 'ROS_SECURITY_ENABLE': 'false'}.items():
        monkeypatch.setenv(name, value)
    check_security()


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
