# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from ament_flake8.main import main_with_errors
from ament_pep257.main import main as pep257
import pytest

PACKAGE = str(Path(__file__).parents[1])


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8():
    code, errors = main_with_errors(argv=[PACKAGE])
    assert code == 0, '\n'.join(errors)


@pytest.mark.pep257
@pytest.mark.linter
def test_pep257():
    assert pep257(argv=[PACKAGE]) == 0, 'see the captured output'
