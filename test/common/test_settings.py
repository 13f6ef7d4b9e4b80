# SPDX-License-Identifier: Apache-2.0
"""Declared settings: types, bounds, groups, and errors that name the culprit."""

from dataclasses import dataclass
from dataclasses import field

from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.declare import fixed
from lowsnr_common.settings.declare import setting
from lowsnr_common.settings.flat_values import build_settings
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.flat_values import check_values
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.flat_values import flatten
import pytest


@dataclass(frozen=True, kw_only=True)
class Optics:
    gain: float = setting(1.0, 'amplification', gt=0.0, le=8.0, live=True)

    def __post_init__(self):
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class Camera:
    optics: Optics = field(default_factory=Optics)
    name: str = setting('left', 'which camera', choices=('left', 'right'))
    rows: int = setting(20, 'rows of a frame', ge=1)
    live: bool = setting(True, 'whether frames come by themselves')
    angles_deg: tuple[float, ...] = setting((0.0,), 'angles [deg]', ge=-90.0, lt=90.0)
    helper: int = 3  # no setting: not declared

    def __post_init__(self):
        check_settings(self)


def test_declared_settings_are_those_of_the_class_and_its_groups():
    declared = declared_settings(Camera)
    assert set(declared) == {'optics.gain', 'name', 'rows', 'live', 'angles_deg'}
    assert declared['optics.gain'].doc == 'amplification'
    assert declared['optics.gain'].default == 1.0


def test_instance_is_built_from_flat_values_and_returns_them():
    values = {'optics.gain': 2, 'name': 'right', 'rows': 7, 'angles_deg': [1, 2.5]}
    camera = build_settings(Camera, values)
    assert camera == Camera(
        optics=Optics(gain=2.0), name='right', rows=7, angles_deg=(1.0, 2.5))
    flat = flat_values(camera)
    assert flat == {**values, 'live': True}
    assert build_settings(Camera, flat) == camera


def test_whole_number_for_a_number_becomes_a_number():
    assert isinstance(Optics(gain=2).gain, float)
    assert all(isinstance(angle, float) for angle in Camera(angles_deg=[1, 2]).angles_deg)


@pytest.mark.parametrize('gain', [1e-9, 8.0])
def test_bounds_are_closed_and_open_as_declared(gain):
    assert Optics(gain=gain).gain == gain


@pytest.mark.parametrize(('name', 'value', 'allowed'), [
    ('optics.gain', 0.0, 'a number in (0.0, 8.0]'),
    ('optics.gain', 8.1, 'a number in (0.0, 8.0]'),
    ('optics.gain', float('nan'), 'a number in (0.0, 8.0]'),
    ('optics.gain', float('inf'), 'a number in (0.0, 8.0]'),
    ('optics.gain', 'six', 'a number in (0.0, 8.0]'),
    ('optics.gain', True, 'a number in (0.0, 8.0]'),
    ('optics.gain', None, 'a number in (0.0, 8.0]'),
    ('optics.gain', [1.0], 'a number in (0.0, 8.0]'),
    ('name', 'top', "one of 'left', 'right'"),
    ('name', 1, "one of 'left', 'right'"),
    ('rows', 0, 'a whole number in [1, inf)'),
    ('rows', 2.0, 'a whole number in [1, inf)'),
    ('rows', True, 'a whole number in [1, inf)'),
    ('live', 'yes', 'true or false'),
    ('live', 1, 'true or false'),
    ('angles_deg', 3.0, 'a list of numbers in [-90.0, 90.0)'),
    ('angles_deg', '1, 2', 'a list of numbers in [-90.0, 90.0)'),
    ('angles_deg', [0.0, 90.0], 'a list of numbers in [-90.0, 90.0)'),
    ('angles_deg', [0.0, 'a'], 'a list of numbers in [-90.0, 90.0)'),
])
def test_bad_value_is_refused_by_name_with_the_allowed_ones(name, value, allowed):
    with pytest.raises(ValueError) as caught:
        check_values(Camera, {name: value})
    assert str(caught.value).startswith(f'{name} = {value!r}, ')
    assert allowed in str(caught.value)


def test_constructor_names_class_and_field():
    with pytest.raises(ValueError, match=r'^Camera\.rows = 0, .*\[1, inf\)'):
        Camera(rows=0)


@pytest.mark.parametrize(('name', 'near'), [
    ('row', 'rows'), ('optics.gian', 'optics.gain'), ('angle_deg', 'angles_deg'),
])
def test_misspelt_name_is_refused_with_the_nearest(name, near):
    with pytest.raises(ValueError) as caught:
        build_settings(Camera, {name: 1})
    assert str(caught.value).startswith(f'{name} ')
    assert str(caught.value).endswith(f' {near}?')


@pytest.mark.parametrize('name', ['helper', 'optics', 'zzz', ''])
def test_name_that_is_not_declared_is_refused(name):
    with pytest.raises(ValueError) as caught:
        check_values(Camera, {name: 1})
    assert str(caught.value).startswith(f'{name} ')


def test_nested_mappings_become_flat_names():
    assert flatten({'a': 1, 'b': {'c': 2, 'd': {'e': [3]}}}) == {'a': 1, 'b.c': 2, 'b.d.e': [3]}


@dataclass(frozen=True, kw_only=True)
class Telescope:
    free: Optics = field(default_factory=Optics)
    sealed: Optics = fixed(Optics)
    speed: float = setting(2.0, 'speed', ge=0.0, live=True)
    limit: float = setting(3.0, 'largest speed', live=True)

    def __post_init__(self):
        check_settings(self)
        if self.speed > self.limit:
            raise ValueError('Telescope.speed must not be above limit')


def test_settings_are_live_as_declared_and_never_in_a_fixed_group():
    declared = declared_settings(Telescope)
    assert {name for name, item in declared.items() if item.live} == {
        'free.gain', 'speed', 'limit'}


def test_changed_instance_keeps_other_values_and_ignores_foreign_names():
    before = Telescope(sealed=Optics(gain=3.0), speed=1)
    after = changed(before, {'free.gain': 2, 'limit': 4.0, 'other.gain': 'x'})
    assert after == Telescope(
        free=Optics(gain=2.0), sealed=Optics(gain=3.0), speed=1.0, limit=4.0)
    assert before == Telescope(sealed=Optics(gain=3.0), speed=1.0)


@pytest.mark.parametrize(('values', 'culprit'), [
    ({'free.gain': 9.0}, 'free.gain = 9.0'),
    ({'speed': 3.5}, 'Telescope.speed'),
])
def test_change_out_of_bounds_is_refused(values, culprit):
    with pytest.raises(ValueError) as caught:
        changed(Telescope(), values)
    assert str(caught.value).startswith(culprit)
