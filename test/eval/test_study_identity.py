# SPDX-License-Identifier: Apache-2.0
"""The identity of a study changes with every value that the study depends on."""

import copy
from dataclasses import fields
from dataclasses import is_dataclass
from dataclasses import replace
import json
import math
from pathlib import Path

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies
from lowsnr_eval.study.study import StudyOptions
from lowsnr_eval.study.study_identity import differences
from lowsnr_eval.study.study_identity import identity
from lowsnr_eval.study.study_plan import plan_study
import numpy as np
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'
OPTIONS = StudyOptions(example=5, runs=3, snrs_db=(9.0,), detectors=('sdt', 'mmtbd2'))


@pytest.fixture(scope='module')
def study():
    return plan_study(OPTIONS, CONFIG)


def leaves(value, path=()):
    """Yield the path of every value in nested dataclasses and tuples: attributes and indices."""
    if is_dataclass(value):
        for item in fields(value):
            yield from leaves(getattr(value, item.name), (*path, item.name))
    elif isinstance(value, tuple) and value:
        for n, item in enumerate(value):
            yield from leaves(item, (*path, n))
    else:
        yield path


def at(value, path):
    for step in path:
        value = value[step] if isinstance(step, int) else getattr(value, step)
    return value


def with_value(value, path, new):
    """Return a copy with another value at a path; nothing checks whether it is allowed."""
    if not path:
        return new
    inner = with_value(at(value, path[:1]), path[1:], new)
    if isinstance(path[0], int):
        return (*value[:path[0]], inner, *value[path[0] + 1:])
    changed = copy.copy(value)
    object.__setattr__(changed, path[0], inner)
    return changed


def another(value):
    """Return a strategy for values that differ from a value, of its type."""
    kinds = {
        bool: strategies.booleans(), int: strategies.integers(), float: strategies.floats(),
        str: strategies.text(), tuple: strategies.tuples(strategies.floats()),
        type(None): strategies.integers()}

    def differs(new):
        both_nan = new != new and value != value
        return not both_nan and (new != value or type(new) is not type(value))

    return kinds[type(value)].filter(differs)


@settings(max_examples=200, deadline=None)
@given(data=strategies.data())
def test_changing_any_value_changes_the_identity(study, data):
    path = data.draw(strategies.sampled_from(sorted(leaves(study), key=str)))
    changed = with_value(study, path, data.draw(another(at(study, path))))
    found = differences(identity(study), identity(changed))
    name = ''.join(f'[{step}]' if isinstance(step, int) else f'.{step}' for step in path)
    assert {key.startswith(f'study{name}') for key in found} == {True}
    # What a folder keeps is the same after it was written and read.
    kept = json.loads(json.dumps(identity(changed), allow_nan=False))
    assert differences(kept, identity(changed)) == {}


def test_changing_a_class_or_an_element_of_an_array_changes_the_identity(study):
    arrays = np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, math.ulp(0.0)]])
    one, other = (identity(replace(study, labels=array)) for array in arrays)
    assert list(differences(one, other)) == ['study.labels']
    assert list(differences(one, identity(replace(study, labels=np.zeros((3, 2)))))) == [
        'study.labels']

    class Options(StudyOptions):
        pass

    other = replace(study, options=Options(**vars(OPTIONS)))
    assert list(differences(identity(study), identity(other))) == ['study.options.class']
    with pytest.raises(TypeError, match='labels'):
        identity(replace(study, labels={'cdt'}))
