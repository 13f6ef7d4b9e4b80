# SPDX-License-Identifier: Apache-2.0
"""What the fuzz tests share."""

from pathlib import Path

import pytest


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Return a folder that the inputs of a test use one after the other."""
    return tmp_path
