# SPDX-License-Identifier: Apache-2.0
"""A dask scheduler and its workers on this machine, started by hand, as a user would."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import socket
import subprocess
import sys
import time

SOURCES = os.pathsep.join(map(str, sorted(
    (Path(__file__).resolve().parents[2] / 'src').glob('lowsnr*'))))


@contextmanager
def dask_cluster(
    folder: Path, count: int, tls: dict[str, Path] | None = None, path: str = SOURCES,
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """
    Start a scheduler and so many workers, with TLS if files are given; end them.

    Yields
    ------
    str
        Address of the scheduler, HOST:PORT.
    list
        The processes of the workers.

    """
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        address = f'127.0.0.1:{probe.getsockname()[1]}'
    protocol = 'tls' if tls else 'tcp'
    common = ['--protocol', protocol, '--host', f'{protocol}://127.0.0.1', '--no-dashboard']
    if tls:
        common += ['--tls-ca-file', tls['ca'], '--tls-cert', tls['cert'], '--tls-key', tls['key']]
    commands = [['scheduler', '--port', address.partition(':')[2], *common]]
    commands += [['worker', f'{protocol}://{address}', '--nthreads', '1', '--no-nanny',
                  '--local-directory', folder, *common]] * count
    processes = []
    try:
        for command in commands:
            processes.append(subprocess.Popen(
                [sys.executable, '-m', 'dask', *map(str, command)], stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, env=os.environ | {'PYTHONPATH': path}))
        wait_for_port(int(address.partition(':')[2]), processes[0])
        yield address, processes[1:]
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


def wait_for_port(port: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until a process listens on a port of this machine."""
    while True:
        assert process.poll() is None
        try:
            socket.create_connection(('127.0.0.1', port), timeout=1.0).close()
            return
        except OSError:
            time.sleep(0.1)
