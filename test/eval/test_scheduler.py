# SPDX-License-Identifier: Apache-2.0
"""Connections to a dask scheduler: only to this machine, or with TLS that authenticates."""

import math
import re
import subprocess

from certificates import make_certificates
from dask_cluster import dask_cluster
from lowsnr_eval.study import scheduler
from lowsnr_eval.study.workers import TlsFiles
from lowsnr_eval.study.workers import workers
import pytest
import reproduce


@pytest.fixture(scope='module')
def files(tmp_path_factory, require_program):
    """Return the files of two authorities, by the name of the authority."""
    folder = tmp_path_factory.mktemp('tls')
    return {name: make_certificates(require_program('openssl'), folder / name)
            for name in ('own', 'other')}


def tls_of(found):
    return TlsFiles(found['ca'], found['cert'], found['key'])


def test_workers_are_reached_by_tls_with_the_right_certificates_only(
        files, tmp_path, monkeypatch):
    results = {}
    with dask_cluster(tmp_path, 1, files['own']) as (address, _):
        with workers(1, address, print, tls_of(files['own'])) as found:
            found.run(math.sqrt, {'a': (4.0,)}, results.__setitem__)
        monkeypatch.setattr(scheduler, '_TIMEOUT_S', 2.0)
        for tls in (tls_of(files['other']), None):
            with pytest.raises(ValueError, match=address), workers(1, address, print, tls):
                pass
    assert results == {'a': 2.0}


@pytest.mark.parametrize(('address', 'needs_tls'), [
    ('127.0.0.1:8786', False), ('tcp://127.0.0.1:8786', False), ('localhost:8786', False),
    ('[::1]:8786', False), ('192.0.2.1:8786', True), ('tcp://192.0.2.1:8786', True),
    ('0.0.0.0:8786', True), ('tls://127.0.0.1:8786', True), (':8786', True),
    ('127.0.0.1.example.invalid:8786', True)])
def test_address_without_tls_must_be_of_this_machine(address, needs_tls):
    if needs_tls:
        with pytest.raises(ValueError, match='--tls-ca'):
            scheduler._checked_address(address, None)
    else:
        assert scheduler._checked_address(address, None) == f'tcp://{address.split("/")[-1]}'


def test_address_with_tls_is_never_reached_without(files):
    tls = tls_of(files['own'])
    assert scheduler._checked_address('192.0.2.1:8786', tls) == 'tls://192.0.2.1:8786'
    for address in ('tcp://127.0.0.1:8786', 'tcp://192.0.2.1:8786', 'ucx://192.0.2.1:8786'):
        with pytest.raises(ValueError, match=address):
            scheduler._checked_address(address, tls)


@pytest.mark.parametrize(('name', 'fault'), [
    *((name, fault) for name in ('ca', 'cert', 'key')
      for fault in ('missing', 'folder', 'garbage')),
    ('cert', 'of another'), ('key', 'of another'), ('key', 'with a password')])
def test_file_of_tls_that_cannot_be_used_is_named(
        files, tmp_path, name, fault, require_program):
    (tmp_path / 'garbage').write_bytes(b'\xff\0no certificate')
    path = {
        'folder': tmp_path, 'of another': files['other'][name]}.get(fault, tmp_path / fault)
    if fault == 'with a password':
        subprocess.run(
            [require_program('openssl'), 'pkey', '-in', files['own']['key'], '-aes256',
             '-passout', 'pass:secret', '-out', path], check=True, capture_output=True)
    with pytest.raises(ValueError, match=re.escape(str(path))) as caught:
        scheduler._security(tls_of({**files['own'], name: path}))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize('arguments', [
    ('--tls-ca', 'a'), ('--tls-ca', 'a', '--tls-cert', 'b', '--tls-key', 'c'),
    ('--scheduler', '127.0.0.1:9', '--tls-ca', 'a', '--tls-key', 'c')])
def test_options_of_tls_belong_together(tmp_path, capsys, arguments):
    assert reproduce.reproduce(
        ['--example', '2', '--results', str(tmp_path), *arguments]) == 2
    line, = capsys.readouterr().err.splitlines()
    assert '--tls-cert' in line
    assert not list(tmp_path.iterdir())
