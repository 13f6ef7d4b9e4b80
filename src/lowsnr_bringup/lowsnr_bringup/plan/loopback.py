# SPDX-License-Identifier: Apache-2.0
"""Ports of the loopback address, which no other host can reach."""

from __future__ import annotations

from collections.abc import Iterable
import errno
import socket

LOOPBACK = '127.0.0.1'
FIRST_PORT, _PORTS, _LAST_PORT = 8470, 100, 65535


def listen_on(port: int) -> socket.socket:
    """
    Return a socket that listens on a port of the loopback address.

    Parameters
    ----------
    port
        Number of the port; 0 for the first free one of a hundred.

    Raises
    ------
    ValueError
        One line that names the port, if it is taken.

    """
    ports = [port] if port else range(FIRST_PORT, FIRST_PORT + _PORTS)
    for number in ports:
        try:
            return socket.create_server((LOOPBACK, number))
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
    named = f'port {port} is' if port else f'all ports from {ports[0]} to {ports[-1]} are'
    raise ValueError(
        f'{named} taken, or may not be used: --view-port sets another for the live page')


def check_ports(ports: Iterable[int]) -> None:
    """Raise ValueError, one line, if any of these ports is taken, or too large a number."""
    for port in ports:
        if port > _LAST_PORT:
            raise ValueError(f'--view-port: there is no port {port}: the last one is {_LAST_PORT}')
        listen_on(port).close()
