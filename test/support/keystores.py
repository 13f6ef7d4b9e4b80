# SPDX-License-Identifier: Apache-2.0
"""Keystores of SROS 2 as far as their files go: with nothing in them, no middleware takes them."""

from lowsnr_bringup.run.security import ENCLAVE_FILES

SHARED = (
    'public/identity_ca.cert.pem', 'public/permissions_ca.cert.pem', 'enclaves/governance.p7s')


def empty_keystore(root, nodes):
    """Make every file of a keystore with enclaves for these nodes, all of them empty."""
    enclaves = [f'enclaves{node}/{name}' for node in nodes for name in ENCLAVE_FILES]
    for name in [*SHARED, *enclaves]:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root
