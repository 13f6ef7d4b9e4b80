# SPDX-License-Identifier: Apache-2.0
"""The workers of an existing dask scheduler; only a run with ``--scheduler`` imports this."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from concurrent.futures import Executor
import contextlib
from ipaddress import ip_address
import logging
import socket
import ssl
from typing import Any

import distributed
from distributed.security import Security
from lowsnr_common.settings.text import one_line
from lowsnr_eval.study.study_identity import code_digest
from lowsnr_eval.study.workers import TlsFiles
from lowsnr_eval.study.workers import Workers

# Longest wait for the first task, for which a worker may import from a slow file system [s].
_IMPORT_S = 120.0
_TIMEOUT_S = 10.0
# These have no types.
_CLIENT: Any = distributed.Client
_SECURITY: Any = Security


class SchedulerWorkers(Workers):
    """The workers of a scheduler, which itself runs the task of a dead worker again."""

    died = distributed.KilledWorker
    restarts = 0

    def __init__(self, log: Callable[[str], None], client: Any) -> None:
        super().__init__(log)
        self._client = client

    def start(self) -> Executor:
        """Return an executor on the workers of the scheduler."""
        executor: Executor = self._client.get_executor(pure=False)
        return executor

    def death(self, error: Exception) -> str:
        """Return dask's first line, which names the task and the last worker that died of it."""
        return str(error).splitlines()[0]


@contextlib.contextmanager
def connected(address: str, tls: TlsFiles | None) -> Iterator[Any]:
    """
    Yield a client of a scheduler whose workers have the same code.

    Parameters
    ----------
    address
        ``HOST:PORT``, ``tls://HOST:PORT``, or ``tcp://HOST:PORT`` of this machine.
    tls
        Certificates, with which this process and the scheduler authenticate each other.

    Raises
    ------
    ValueError
        One line, if the connection would not be authenticated, no scheduler answers at the
        address, or a worker has other code.

    """
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    address = _checked_address(address, tls)
    try:
        client = _CLIENT(address, timeout=_TIMEOUT_S, security=_security(tls))
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else 'no answer'
        raise ValueError(f'scheduler {address}: cannot be reached: {reason}') from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_TIMEOUT_S)
        except TimeoutError:
            raise ValueError(f'scheduler {address}: has no worker') from None
        _check_code(client, address)
        yield client


def _checked_address(address: str, tls: TlsFiles | None) -> str:
    """Return the whole address; refuse one at which anybody could answer, or listen."""
    scheme, _, place = address.rpartition('://')
    scheme = scheme or ('tls' if tls else 'tcp')
    if scheme not in ('tcp', 'tls'):
        raise ValueError(f'scheduler {address}: {scheme} is neither tcp nor tls')
    if scheme == 'tls' and tls is None:
        raise ValueError(f'scheduler {address}: needs --tls-ca, --tls-cert and --tls-key')
    if scheme == 'tcp' and (tls is not None or not _is_here(place)):
        raise ValueError(
            f'scheduler {address}: tcp is neither authenticated nor encrypted: start scheduler '
            'and workers with TLS, and name its files with --tls-ca, --tls-cert and --tls-key')
    return f'{scheme}://{place}'


def _is_here(place: str) -> bool:
    """Return whether ``HOST:PORT`` is on this machine alone."""
    host = place.rpartition(':')[0].strip('[]')
    try:
        found = socket.getaddrinfo(host, None)
    except (OSError, UnicodeError):
        return False
    return bool(host) and all(ip_address(item[4][0]).is_loopback for item in found)


def _security(tls: TlsFiles | None) -> Any:
    """Return dask's settings for TLS; a file that cannot be used is a ValueError that names it."""
    if tls is None:
        return None
    context, named = ssl.create_default_context(), f'--tls-ca {tls.ca}'
    try:
        context.load_verify_locations(tls.ca)
        named = f'--tls-cert {tls.cert} with --tls-key {tls.key}'
        context.load_cert_chain(tls.cert, tls.key, password='')  # or openssl would ask for one
    except (OSError, ValueError) as error:
        raise ValueError(f'{named}: cannot be used: {one_line(error)}') from None
    return _SECURITY(
        require_encryption=True, tls_ca_file=str(tls.ca), tls_client_cert=str(tls.cert),
        tls_client_key=str(tls.key))


def _check_code(client: Any, address: str) -> None:
    """Refuse workers that would give other numbers, or none."""
    try:
        # A task passes through the scheduler, which must be able to import the packages too.
        client.submit(code_digest, pure=False).result(timeout=_IMPORT_S)
        found = set(client.run(code_digest).values())
    except TimeoutError:
        raise ValueError(
            f'scheduler {address}: no worker has imported the code within {_IMPORT_S:g} s: look '
            'at the log of a worker') from None
    except (RuntimeError, ImportError):
        found = set()
    if found != {code_digest()}:
        raise ValueError(
            f'scheduler {address}: start it and its workers with this code on PYTHONPATH')
