# SPDX-License-Identifier: Apache-2.0
"""Sequences without their object: a seamless patch of background where it is."""

from typing import Any

# Half of the patch where the file has no box, and what is added to half a box [pixels].
PATCH_HALF, PATCH_MARGIN = 6, 3


def erased(data: Any) -> Any:
    """
    Return the frames with the object replaced by background.

    A patch around it becomes the median over the frames, in scene coordinates, plus what continues
    the difference of the frame from it smoothly from the border of the patch inwards: the border
    of a patch of another brightness would itself be an object that moves.
    """
    import numpy as np

    frames, (median, offset) = data['frames'].copy(), _scene_median(data)
    count, rows, cols = frames.shape
    whole = np.issubdtype(frames.dtype, np.integer)
    boxes = data.get('box_wh', np.full((count, 2), 2 * (PATCH_HALF - PATCH_MARGIN)))
    for k in np.flatnonzero(np.isfinite(data['truth']).all(axis=1)):
        (x, y), (left, top) = data['truth'][k].astype(int), offset[k]
        half = int(np.ceil(np.nanmax(boxes[k]) / 2)) + PATCH_MARGIN
        # The patch, and one pixel around it that stays.
        part = tuple(slice(max(at - half - 1, 0), at + half + 2) for at in (y, x))
        level = median[top:top + rows, left:left + cols][part]
        if not level.size:
            continue
        row, col = np.ogrid[part[0].start:part[0].start + level.shape[0],
                            part[1].start:part[1].start + level.shape[1]]
        inside = (abs(row - y) <= half) & (abs(col - x) <= half)
        filled = level + membrane(frames[k][part] - level, ~inside)
        if whole:
            filled = np.rint(filled).clip(0, np.iinfo(frames.dtype).max)
        frames[k][part] = np.where(inside, filled, frames[k][part])
    return frames


def _scene_median(data: Any) -> tuple[Any, Any]:
    """Return the median over the frames of the scene, and the corner of each frame x, y in it."""
    import numpy as np

    count, rows, cols = data['frames'].shape
    offset = np.rint(data.get('camera_offset', np.zeros((count, 2)))).astype(int)
    offset -= offset.min(axis=0)
    scene = np.full((count, rows + offset[:, 1].max(), cols + offset[:, 0].max()), np.nan, 'f4')
    for plane, frame, (x, y) in zip(scene, data['frames'], offset):
        plane[y:y + rows, x:x + cols] = frame
    scene[:, np.isnan(scene).all(axis=0)] = 0.0
    return np.nanmedian(scene, axis=0), offset


def membrane(values: Any, known: Any) -> Any:
    """
    Return values (rows, cols), where they are not known each the mean of its neighbours.

    That is the solution of Laplace's equation with the known values as its border; zero where
    nothing is known.
    """
    import numpy as np
    import scipy.sparse
    import scipy.sparse.csgraph
    import scipy.sparse.linalg

    number = np.arange(values.size).reshape(values.shape)
    pairs = np.concatenate([
        np.stack([number[:, 1:].ravel(), number[:, :-1].ravel()]),
        np.stack([number[1:].ravel(), number[:-1].ravel()])], axis=1)
    beside = scipy.sparse.coo_matrix(
        (np.ones(pairs.shape[1]), pairs), (values.size, values.size))
    laplace = scipy.sparse.csgraph.laplacian((beside + beside.T).tocsr()).tocsr()
    found, fixed = np.where(known, values, 0.0).ravel(), np.ravel(known)
    if fixed.any() and not fixed.all():
        rest = laplace[~fixed]
        found[~fixed] = scipy.sparse.linalg.spsolve(
            rest[:, ~fixed].tocsc(), -rest[:, fixed] @ found[fixed])
    return found.reshape(values.shape)
