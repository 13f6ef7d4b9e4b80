# SPDX-License-Identifier: Apache-2.0
"""How often, and after what wait, a node that died is started again."""

from lowsnr_bringup.ros.respawner import Deaths
from lowsnr_bringup.ros.respawner import RespawnPolicy
import pytest

POLICY = RespawnPolicy(most=4, window_s=60.0, wait_s=0.5)


def test_waits_double_and_then_the_node_is_given_up():
    deaths = Deaths(POLICY)
    assert [deaths.add(float(k)) for k in range(5)] == [0.0, 0.5, 1.0, 2.0, None]
    assert deaths.count == 5


@pytest.mark.parametrize('apart_s', [16.0, 20.0, 61.0])
def test_a_node_that_dies_now_and_then_always_comes_back(apart_s):
    deaths = Deaths(POLICY)
    waits = [deaths.add(k * apart_s) for k in range(200)]
    assert None not in waits
    # Four deaths 16 s apart lie within a minute, three 20 s apart and the one a minute ago.
    assert max(waits) == {16.0: 2.0, 20.0: 2.0, 61.0: 0.0}[apart_s]


def test_old_deaths_are_forgotten():
    deaths = Deaths(POLICY)
    assert [deaths.add(float(k)) for k in range(4)] == [0.0, 0.5, 1.0, 2.0]
    assert deaths.add(100.0) == 0.0
