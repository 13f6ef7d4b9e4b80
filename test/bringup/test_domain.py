# SPDX-License-Identifier: Apache-2.0
"""The claim of a domain: one at a time, and no trap that another user sets in its place."""

import fcntl
import os
import tempfile

from lowsnr_bringup.run.domain import claim_domain
import pytest


@pytest.fixture
def lock(tmp_path, monkeypatch):
    """Return the path of the claim of domain 7, in a folder of the test."""
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    return tmp_path / f'lowsnr-{os.getuid()}-domain-7.lock'


def refusal():
    """Return the line that says why there is no claim."""
    with pytest.raises(ValueError) as caught:
        claim_domain()
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_one_run_at_a_time_has_a_domain(lock):
    with claim_domain():
        assert lock.stat().st_mode & 0o777 == 0o600
        assert 'ROS domain 7:' in refusal()
    claim_domain().close()


def test_link_is_not_followed(lock, tmp_path):
    lock.symlink_to(tmp_path / 'elsewhere')
    assert refusal().startswith(f'{lock}: ')
    assert not (tmp_path / 'elsewhere').exists()


def test_pipe_is_refused_without_waiting_for_its_reader(lock):
    os.mkfifo(lock)
    assert refusal().startswith(f'{lock}: ')
    reader = os.open(lock, os.O_RDONLY | os.O_NONBLOCK)
    assert refusal().startswith(f'{lock}: ')
    os.close(reader)


def test_file_of_another_user_is_refused(lock, monkeypatch):
    lock.touch()
    monkeypatch.setattr(os, 'getuid', lambda: lock.stat().st_uid + 1)
    other = lock.with_name(f'lowsnr-{os.getuid()}-domain-7.lock')
    other.touch()
    with other.open('a') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        said = refusal()  # of the file, not of its lock
        assert said.startswith(f'{other}: ')
        assert 'TMPDIR' in said


def test_parts_of_one_run_share_a_domain_with_no_whole_run(lock):
    with claim_domain(shared=True), claim_domain(shared=True):
        assert 'ROS domain 7:' in refusal()
    claim_domain().close()
