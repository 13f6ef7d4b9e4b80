# SPDX-License-Identifier: Apache-2.0
"""The settings of the middleware for a run: its transport, its discovery and its memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import socket

PROFILE_FILE = 'fastdds.xml'
# Fast DDS 2 (Jazzy) and later versions read different variables.
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
# ROS otherwise overrides what the profile says of data sharing and of memory.
_FROM_PROFILE = {'RMW_FASTRTPS_USE_QOS_FROM_XML': '1'}
_RANGE, _PEERS, _ONLY_HERE = (
    'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')
# With this range ROS adds nothing to the profile; with LOCALHOST it adds shared memory.
_AS_IN_PROFILE = {_RANGE: 'SYSTEM_DEFAULT', _PEERS: '', _ONLY_HERE: ''}
_PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>lowsnr</transport_id>
      <type>UDPv4</type>
      <receiveBufferSize>4194304</receiveBufferSize>
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

    The receive buffer holds a frame of 1024 x 1024 cells where the system allows that; the
    kernel reduces it to ``net.core.rmem_max`` elsewhere, and lost fragments are sent again.

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
    path.write_text(_PROFILE.format(interfaces=interfaces, locators=locators), encoding='utf-8')
    return dict.fromkeys(_VARIABLES, str(path)) | added


def _address_of(name: str) -> str:
    """Return the IPv4 address of a host; ValueError where it has none."""
    try:
        return socket.gethostbyname(name)
    except OSError as error:
        raise ValueError(f'{_PEERS}: {name} has no address: {error.strerror}') from None
