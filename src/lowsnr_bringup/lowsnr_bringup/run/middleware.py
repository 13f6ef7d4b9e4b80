"""The settings of the middleware for a run: its transport, its discovery and its memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILE_FILE = 'fastdds.xml'
# Fast DDS 2 (Jazzy) and later versions read different variables.
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
# ROS otherwise overrides what the profile says of data sharing and of memory.
_FROM_PROFILE = {'RMW_FASTRTPS_USE_QOS_FROM_XML': '1'}
# Values of the discovery range for which nodes look for other hosts; ROS takes '' for SUBNET.
_RANGE, _WIDE = 'ROS_AUTOMATIC_DISCOVERY_RANGE', ('', 'SUBNET', 'SYSTEM_DEFAULT')
_PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>lowsnr</transport_id>
      <type>UDPv4</type>
      <receiveBufferSize>4194304</receiveBufferSize>
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
        <readerHistoryMemoryPolicy>PREALLOCATED_WITH_REALLOC</readerHistoryMemoryPolicy>
        <writerHistoryMemoryPolicy>PREALLOCATED_WITH_REALLOC</writerHistoryMemoryPolicy>
      </builtin>
    </rtps>
  </participant>
  <data_writer profile_name="lowsnr" is_default_profile="true">
    <qos><data_sharing><kind>OFF</kind></data_sharing></qos>
    <times>
      <heartbeatPeriod><sec>0</sec><nanosec>100000000</nanosec></heartbeatPeriod>
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


def middleware_environment(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """
    Write the Fast DDS profile of a run; return the variables that point its processes to it.

    The environment of a user who names a profile of their own stays as it is.  Compared with the
    defaults of Fast DDS, the profile changes four things:

    - All messages go by UDP, none through shared memory.  A process that is killed while it
      writes to shared memory leaves mutexes locked there, and other processes then wait for
      them and lose contact.  Sockets have no such state: the kernel closes them.
    - Where discovery is limited to this host, so are the sockets.  By default every host that
      knows the address can send to them.
    - Nodes announce themselves more often, and writers repeat a heartbeat after 0.1 s, not 3 s:
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

    """
    if any(name in environment for name in _VARIABLES):
        return {}
    interfaces = _LOOPBACK if _stays_on_host(environment) else ''
    path = (folder / PROFILE_FILE).resolve()
    path.write_text(_PROFILE.format(interfaces=interfaces), encoding='utf-8')
    return dict.fromkeys(_VARIABLES, str(path)) | _FROM_PROFILE


def _stays_on_host(environment: Mapping[str, str]) -> bool:
    """Return whether nodes neither look for other hosts nor accept messages from them."""
    if environment.get('ROS_LOCALHOST_ONLY') == '1':  # the older variable takes precedence
        return True
    return environment.get(_RANGE, '') not in _WIDE and not environment.get('ROS_STATIC_PEERS')
