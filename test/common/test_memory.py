"""Memory that is freed is used again, without the kernel's doing."""

import os
import subprocess
import sys

CODE = """
import resource
{call}
import numpy as np


def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(50_000_000, dtype=np.uint8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


print(faults(), faults())
"""
KEPT = 'from lowsnr_common.ros.memory import keep_freed_memory; keep_freed_memory()'


def page_faults(call):
    """Return the page faults of filling an array, and of filling the next."""
    found = subprocess.run(
        [sys.executable, '-c', CODE.format(call=call)], capture_output=True, text=True,
        check=True, env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)})
    return [int(word) for word in found.stdout.split()]


def test_array_takes_the_memory_of_the_one_before():
    first, second = page_faults(KEPT)
    assert second < first / 4


def test_it_would_be_mapped_anew_otherwise():
    first, second = page_faults('')
    assert second > first / 2
