"""
The keystore of SROS 2 that a secured run rests on: checked and tried before anything starts.

Every node has an enclave of its own, which bears the node's full name.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
import os
from pathlib import Path
import shlex
import subprocess
import sys
from tempfile import TemporaryDirectory

ENCLAVES = 'enclaves'
ENCLAVE_FILES = (
    'identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem', 'governance.p7s',
    'permissions.p7s')
# Who starts nodes needs no more of a keystore: private/ may well stay elsewhere.
_KEYSTORE_FILES = (
    'public/identity_ca.cert.pem', 'public/permissions_ca.cert.pem', f'{ENCLAVES}/governance.p7s')
_MEND = 'source an installed ROS 2 Jazzy, whose middleware has security'
_ANSWERS_WITHIN_S = 120.0


def secured_environment(
    keystore: Path, nodes: Iterable[str], environment: Mapping[str, str],
) -> dict[str, str]:
    """
    Return what has the processes of a run enforce security, each in its own enclave.

    Parameters
    ----------
    keystore
        A folder as ``ros2 security create_keystore`` makes it.
    nodes
        Full names of the nodes.
    environment
        Environment of the starter.

    Raises
    ------
    ValueError
        One line: what the keystore lacks and the commands that make it, or why the middleware
        does not start a node in its enclave.

    """
    nodes = list(nodes)
    _check(keystore, nodes, environment.get('ROS_DOMAIN_ID') or '0')
    added = {
        'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(keystore.resolve()),
        'ROS_SECURITY_ENCLAVE_OVERRIDE': ''}  # it would put all nodes into one enclave
    try_enclaves(nodes, {**environment, **added})
    return added


def _check(keystore: Path, nodes: Iterable[str], domain: str) -> None:
    """Raise ValueError with the commands that make what the keystore lacks."""
    # Both are made for one domain: that of the environment, or 0.
    command = f'ROS_DOMAIN_ID={domain} ' * (domain != '0') + 'ros2 security create_'
    quoted = shlex.quote(str(keystore))
    if not os.path.isdir(keystore):  # unlike Path.is_dir it takes a name of any length
        raise ValueError(f'{keystore}: no such folder: {command}keystore {quoted}')
    if lacking := _lacking(keystore, _KEYSTORE_FILES):
        raise ValueError(
            f'{keystore}: is not a keystore, it lacks {", ".join(lacking)}: '
            f'{command}keystore {quoted}')
    incomplete = {
        node: lacking for node in nodes
        if (lacking := _lacking(keystore / ENCLAVES / node.lstrip('/'), ENCLAVE_FILES))}
    if incomplete:
        wanted = ', '.join(
            node if len(lacking) == len(ENCLAVE_FILES) else f'{node} ({", ".join(lacking)})'
            for node, lacking in incomplete.items())
        commands = ' && '.join(f'{command}enclave {quoted} {node}' for node in incomplete)
        raise ValueError(f'{keystore}: lacks the enclaves {wanted}: {commands}')


def _lacking(folder: Path, names: Iterable[str]) -> list[str]:
    return [name for name in names if not os.access(folder / name, os.R_OK)]


def try_enclaves(nodes: Iterable[str], environment: Mapping[str, str]) -> None:
    """
    Have a process of its own make the nodes, each in its enclave, and one in a forged enclave.

    Parameters
    ----------
    nodes
        Full names of the nodes.
    environment
        Environment of the process; says which keystore.

    Raises
    ------
    ValueError
        One line that says why a node was not made, or that the forged enclave was as good.

    """
    if why := _refusal(nodes, environment):
        raise ValueError(
            f'--secure: the middleware does not start a node in its enclave ({why}): {_MEND}, '
            'or mend the enclave')
    with TemporaryDirectory() as forged:
        enclave = Path(forged, ENCLAVES, 'forged')
        enclave.mkdir(parents=True)
        for name in ENCLAVE_FILES:
            (enclave / name).touch()
        if not _refusal(['/forged'], {**environment, 'ROS_SECURITY_KEYSTORE': forged}):
            raise ValueError(
                f'--secure: the middleware lets in a node whose enclave is forged: {_MEND}')


def _refusal(nodes: Iterable[str], environment: Mapping[str, str]) -> str:
    """Return why a node was not made; nothing where all were."""
    command = [sys.executable, '-m', 'lowsnr_bringup.ros.enclave_trial', *nodes]
    try:
        done = subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            errors='replace', timeout=_ANSWERS_WITHIN_S, check=False)
    except subprocess.TimeoutExpired:
        return f'no answer within {_ANSWERS_WITHIN_S:g} s'
    if not done.returncode:
        return ''
    said = done.stdout.strip() or done.stderr.strip() or f'status {done.returncode}'
    return said.splitlines()[-1]
