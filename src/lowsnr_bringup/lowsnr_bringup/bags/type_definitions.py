# SPDX-License-Identifier: Apache-2.0
"""Message types: the definitions and hashes that the installed packages give them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
import json
import os
from pathlib import Path
import re
import sys

_RULE = '=' * 80


@dataclass(frozen=True)
class TypeDefinition:
    """
    A message type as a bag holds it.

    Attributes
    ----------
    text
        Definition of the type and of all types that it refers to.
    digest
        Hash that DDS advertises for the type.

    """

    text: str
    digest: str


@cache
def type_definition(msgtype: str) -> TypeDefinition:
    """
    Return the definition of a type such as ``sensor_msgs/msg/Image``.

    Raises
    ------
    ValueError
        If the name is not that of a type, or no installed package defines it.

    """
    described = json.loads(_installed(msgtype, '.json').read_text(encoding='utf-8'))
    description = described['type_description_msg']
    referred = sorted(
        item['type_name'] for item in description['referenced_type_descriptions'])
    parts = [_installed(msgtype, '.msg').read_text(encoding='utf-8')]
    for name in referred:
        text = _installed(name, '.msg').read_text(encoding='utf-8')
        parts.append(f'{_RULE}\nMSG: {name.replace("/msg/", "/")}\n{text}')
    digests = {item['type_name']: item['hash_string'] for item in described['type_hashes']}
    return TypeDefinition('\n'.join(parts), digests[msgtype])


def _installed(msgtype: str, suffix: str) -> Path:
    if not re.fullmatch(r'[A-Za-z]\w*/msg/[A-Za-z]\w*', msgtype, re.ASCII):
        raise ValueError(f'{msgtype!r} is not the name of a message type')
    package, *folders, name = msgtype.split('/')
    for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]:
        path = Path(prefix, 'share', package, *folders, f'{name}{suffix}')
        if prefix and path.is_file():
            return path
    raise ValueError(f'{msgtype}: no installed package defines this message type')
