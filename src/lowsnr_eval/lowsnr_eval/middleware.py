"""Settings of the middleware for large frames: shared memory that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILE_FILE = 'fastdds.xml'
# Read by Fast DDS 2 (Jazzy) and by later ones.
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
# What Fast DDS's own segment of half a megabyte holds well.
_SMALL_BYTES = 65_536
_FRAMES_IN_SEGMENT = 8
_LARGEST_SEGMENT = 2**30
# Header and rounding of a message.
_MARGIN_BYTES = 65_536
_PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>frames</transport_id>
      <type>SHM</type>
      <segment_size>{segment}</segment_size>
      <maxMessageSize>{message}</maxMessageSize>
    </transport_descriptor>
    <transport_descriptor>
      <transport_id>network</transport_id>
      <type>UDPv4</type>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="lowsnr" is_default_profile="true">
    <rtps>
      <userTransports>
        <transport_id>frames</transport_id>
        <transport_id>network</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""


def node_environment(
    environment: Mapping[str, str], folder: Path, frame_bytes: int,
) -> dict[str, str]:
    """
    Return the environment of the nodes of a run.

    A frame that does not fit into Fast DDS's segment of shared memory goes through UDP in
    pieces, which takes ten times as long.  For such frames a profile with a segment that holds
    them is written, unless the environment names one.

    Parameters
    ----------
    environment
        Environment of the starter.
    folder
        Where the profile is written.
    frame_bytes
        Size of a frame; 0 where it is not known.

    """
    if frame_bytes <= _SMALL_BYTES or any(name in environment for name in _VARIABLES):
        return dict(environment)
    message = frame_bytes + _MARGIN_BYTES
    segment = min(_FRAMES_IN_SEGMENT * message, max(_LARGEST_SEGMENT, 2 * message))
    path = (folder / PROFILE_FILE).resolve()
    path.write_text(_PROFILE.format(segment=segment, message=message), encoding='utf-8')
    return {**environment, **dict.fromkeys(_VARIABLES, str(path))}
