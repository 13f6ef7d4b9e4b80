# SPDX-License-Identifier: Apache-2.0
"""The exceedances of a tile as a point cloud, and back."""

from __future__ import annotations

import array

from lowsnr_common.core.records import Malformed
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.tiles.exceedances import Exceedances
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


def exceedances_to_cloud(found: Exceedances, header: Header) -> PointCloud2:
    """Return exceedances as a cloud with a point for each cell."""
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


def cloud_to_exceedances(
    cloud: PointCloud2, tile: Tile, detector: CellDetector,
) -> Exceedances:
    """
    Return the exceedances of a detector in a tile that a cloud holds.

    Raises
    ------
    Malformed
        If its fields or its size are others, a value is not finite, an excess is not above 0, a
        cell is not in the tile or occurs twice, a position is not near its cell, or a covariance
        is not positive definite; says which.

    """
    points = _points_of(cloud)
    values = np.array([points[name] for name in _POINT.names or ()], float)
    if not np.isfinite(values).all():
        raise Malformed('not finite', 'a value of an exceedance is not finite')
    cell = np.stack([points['y'], points['x']], axis=-1)
    if not (tile.holds(cell).all() and (cell == np.floor(cell)).all()
            and len(np.unique(cell, axis=0)) == len(cell)):
        raise Malformed('other cells', 'an exceedance is not in the tile, or one is there twice')
    if not (points['excess'] > 0.0).all():
        raise Malformed('no exceedance', 'a statistic does not exceed the threshold')
    return Exceedances(
        cell.astype(np.intp), points['excess'].astype(float), *_estimates_of(points, detector))


def _estimates_of(points: np.ndarray, detector: CellDetector) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 2) and covariances (n, 2, 2); Malformed if they cannot be."""
    cell_m = detector.sensor.cell_size_m
    place = np.stack([points['place_x'], points['place_y']], axis=-1)
    shift = place - cell_m * np.stack([points['x'], points['y']], axis=-1).astype(float)
    if not (np.abs(shift) <= (detector.centroid_reach + 0.5) * cell_m).all():
        raise Malformed('far from its cell', 'a position is not near its cell')
    xx, xy, yy = (points[name] for name in ('cov_xx', 'cov_xy', 'cov_yy'))
    if not ((xx > 0.0) & (yy > 0.0)).all() or not (
            np.abs(xy) < np.sqrt(xx) * np.sqrt(yy)).all():
        raise Malformed('no covariance', 'a covariance is not positive definite')
    return place, np.moveaxis(np.array([[xx, xy], [xy, yy]]), -1, 0)


def _points_of(cloud: PointCloud2) -> np.ndarray:
    """Return the points of a cloud, (n,) of ``_POINT``; Malformed if its layout is another."""
    fits = (cloud.fields == _FIELDS and cloud.height == 1 and not cloud.is_bigendian
            and cloud.point_step == _POINT.itemsize
            and len(cloud.data) == cloud.width * _POINT.itemsize)
    if not fits:
        raise Malformed('other fields', 'the cloud has other fields or another size')
    return np.frombuffer(cloud.data, _POINT)
