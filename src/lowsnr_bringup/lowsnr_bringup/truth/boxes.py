# SPDX-License-Identifier: Apache-2.0
"""
Truth from boxes around objects: MOT tables and COCO annotations.

The centre of a box is that of the pixels that it covers: of the first and the last one in a row.
"""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from pathlib import PurePath
from typing import Any

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.truth.frame_index import FrameIndex
from lowsnr_bringup.truth.frame_index import Line
from lowsnr_bringup.truth.frame_index import OBJECT
from lowsnr_bringup.truth.frame_index import Reading
from lowsnr_bringup.truth.table import add_object
from lowsnr_bringup.truth.table import first_frame
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.text import one_line

_MOT_COLUMNS = range(6, 11)


def is_mot(text: str) -> bool:
    """Whether a text is a MOT table: numbers only, and no header."""
    head = next((line for line in text.splitlines() if line.strip()), '')
    cells = head.replace(',', ' ').split()
    try:
        return len(cells) in _MOT_COLUMNS and bool([float(cell) for cell in cells])
    except ValueError:
        return False


def read_mot(
    path: Path, text: str, frames: FrameIndex, reading: Reading, notes: list[str],
) -> list[list[Truth]]:
    """
    Return the objects of every frame from lines ``frame, id, left, top, width, height, conf``.

    Frames and pixels count from 1; a line whose seventh number is 0 is to be ignored.
    """
    lines = []
    for number, row in enumerate(text.splitlines(), start=1):
        cells = row.replace(',', ' ').split()
        if not cells:
            continue
        line = Line(path, number)
        if len(cells) not in _MOT_COLUMNS:
            raise line.fault('number', f'{len(cells)} numbers, a MOT table has 6 to 10 in a line')
        lines.append((line, [line.number(cell) for cell in cells]))
    first = first_frame(path, [values[0] for _, values in lines], reading, notes)
    origin = 1 if reading.origin is None else reading.origin
    found: list[dict[str, Truth]] = [{} for _ in range(frames.count)]
    for line, (frame, name, left, top, width, height, *more) in lines:
        index = frames.by_number(line, frame, first)
        if more and more[0] == 0:
            continue
        add_object(found[index], line, f'{name:.15g}', _centre(left, width) - origin,
                   _centre(top, height) - origin, index)
    return [list(objects.values()) for objects in found]


def read_coco(
    path: Path, text: str, frames: FrameIndex, reading: Reading, notes: list[str],
) -> list[list[Truth]]:
    """
    Return the objects of every frame from COCO annotations.

    Images are the frames of the files of their names, where a folder has them, else in the order
    of their numbers.  An object is known by ``track_id``, or, one in an image, by its category.
    """
    try:
        tree = json.loads(text)
        index = _images(path, tree['images'], frames)
        names = {item['id']: str(item['name']) for item in tree.get('categories', ())}
        found: list[dict[str, Truth]] = [{} for _ in range(frames.count)]
        for number, item in enumerate(tree['annotations'], start=1):
            left, top, width, height = map(float, item['bbox'])
            k = index[item['image_id']]
            name = _name(item, names)
            if name in found[k]:
                raise UnusableFile(
                    path, 'twice', f'annotation {number}: {name} is twice in one image; several '
                    'objects need a track_id')
            origin = reading.origin or 0
            add_object(found[k], Line(path, number), name, _centre(left, width) - origin,
                       _centre(top, height) - origin, k)
    except UnusableFile:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise UnusableFile(
            path, 'unreadable', f'not COCO annotations: {type(error).__name__} '
            f'{one_line(error)}') from None
    return [list(objects.values()) for objects in found]


def _centre(start: float, size: float) -> float:
    return start + (size - 1.0) / 2.0


def _name(item: Mapping[str, Any], names: Mapping[Any, str]) -> str:
    attributes = item.get('attributes') or {}
    for key in ('track_id', 'instance_id', 'object_id'):
        found = item.get(key, attributes.get(key))
        if found is not None:
            return str(found)
    return names.get(item.get('category_id'), OBJECT)


def _images(path: Path, images: list[Any], frames: FrameIndex) -> dict[Any, int]:
    """Return the index of the frame of every image by the image's number."""
    stems = {PurePath(name).stem: k for k, name in enumerate(frames.files)}
    by_file = {
        item['id']: stems[stem] for item in images
        if (stem := PurePath(str(item.get('file_name', ''))).stem) in stems}
    if by_file:
        if len(by_file) < len(images):
            lacking = next(item for item in images if item['id'] not in by_file)
            raise UnusableFile(
                path, 'no such frame', f'there is no frame {lacking.get("file_name")}')
        return by_file
    ordered = sorted(images, key=lambda item: (item.get('frame_id', 0), item['id']))
    if len(ordered) != frames.count:
        raise UnusableFile(
            path, 'no such frame', f'names {len(ordered)} images, and there are {frames.count} '
            'frames')
    return {item['id']: k for k, item in enumerate(ordered)}
