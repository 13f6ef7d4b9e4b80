"""Settings of the middleware for a run: who is found, how quickly, and room for large frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILE_FILE = 'fastdds.xml'
# Read by Fast DDS 2 (Jazzy) and by later ones.
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
# Has ROS leave to the profile what it sets itself: data sharing, and how memory is kept.
_FROM_PROFILE = {'RMW_FASTRTPS_USE_QOS_FROM_XML': '1'}
# Discovery beyond this host; so it is where nothing is said.
_RANGE, _WIDE = 'ROS_AUTOMATIC_DISCOVERY_RANGE', ('', 'SUBNET', 'SYSTEM_DEFAULT')
# What Fast DDS's own segment of half a megabyte holds well.
_SMALL_BYTES = 65_536
_FRAMES_IN_SEGMENT = 8
_LARGEST_SEGMENT = 2**30
# Header and rounding of a message.
_MARGIN_BYTES = 65_536
_PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
{transports}  <participant profile_name="lowsnr" is_default_profile="true">
    <rtps>
{use}      <builtin>
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
_TRANSPORTS = """\
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>frames</transport_id>
      <type>SHM</type>
{room}    </transport_descriptor>
    <transport_descriptor>
      <transport_id>network</transport_id>
      <type>UDPv4</type>
{only}    </transport_descriptor>
  </transport_descriptors>
"""
_ROOM = """\
      <segment_size>{segment}</segment_size>
      <maxMessageSize>{message}</maxMessageSize>
"""
_ONLY_THIS_HOST = """\
      <interfaceWhiteList>
        <address>127.0.0.1</address>
      </interfaceWhiteList>
"""
_USE = """\
      <userTransports>
        <transport_id>frames</transport_id>
        <transport_id>network</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
"""


def middleware_environment(
    environment: Mapping[str, str], folder: Path, frame_bytes: int,
) -> dict[str, str]:
    """
    Return what the processes of a run need in their environment beside what is there.

    A profile of Fast DDS, unless the environment names one.  By default processes that start
    together may miss one another, a process that starts later learns of those that are there, and
    a lost message or word of its arrival is made up for, after three seconds; here after a tenth
    or a quarter of one.  A frame that does not fit into the default segment of shared memory goes
    through UDP in pieces, which takes ten times as long; for such frames there is a segment that
    holds them.  By default the place of a message in a queue keeps the room of the largest that
    ever was there; here a message that is gone leaves none.  Where discovery is limited to this
    host, so are the sockets: by default they are open to everybody who knows its address.

    Parameters
    ----------
    environment
        Environment of the starter.
    folder
        Where the profile is written.
    frame_bytes
        Size of a frame; 0 where it is not known.

    """
    if any(name in environment for name in _VARIABLES):
        return {}
    transports = use = room = ''
    if frame_bytes > _SMALL_BYTES:
        message = frame_bytes + _MARGIN_BYTES
        segment = min(_FRAMES_IN_SEGMENT * message, max(_LARGEST_SEGMENT, 2 * message))
        room = _ROOM.format(segment=segment, message=message)
    only = _ONLY_THIS_HOST if _stays_on_host(environment) else ''
    if room or only:
        transports, use = _TRANSPORTS.format(room=room, only=only), _USE
    path = (folder / PROFILE_FILE).resolve()
    path.write_text(_PROFILE.format(transports=transports, use=use), encoding='utf-8')
    return dict.fromkeys(_VARIABLES, str(path)) | _FROM_PROFILE


def _stays_on_host(environment: Mapping[str, str]) -> bool:
    """Whether nobody on another host is looked for, nor let in."""
    if environment.get('ROS_LOCALHOST_ONLY') == '1':  # the older variable, which wins
        return True
    return environment.get(_RANGE, '') not in _WIDE and not environment.get('ROS_STATIC_PEERS')
