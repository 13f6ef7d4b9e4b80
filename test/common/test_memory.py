# SPDX-License-Identifier: Apache-2.0
"""Freed memory is used again without a call of the kernel."""

import os
import subprocess
import sys

import pytest

CODE = """
import resource
from threading import Thread
{call}
import numpy as np


def fill():
    np.ones(50_000_000, dtype=np.uint8)


def fill_in_thread():
    thread = Thread(target=fill)
    thread.start()
    thread.join()


def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    {fill}()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


print(faults(), faults())
"""
KEPT = 'from lowsnr_common.core.process_setup import keep_freed_memory; keep_freed_memory()'


def page_faults(call, fill):
    """Return the page faults of filling one array, and of filling the next."""
    found = subprocess.run(
        [sys.executable, '-c', CODE.format(call=call, fill=fill)], capture_output=True,
        text=True, check=True, env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)})
    return [int(word) for word in found.stdout.split()]


@pytest.mark.parametrize('fill', ['fill', 'fill_in_thread'])
def test_array_reuses_the_memory_of_the_array_before(fill):
    first, second = page_faults(KEPT, fill)
    assert second < first / 4


@pytest.mark.parametrize('fill', ['fill', 'fill_in_thread'])
def test_without_the_call_the_kernel_maps_new_pages(fill):
    first, second = page_faults('', fill)
    assert second > first / 4
