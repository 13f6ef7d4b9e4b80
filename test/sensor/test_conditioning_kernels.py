# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of the conditioner compute what their definitions in NumPy do."""

from dataclasses import replace

from lowsnr_common.core import compiled
from lowsnr_sensor.conditioner_node import preload
from lowsnr_sensor.conditioning import cells
from lowsnr_sensor.conditioning import compiled_steps
from lowsnr_sensor.conditioning import frame_change
from lowsnr_sensor.conditioning import pixels
from lowsnr_sensor.conditioning import registration
from lowsnr_sensor.conditioning import scene
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np
import pytest

SHAPES = [(1, 9), (9, 1), (23, 37), (64, 50)]
LIMITS = pixels.Limits(32.0, 100.0, 5.0, 2.0, 8.0, 0.09, 0.2)
CLOSE = {'rtol': 2e-4, 'atol': 2e-4}


def single(values):
    """Return float32."""
    return np.asarray(values, dtype=np.float32)


def planes_of(rng, shape):
    """Return planes of all ages, with edges."""
    return pixels.Planes(
        single(rng.normal(100.0, 5.0, shape)), single(rng.uniform(0.5, 9.0, shape)),
        single(rng.integers(0, 101, shape)))


def frame_of(rng, shape):
    """Return a frame with outliers and pixels that are not observed."""
    frame = single(rng.normal(100.0, 6.0, shape))
    frame[rng.random(shape) < 0.05] = np.nan
    frame[rng.random(shape) < 0.05] += 200.0
    frame[rng.random(shape) < 0.02] = np.inf
    return frame


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('corner', [(0, 0), (-6, 9)])
def test_update_is_its_definition(rng, shape, corner):
    frame, planes = frame_of(rng, shape), planes_of(rng, shape)
    local = single(rng.uniform(1.0, 9.0, pixels.blocks_of(shape)))
    for change in (pixels.Change(), pixels.Change(
            1.1, -9.0, 2.0, single(rng.normal(size=shape)), single(rng.normal(size=shape[0])),
            single(rng.normal(size=shape[1])))):
        found = compiled_steps.update(frame, planes, local, corner, change, LIMITS)
        wanted = pixels.update(frame, planes, local, corner, change, LIMITS)
        for one, two in zip((*found[0], found[1]), (*wanted[0], wanted[1])):
            assert one.dtype == np.float32
            np.testing.assert_allclose(one, two, **CLOSE)


@pytest.mark.parametrize('shape', SHAPES)
def test_sums_over_stripes_and_blocks_are_their_definitions(rng, shape):
    frame, planes = frame_of(rng, shape), planes_of(rng, shape)
    change = replace(pixels.Change(0.9, 3.0), rows=single(rng.normal(size=shape[0])))
    for found, wanted in zip(compiled_steps.stripe_sums(frame, planes, change, 12.0),
                             frame_change.stripe_sums(frame, planes, change, 12.0)):
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-2)
    local = single(rng.uniform(1.0, 2.0, pixels.blocks_of(shape)))
    for found, wanted in zip(compiled_steps.block_sums(planes, local),
                             pixels.block_sums(planes, local)):
        np.testing.assert_allclose(found, wanted, **CLOSE)


@pytest.mark.parametrize('regions', [2, 3, 64])
@pytest.mark.parametrize('binning', [1, 2])
def test_regions_give_the_same_bits(rng, regions, binning):
    """A moving camera, stripes, wide changes of level, outliers and pixels without a value."""
    whole = ConditioningSettings(
        warm_up_frames=2, binning=binning, noise_floor=0.0, limit=6.0)
    parts, shape = replace(whole, regions=regions), (203, 150)
    scene_of_all = 40.0 * np.kron(rng.standard_normal((56, 44)), np.ones((4, 4)))
    states = whole.init(shape), parts.init(shape)
    for k in range(9):
        frame = scene_of_all[k:k + shape[0], :shape[1]] + rng.standard_normal(shape)
        frame[:, ::7] += 3.0 * (k > 4)
        frame[:100, :75] += 5.0 * (k > 6)
        frame[rng.random(shape) < 0.01] = np.nan
        found = [one.step(state, frame) for one, state in zip((whole, parts), states)]
        states = found[0][0], found[1][0]
        assert found[0][1].cells.tobytes() == found[1][1].cells.tobytes()
    assert found[0][1].cells.any()
    assert np.any(states[0].position)
    for name in ('local', 'trace', 'before', 'cell_variance'):
        assert getattr(states[0], name).tobytes() == getattr(states[1], name).tobytes()
    for one, two in zip(states[0].planes, states[1].planes):
        assert one.tobytes() == two.tobytes()


@pytest.mark.parametrize('shape', [(1, 1), *SHAPES])
def test_variance_of_the_surroundings_is_its_definition_to_the_bit(rng, shape):
    total, before = (single(rng.uniform(0.5, 9.0, shape)) for _ in range(2))
    count = single(rng.integers(0, 17, shape) * (rng.random(shape) < 0.3))
    found = compiled_steps.surroundings(total, count, before)
    assert np.array_equal(found, pixels.surroundings(total, count, before))
    assert found.size < 100 or (found == before).any()


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('reach', [2, 4])
def test_limit_of_transients_is_its_definition(rng, shape, reach):
    values, before = (single(scale * rng.standard_normal(shape)) for scale in (9.0, 1.0))
    found = compiled_steps.transients_limited(values, before, reach)
    np.testing.assert_array_equal(found, cells.transients_limited(values, before, reach))
    assert found.size < 100 or (found != values).any()


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('binning', [1, 2])
@pytest.mark.parametrize('shift', [(0.0, 0.0), (-3.4, 7.8)])
def test_matched_filter_is_its_definition(rng, shape, binning, shift):
    values = single(2.0 * rng.standard_normal(shape))
    rows, cols = (cells.taps(size, size // binning, binning, 0.8, by)
                  for size, by in zip(shape, shift))
    found = compiled_steps.filtered(values, rows, cols)
    wanted = cells.filtered(values, rows, cols)
    np.testing.assert_allclose(found, wanted, **CLOSE)


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('reach', [0, 1, 4])
def test_cells_are_flattened_and_divided_by_their_noise_as_defined(rng, shape, reach):
    plane = single(rng.standard_normal(shape))
    plane[:2, :3] = 0.0
    flat = compiled_steps.flattened(plane, reach)
    np.testing.assert_allclose(flat, cells.flattened(plane, reach), **CLOSE)
    trace, local = single(rng.standard_normal(shape)), single(
        rng.uniform(0.7, 2.0, pixels.blocks_of(shape)))
    for found, wanted in zip(compiled_steps.cell_noise(flat, trace, 0.5, 1.3, local),
                             cells.cell_noise(flat, trace, 0.5, 1.3, local)):
        np.testing.assert_allclose(found, wanted, **CLOSE)


@pytest.mark.parametrize('position', [(0.0, 0.0), (0.25, -1.5), (-7.3, 4.6)])
def test_interpolation_is_its_definition(rng, position):
    plane = single(rng.standard_normal((23, 37)))
    np.testing.assert_allclose(
        scene.shifted_compiled(plane, position), scene.shifted(plane, position), **CLOSE)
    sample = registration.Sample(plane[::3, ::3], 3, plane[::3, ::3], 9)
    planes = pixels.Planes(plane, plane, single(rng.integers(0, 9, plane.shape)))
    np.testing.assert_allclose(
        registration.taken_compiled(planes, sample, position),
        registration.taken(planes, sample, position), **CLOSE)


def test_cubic_interpolation_keeps_a_parabola_and_its_slope():
    row, col = np.mgrid[:20, :30].astype(np.float32)
    plane = 0.5 * row**2 - 0.3 * row * col + 2.0 * col
    sample = registration.Sample(plane[:10, :20], 1, plane[:10, :20], 1)
    down, right = 3.3, 5.7
    planes = pixels.Planes(plane, plane, np.ones_like(plane))
    found = registration.taken_compiled(planes, sample, (down, right))
    y, x = row[:10, :20] + down, col[:10, :20] + right
    for one, two in zip(found, (0.5 * y**2 - 0.3 * y * x + 2.0 * x, y - 0.3 * x, 2.0 - 0.3 * y)):
        np.testing.assert_allclose(one, two, atol=2e-3)


@pytest.mark.parametrize('by', [(0, 0), (0, 2), (3, -4), (-1, 0), (-9, 5), (2, 7), (12, -12)])
def test_plane_is_moved_as_by_loops(rng, by):
    plane, wanted = single(rng.standard_normal((5, 7))), np.full((5, 7), np.nan, np.float32)
    for row, col in np.ndindex(5, 7):
        if 0 <= row + by[0] < 5 and 0 <= col + by[1] < 7:
            wanted[row, col] = plane[row + by[0], col + by[1]]
    np.testing.assert_array_equal(pixels.moved_by(plane, by, np.nan), wanted)


@pytest.mark.parametrize('position', [(2.0, -3.0), (1.4, 6.7)])
def test_planes_return_to_the_scene_as_defined(rng, position):
    state = ConditioningSettings().init((23, 37))
    state = replace(state, planes=planes_of(rng, (23, 37)), position=position)
    before, corner = scene.to_image(state)
    assert corner == tuple(round(place) for place in position)
    after = pixels.Planes(before.level + single(rng.standard_normal((23, 37))),
                          before.variance + 1.0, before.age + 1.0)
    change = pixels.Change(1.1, -2.0)
    found = scene.from_image(state, before, after, change)
    wanted = scene.from_image_defined(state, before, after, change)
    for one, two in zip(found, wanted):
        np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize('binning', [1, 2])
@pytest.mark.parametrize('shift', [0.0, 0.37, -2.6])
def test_matched_filter_has_unit_noise_and_its_peak_at_the_object(binning, shift):
    size, count = 60, 60 // binning
    axis = cells.taps(size, count, binning, 0.8, shift)
    matrix = cells.along(np.eye(size, dtype=np.float32), axis)
    inside = axis.scale > 0.0
    np.testing.assert_allclose(np.sum(matrix**2, axis=1)[inside], 1.0, rtol=1e-5)
    # A point at the centre of cell 12 of the scene is seen at this pixel of the image.
    place = binning * 12 + (binning - 1) / 2.0 - shift
    point = np.exp(-(np.arange(size) - place)**2 / (2.0 * 0.8**2))
    answer = matrix @ point
    assert np.argmax(answer) == 12
    # No filter gains more than the energy of the point spread; bins cost up to 2 %.
    assert 0.97 < answer[12] / np.sqrt(np.sum(point**2)) < 1.0001


def test_nothing_is_compiled_after_preload(monkeypatch, rng):
    """Frames with stripes, a wide change, and pixels without a value, of a camera that moves."""
    monkeypatch.setattr(compiled, '_DISPATCHERS', [])
    compiled._machine_code.cache_clear()  # what other tests have compiled
    preload()
    before = compiled.variants()
    assert before
    conditioning, shape = ConditioningSettings(warm_up_frames=2), (64, 80)
    state = conditioning.init(shape)
    background = 40.0 * np.kron(rng.standard_normal((30, 20)), np.ones((4, 4)))
    for k in range(40):
        frame = single(background[k:k + 64] + 6.0 * rng.standard_normal(shape))
        frame[:, ::5] += 15.0 * (k > 20)
        frame[:, :40] += 30.0 * (k > 30)
        frame[rng.random(shape) < 0.01 * (k > 10)] = np.nan
        state, _ = conditioning.step(state, frame)
    assert compiled.variants() == before
