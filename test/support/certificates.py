# SPDX-License-Identifier: Apache-2.0
"""Certificates for TLS, made with openssl."""

from pathlib import Path
import subprocess


def make_certificates(openssl: str, folder: Path) -> dict[str, Path]:
    """Make an authority, and a certificate and key that it signed; return their files by name."""
    files = {name: folder / f'{name}.pem' for name in ('ca', 'ca_key', 'cert', 'key')}
    folder.mkdir()

    def new(name: str, key: str, *more: object) -> None:
        subprocess.run(
            [openssl, 'req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256',
             '-nodes', '-subj', f'/CN={name}', '-out', files[name], '-keyout', files[key],
             '-days', '2', *map(str, more)], check=True, capture_output=True)

    new('ca', 'ca_key')
    new('cert', 'key', '-CA', files['ca'], '-CAkey', files['ca_key'], '-addext',
        'basicConstraints=critical,CA:FALSE')
    return files
