# SPDX-License-Identifier: Apache-2.0
"""The crossings of a tile as a point cloud, and back."""

from __future__ import annotations

import array

from lowsnr_common.core.records import Malformed
from lowsnr_detect.tiles.crossings import Crossings
from lowsnr_detect.tiles.tile import Tile
import numpy as np
from sensor_msgs.msg import PointCloud2
from sensor_msgs.msg import PointField
from std_msgs.msg import Header

# A point is a cell: column and row, as viewers show them, and what else a declaration needs.
_POINT = np.dtype([
    ('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('excess', '<f8'), ('place_x', '<f8'),
    ('place_y', '<f8'), ('cov_xx', '<f8'), ('cov_xy', '<f8'), ('cov_yy', '<f8')])
_KINDS = {'<f4': PointField.FLOAT32, '<f8': PointField.FLOAT64}
_FIELDS = [
    PointField(name=name, offset=offset, datatype=_KINDS[kind.str], count=1)
    for name, (kind, offset, *_) in (_POINT.fields or {}).items()]
_FARTHEST = 1e9


def crossings_to_cloud(found: Crossings, header: Header) -> PointCloud2:
    """Return crossings as a cloud with a point for each cell."""
    points = np.zeros(len(found.excess), _POINT)
    points['y'], points['x'] = found.cell.T
    points['excess'] = found.excess
    points['place_x'], points['place_y'] = found.place.T
    points['cov_xx'], points['cov_xy'], points['cov_yy'] = (
        found.cov[:, 0, 0], found.cov[:, 0, 1], found.cov[:, 1, 1])
    data = array.array('B')
    data.frombytes(points.tobytes())
    return PointCloud2(
        header=header, height=1, width=len(points), fields=_FIELDS, is_bigendian=False,
        point_step=_POINT.itemsize, row_step=_POINT.itemsize * len(points), data=data,
        is_dense=True)


def cloud_to_crossings(cloud: PointCloud2, tile: Tile) -> Crossings:
    """
    Return the crossings of a tile that a cloud holds.

    Raises
    ------
    Malformed
        If its fields or its size are others, a value is not finite or beyond 1e9, an excess is
        not above 0, a cell is not in the tile, or one occurs twice; says which.

    """
    points = _points_of(cloud)
    values = np.array([points[name] for name in _POINT.names or ()], float)
    if not (np.abs(values) <= _FARTHEST).all():
        raise Malformed('value out of bounds', 'a value of a crossing is not finite or beyond 1e9')
    cell = np.stack([points['y'], points['x']], axis=-1).astype(np.intp)
    whole = (cell[:, 1] == points['x']) & (cell[:, 0] == points['y'])
    if not (whole & tile.holds(cell)).all() or len(np.unique(cell, axis=0)) < len(cell):
        raise Malformed('other cells', 'a crossing is not in the tile, or one is there twice')
    if not (points['excess'] > 0.0).all():
        raise Malformed('no crossing', 'a statistic does not exceed the threshold')
    cov = np.array([[points['cov_xx'], points['cov_xy']], [points['cov_xy'], points['cov_yy']]])
    place = np.stack([points['place_x'], points['place_y']], axis=-1)
    return Crossings(cell, points['excess'].astype(float), place, np.moveaxis(cov, -1, 0))


def _points_of(cloud: PointCloud2) -> np.ndarray:
    """Return the points of a cloud, (n,) of ``_POINT``; Malformed if its layout is another."""
    fits = (cloud.fields == _FIELDS and cloud.height == 1 and not cloud.is_bigendian
            and cloud.point_step == _POINT.itemsize
            and len(cloud.data) == cloud.width * _POINT.itemsize)
    if not fits:
        raise Malformed('other fields', 'the cloud has other fields or another size')
    return np.frombuffer(cloud.data, _POINT)
