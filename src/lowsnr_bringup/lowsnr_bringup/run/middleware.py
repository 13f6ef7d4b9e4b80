# SPDX-License-Identifier: Apache-2.0
"""The middleware of a run: its transport, discovery and memory, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
import fcntl
from pathlib import Path
import re
import socket
import time

from lowsnr_common.images.receive_buffer import WANTED_BYTES

PROFILE_FILE = 'fastdds.xml'
# Fast DDS 2 (Jazzy) and later versions read different variables.
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
# ROS otherwise overrides what the profile says of data sharing and of memory.
_FROM_PROFILE = {'RMW_FASTRTPS_USE_QOS_FROM_XML': '1'}
_RANGE, _PEERS, _ONLY_HERE = (
    'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')
# With this range ROS adds nothing to the profile; with LOCALHOST it adds shared memory.
_AS_IN_PROFILE = {_RANGE: 'SYSTEM_DEFAULT', _PEERS: '', _ONLY_HERE: ''}
# Of Fast DDS in shared memory; the process that made a segment holds the lock of its lock file.
_SEGMENTS, _LOCK = Path('/dev/shm'), re.compile(r'fastrtps_[0-9a-f]{16}_el')
# A process makes the lock file first and locks it a moment later.
_STARTING_S = 10.0
_PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>lowsnr</transport_id>
      <type>UDPv4</type>
      <receiveBufferSize>{buffer}</receiveBufferSize>
      <maxInitialPeersRange>32</maxInitialPeersRange>
{interfaces}    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="lowsnr" is_default_profile="true">
    <rtps>
      <userTransports>
        <transport_id>lowsnr</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
      <builtin>
        <discovery_config>
          <leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>
          <initialAnnouncements>
            <count>50</count>
            <period><nanosec>100000000</nanosec></period>
          </initialAnnouncements>
        </discovery_config>
{locators}        <readerHistoryMemoryPolicy>PREALLOCATED_WITH_REALLOC</readerHistoryMemoryPolicy>
        <writerHistoryMemoryPolicy>PREALLOCATED_WITH_REALLOC</writerHistoryMemoryPolicy>
      </builtin>
    </rtps>
  </participant>
  <data_writer profile_name="lowsnr" is_default_profile="true">
    <qos><data_sharing><kind>OFF</kind></data_sharing></qos>
    <times>
      <heartbeatPeriod><sec>0</sec><nanosec>20000000</nanosec></heartbeatPeriod>
    </times>
    <historyMemoryPolicy>DYNAMIC</historyMemoryPolicy>
  </data_writer>
  <data_reader profile_name="lowsnr" is_default_profile="true">
    <qos><data_sharing><kind>OFF</kind></data_sharing></qos>
    <historyMemoryPolicy>DYNAMIC</historyMemoryPolicy>
  </data_reader>
</profiles>
"""
_LOOPBACK = """\
      <interfaceWhiteList>
        <address>127.0.0.1</address>
      </interfaceWhiteList>
"""
# An unspecified unicast locator keeps Fast DDS from listening to its multicast address.
_UNICAST = """\
        <metatrafficUnicastLocatorList>
          <locator/>
        </metatrafficUnicastLocatorList>
        <initialPeersList>
{peers}        </initialPeersList>
"""
_PEER = """\
          <locator><udpv4><address>{address}</address></udpv4></locator>
"""


def middleware_environment(
    environment: Mapping[str, str], folder: Path, implementation: str,
) -> dict[str, str]:
    """
    Write the Fast DDS profile of a run; return the variables that its processes need.

    Nothing changes for another middleware, nor for a user who names a profile of their own.
    Compared with Fast DDS under ROS by default, the profile changes four things:

    - All messages go by UDP, none through shared memory.  A process that is killed while it
      writes to shared memory leaves mutexes locked there, and other processes then wait for
      them and lose contact.  Sockets have no such state: the kernel closes them.
    - Where discovery is limited to this host, so are the sockets.  By default every host that
      knows the address can send to them.
    - Nodes announce themselves more often, and writers repeat a heartbeat after 20 ms, not 3 s:
      a node that starts finds the others, and a lost message is sent again, that much sooner.
    - A queue frees the memory of a message that has left it.  By default every place of a queue
      keeps the memory of the largest message that it ever held.

    The receive buffer holds four frames of 4096 x 4096 pixels of 16 bits where the system allows
    that.  The kernel reduces it to ``net.core.rmem_max``, and what does not fit is lost: a
    writer with this profile sends it again, a camera often too late.

    Parameters
    ----------
    environment
        Environment of the process that starts the run.
    folder
        Folder for the profile.
    implementation
        Name of the middleware, as ``rclpy.get_rmw_implementation_identifier`` returns it.

    Raises
    ------
    ValueError
        If ``ROS_STATIC_PEERS`` names a host that has no address; names that host.

    """
    if any(name in environment for name in _VARIABLES) or 'fastrtps' not in implementation:
        return {}
    interfaces = locators = ''
    added = dict(_FROM_PROFILE)
    # The older variable takes precedence, and ignores the peers.
    only_here = environment.get(_ONLY_HERE) == '1'
    if only_here or environment.get(_RANGE) == 'LOCALHOST':
        static = [] if only_here else [
            name for name in environment.get(_PEERS, '').split(';') if name]
        peers = [_PEER.format(address=_address_of(name)) for name in ['127.0.0.1', *static]]
        locators = _UNICAST.format(peers=''.join(peers))
        interfaces = '' if static else _LOOPBACK
        added |= _AS_IN_PROFILE
    path = (folder / PROFILE_FILE).resolve()
    path.write_text(_PROFILE.format(
        buffer=WANTED_BYTES, interfaces=interfaces, locators=locators), encoding='utf-8')
    return dict.fromkeys(_VARIABLES, str(path)) | added


def _address_of(name: str) -> str:
    """Return the IPv4 address of a host; ValueError where it has none."""
    try:
        return socket.gethostbyname(name)
    except OSError as error:
        raise ValueError(f'{_PEERS}: {name} has no address: {error.strerror}') from None


def clear_leftovers(folder: Path = _SEGMENTS) -> int:
    """
    Remove the segments of processes that have ended; return how many there were.

    The nodes of a run use no shared memory unless the user's own profile says so, and then a
    killed node leaves segments behind.  A segment whose lock is held, or whose file belongs to
    another user, stays.
    """
    cleared = 0
    for lock in folder.glob('fastrtps_*_el'):
        with contextlib.suppress(OSError):  # the lock is held, or the file is another user's
            if _LOCK.fullmatch(lock.name) and not _may_be_starting(lock):
                with lock.open('rb') as file:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    lock.with_name(lock.name.removesuffix('_el')).unlink(missing_ok=True)
                    lock.unlink()
                    cleared += 1
    return cleared


def _may_be_starting(lock: Path) -> bool:
    """Return whether a file is a few seconds old; one of the future predates a set-back clock."""
    return 0.0 <= time.time() - lock.stat().st_mtime <= _STARTING_S
