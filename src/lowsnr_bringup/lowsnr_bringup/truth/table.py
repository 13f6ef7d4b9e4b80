# SPDX-License-Identifier: Apache-2.0
"""
Truth from a table, for recordings of real frames.

A CSV file with a header line that has columns for the frame (its number or its time), x and y,
and for the object where there are several.  x is the column and y the row, in pixels.  There is
no object where x or y is empty or ``nan``, nor in a frame without a line.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
import csv
import math
from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.truth.frame_index import FrameIndex
from lowsnr_bringup.truth.frame_index import Line
from lowsnr_bringup.truth.frame_index import OBJECT
from lowsnr_bringup.truth.frame_index import Reading
from lowsnr_bringup.truth.frame_index import truth_at
from lowsnr_common.core.records import Truth

# Names that tables give to what a column holds, without case and without what is not a letter.
NAMES: Mapping[str, tuple[str, ...]] = {
    'frame': ('frame', 'frameid', 'frameno', 'framenr', 'framenumber', 'frameindex', 'frameidx',
              'framenum', 'image', 'imageid', 'bild'),
    't_s': ('ts', 't', 'time', 'times', 'timesec', 'timeseconds', 'timestamp', 'timestamps',
            'stamp', 'seconds', 'zeit', 'date', 'datetime', 'dateobs'),
    'x': ('x', 'xpx', 'xpixel', 'xpixels', 'px', 'posx', 'positionx', 'xpos', 'cx', 'xc',
          'xcenter', 'xcentre', 'centerx', 'centrex', 'xcentroid', 'centroidx', 'u', 'col',
          'column', 'spalte'),
    'y': ('y', 'ypx', 'ypixel', 'ypixels', 'py', 'posy', 'positiony', 'ypos', 'cy', 'yc',
          'ycenter', 'ycentre', 'centery', 'centrey', 'ycentroid', 'centroidy', 'v', 'row',
          'line', 'zeile'),
    'id': ('id', 'object', 'objectid', 'obj', 'objid', 'track', 'trackid', 'target', 'targetid',
           'name', 'label')}
_DELIMITERS = ',;\t '


def read_table(
    path: Path, text: str, frames: FrameIndex, reading: Reading, notes: list[str],
) -> list[list[Truth]]:
    """Return the objects of every frame from the text of a table."""
    delimiter, rows = _rows(path, text)
    header = next(rows, (1, []))[1]
    if [cell.strip() for cell in header[:1]] == ['#']:  # as NumPy writes it
        header = header[1:]
    columns = _columns(path, header, reading)
    # A decimal comma needs another delimiter.
    decimal = ',' if delimiter in ';\t' else '.'
    lines = []
    for number, row in rows:
        if not any(cell.strip() for cell in row):
            continue
        line = Line(path, number)
        if len(row) < len(header) or any(cell.strip() for cell in row[len(header):]):
            raise line.fault('fields', f'{len(row)} fields; the header has {len(header)}')
        cells = {what: row[k] for what, k in columns.items()}
        key = (line.number(cells['frame'], decimal) if 'frame' in columns
               else line.time_s(cells['t_s'], decimal))
        lines.append((line, key, line.number(cells['x'], decimal),
                      line.number(cells['y'], decimal), cells.get('id', '').strip() or OBJECT))
    keys = [key for _, key, *_ in lines]
    first = first_frame(path, keys, reading, notes) if 'frame' in columns else 0
    from_first = frames.counts_from_first(keys) if 'frame' not in columns else False
    found: list[dict[str, Truth]] = [{} for _ in range(frames.count)]
    origin = reading.origin or 0
    for line, key, x, y, name in lines:
        index = (frames.by_number(line, key, first) if 'frame' in columns
                 else frames.by_time(line, key, from_first))
        add_object(found[index], line, name, x - origin, y - origin, index)
    return [list(objects.values()) for objects in found]


def add_object(
    objects: dict[str, Truth], line: Line, name: str, x: float, y: float, index: int,
) -> None:
    """Add an object to those of a frame, unless x or y is not known."""
    if name in objects:
        raise line.fault('twice', f'{name} is twice in frame {index + 1}')
    if math.isfinite(x + y):
        objects[name] = truth_at(x, y, name)


def first_frame(
    path: Path, numbers: Sequence[float], reading: Reading, notes: list[str],
) -> int:
    """Return the number of the first frame; a table that has a frame 0 counts from it."""
    if reading.first is not None:
        return reading.first
    if 0 in numbers:
        notes.append(f'{path}: counts the frames from 0')
        return 0
    return 1


def _rows(path: Path, text: str) -> tuple[str, Iterator[tuple[int, list[str]]]]:
    """Return the delimiter of a table, and its lines with their numbers."""
    lines = text.splitlines()
    head = next((line for line in lines if line.strip()), '')
    delimiter = max(_DELIMITERS, key=head.count) if head else ','
    if delimiter == ' ' and ',' in head:
        delimiter = ','
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=delimiter == ' ')

    def rows() -> Iterator[tuple[int, list[str]]]:
        try:
            for row in reader:
                if row:
                    yield reader.line_num, row
        except csv.Error as error:
            raise UnusableFile(
                path, 'unreadable', f'not a CSV file: {" ".join(str(error).split())}') from None
    return delimiter, rows()


def _columns(path: Path, header: Sequence[str], reading: Reading) -> dict[str, int]:
    """Return the number of the column of each thing that a table holds."""
    names = [name.strip() for name in header]
    plain = [''.join(filter(str.isalpha, name.lower())) for name in names]
    found = {}
    for what, wanted in reading.columns:
        if wanted not in names:
            raise UnusableFile(
                path, 'header', f'has no column {wanted}; it has {", ".join(names)}')
        found[what] = names.index(wanted)
    for what, known in NAMES.items():
        fits = [k for name in known for k, other in enumerate(plain)
                if other == name and k not in found.values()]
        if what not in found and fits:
            found[what] = fits[0]
    missing = [what for what in ('x', 'y') if what not in found]
    if not {'frame', 't_s'} & found.keys():
        missing.insert(0, 'frame or t_s')
    if missing:
        raise UnusableFile(
            path, 'header', f'has no column for {", ".join(missing)}; it has '
            f'{", ".join(names) or "none"}; --truth-columns x=NAME,y=NAME,frame=NAME names them')
    return found
