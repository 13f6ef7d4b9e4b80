# SPDX-License-Identifier: Apache-2.0
"""
The environment of a run with security enforced, and the check of its SROS 2 keystore.

Every node has an enclave of its own, which has the node's full name.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
import os
from pathlib import Path
import shlex

_ENCLAVES = 'enclaves'
ENCLAVE_FILES = (
    'identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem', 'governance.p7s',
    'permissions.p7s')
# Nodes read no more of a keystore than this and their enclaves; private/ may be elsewhere.
_KEYSTORE_FILES = (
    'public/identity_ca.cert.pem', 'public/permissions_ca.cert.pem', f'{_ENCLAVES}/governance.p7s')


def secured_environment(
    keystore: Path, nodes: Iterable[str], environment: Mapping[str, str],
) -> dict[str, str]:
    """
    Return the variables that make the nodes of a run enforce security, each in its own enclave.

    Parameters
    ----------
    keystore
        A folder as ``ros2 security create_keystore`` makes it.
    nodes
        Full names of the nodes.
    environment
        Environment of the process that starts the run.

    Raises
    ------
    ValueError
        One line with the files or enclaves that the keystore lacks, and the commands that make
        them.

    """
    _check(keystore, nodes, environment.get('ROS_DOMAIN_ID') or '0')
    return {
        'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(keystore.resolve()),
        'ROS_SECURITY_ENCLAVE_OVERRIDE': ''}  # it would put all nodes into one enclave


def _check(keystore: Path, nodes: Iterable[str], domain: str) -> None:
    """Raise ValueError with the commands that make what the keystore lacks."""
    # Keystore and enclaves are for one domain: that of the environment, or 0.
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
        if (lacking := _lacking(keystore / _ENCLAVES / node.lstrip('/'), ENCLAVE_FILES))}
    if incomplete:
        wanted = ', '.join(
            node if len(lacking) == len(ENCLAVE_FILES) else f'{node} ({", ".join(lacking)})'
            for node, lacking in incomplete.items())
        commands = ' && '.join(f'{command}enclave {quoted} {node}' for node in incomplete)
        raise ValueError(f'{keystore}: lacks the enclaves {wanted}: {commands}')


def _lacking(folder: Path, names: Iterable[str]) -> list[str]:
    """Return the files that cannot be read."""
    return [name for name in names if not os.access(folder / name, os.R_OK)]
