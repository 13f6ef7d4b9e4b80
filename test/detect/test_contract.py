"""Every registered detector keeps the contract, and so does the one of CONTRIBUTING.md."""

import importlib.util
from pathlib import Path
import re

from detect.contract import CHECKS
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
import pytest

EIGHT = ('cdt', 'cusum', 'hmm', 'mmtbd1', 'mmtbd2', 'sdt', 'tbd1', 'tbd2')
CONTRIBUTING = Path(__file__).resolve().parents[2] / 'CONTRIBUTING.md'


def test_eight_detectors_are_registered():
    assert detector_class('sdt')
    assert sorted(DETECTORS) == list(EIGHT)


@pytest.mark.parametrize('check', CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize('name', EIGHT)
def test_detector(name, check):
    check(detector_class(name))


@pytest.fixture
def ninth(tmp_path, monkeypatch):
    """Return the detector that CONTRIBUTING.md shows, from a file of its own."""
    monkeypatch.setattr('lowsnr_detect.parts.registry.DETECTORS', dict(DETECTORS))
    (source,) = re.findall(
        r'```python\n(.*?)```', CONTRIBUTING.read_text(encoding='utf-8'), re.DOTALL)
    path = tmp_path / 'memory.py'
    path.write_text(source, encoding='utf-8')
    spec = importlib.util.spec_from_file_location('memory', path)
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
    (name,) = re.findall(r"^@register\('(\w+)'\)", source, re.MULTILINE)
    return name


def test_ninth_detector_is_one_file_that_keeps_the_contract(ninth):
    cls = detector_class(ninth)
    for check in CHECKS:
        check(cls)


def test_unknown_detector_is_named_with_the_nearest():
    with pytest.raises(ValueError, match="detector 'cusun' is not one of .*did you mean cusum?"):
        detector_class('cusun')
