# SPDX-License-Identifier: Apache-2.0
"""Every registered detector keeps the contract."""

from pathlib import Path
import re

from detect.contract import CHECKS
from lowsnr_detect import detectors
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_detect.parts.registry import register
import pytest

FILES = sorted(Path(*detectors.__path__).glob('[!_]*.py'))


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_file_registers_its_detectors(path):
    names = re.findall(r"^@register\('(\w+)'\)", path.read_text(encoding='utf-8'), re.MULTILINE)
    assert names
    for name in names:
        assert DETECTORS[name].__module__ == f'lowsnr_detect.detectors.{path.stem}'


@pytest.mark.parametrize('check', CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_detector(name, check):
    check(detector_class(name))


def test_name_is_registered_once():
    with pytest.raises(ValueError, match='sdt'):
        register('sdt')(detector_class('cdt'))


def test_unknown_detector_is_named_with_the_nearest():
    with pytest.raises(ValueError, match="'cusun'.* cusum"):
        detector_class('cusun')
