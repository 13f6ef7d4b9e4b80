# SPDX-License-Identifier: Apache-2.0
"""A run is planned without the libraries that only its nodes use, so that it starts soon."""

import os
import subprocess
import sys

CODE = """
import sys
import lowsnr_bringup.plan.confirmation
import lowsnr_bringup.plan.run_plan
print(*sorted(name for name in sys.modules if name in (
    'numba', 'scipy.fft', 'scipy.ndimage', 'scipy.optimize', 'scipy.sparse', 'scipy.special')))
"""


def test_planning_imports_no_part_of_scipy():
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, '-c', CODE], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == '\n'
