# SPDX-License-Identifier: Apache-2.0
"""A system whose sockets hold too little for large frames is told how to let them hold more."""

from lowsnr_common.images.receive_buffer import remedy
from lowsnr_common.images.receive_buffer import WANTED_BYTES
import pytest


@pytest.mark.parametrize('allowed', [212992, WANTED_BYTES - 1])
def test_limit_that_is_too_low_is_named_with_the_command_that_raises_it(tmp_path, allowed):
    (tmp_path / 'limit').write_text(f'{allowed}\n')
    said = remedy(tmp_path / 'limit')
    assert f'{allowed / 1e6:.1f} MB' in said
    assert said.endswith(f'sysctl -w net.core.rmem_max={WANTED_BYTES}')


@pytest.mark.parametrize('content', [str(WANTED_BYTES), str(2**31 - 1), '', 'unlimited', None])
def test_limit_that_is_high_enough_or_unknown_is_not_spoken_of(tmp_path, content):
    if content is not None:
        (tmp_path / 'limit').write_text(content)
    assert remedy(tmp_path / 'limit') == ''
