# SPDX-License-Identifier: Apache-2.0
"""Compiled loops: where loops are only loaded, one that is not on disk is refused."""

import importlib
import sys

from lowsnr_common.core import compiled
import pytest

MODULE = """
from lowsnr_common.core.compiled import compiled
@compiled
def doubled(x):
    return 2 * x
"""


@pytest.fixture
def loop(tmp_path, monkeypatch):
    """Return a function that gives a loop of a new file, as the next process would have it."""
    (tmp_path / 'loop_for_test.py').write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(compiled, '_DISPATCHERS', [])

    def fresh():
        sys.modules.pop('loop_for_test', None)
        return importlib.import_module('loop_for_test').doubled

    yield fresh
    sys.modules.pop('loop_for_test', None)


def test_loop_is_refused_until_it_is_on_disk(loop):
    first = loop()
    with pytest.raises(compiled.NotOnDisk), compiled.loading_only():
        first(3)
    assert first(3) == 6  # outside it is compiled, and written
    with compiled.loading_only():
        assert loop()(3) == 6
        with pytest.raises(compiled.NotOnDisk):
            loop()(3.0)  # for another type it is another loop
    assert compiled.variants() == 2
