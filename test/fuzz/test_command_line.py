# SPDX-License-Identifier: Apache-2.0
"""Any arguments of any script are accepted, or end it with one line and a usage error."""

import contextlib
import io
from pathlib import Path

import bringup
import calibrate
import convert
import evaluate
from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.strategies import numbers
from fuzz.strategies import whole
from fuzz.strategies import wild_names
from hypothesis import strategies as st
from lowsnr_bringup.plan import config_files
from lowsnr_bringup.plan import run_plan
from lowsnr_bringup.run.domain import claim_domain
import pytest
import reproduce

USAGE = 2
OPTIONS = {
    bringup: ['--detector', '--scenario', '--replay', '--snr', '--frames', '--seed', '--set',
              '--frames-topic', '--truth-topic', '--condition', '--rate', '--lockstep', '--loop',
              '--record', '--storage', '--view', '--view-port', '--results',
              '--domain-id'],
    calibrate: ['--detector', '--scenario', '--snr', '--false-alarm-prob', '--rows', '--cols',
                '--set'],
    convert: ['--out', '--truth', '--rate', '--period', '--storage'],
    evaluate: ['--results', '--frames-topic', '--truth-topic'],
    reproduce: ['--example', '--all', '--runs', '--snr', '--detector', '--seed', '--jobs',
                '--scheduler', '--results', '--resume']}
values = (numbers | whole).map(lambda n: f'{n:g}' if isinstance(n, float) else str(n)[:500]) | (
    wild_names) | st.sampled_from([
        'sdt', 'cdt', 'example4', 'mcap', 'on', 'tracker.particles=1', '9' * 400, '9' * 5000])


@st.composite
def commands(draw, scripts=tuple(OPTIONS)):
    """Draw a script and arguments for it."""
    script = draw(st.sampled_from(scripts))
    words = draw(st.lists(st.tuples(
        st.sampled_from(OPTIONS[script]), st.lists(values, max_size=2)), max_size=4))
    return script, [word for option, given in words for word in (option, *given)] + draw(
        st.lists(values, max_size=1))


def parsed(script, arguments):
    """Return the options, or None if the script ends with a line that names the culprit."""
    stderr = io.StringIO()
    try:
        with contextlib.redirect_stderr(stderr), contextlib.redirect_stdout(io.StringIO()):
            return script.parse_arguments(arguments)
    except SystemExit as end:
        code = end.code
    assert code in (0, USAGE)
    assert 'Traceback' not in stderr.getvalue()
    return None


@fuzz('command lines', 900, command=commands())
def test_arguments_are_accepted_or_refused(command):
    parsed(*command)


@pytest.fixture
def config(monkeypatch):
    """Read the configuration once, not for every plan."""
    whole_config = config_files.load_config(bringup.CONFIG)
    monkeypatch.setattr(run_plan, 'load_config', lambda folder: whole_config)


@fuzz('planned runs', 180, command=commands((bringup,)))
def test_run_is_planned_or_refused(config, place, monkeypatch, command):
    monkeypatch.chdir(place)
    options = parsed(*command)
    if options is None:
        return
    if options.record is not None:
        options.record = Path('bag')
    plan = tried('', bringup.plan_of, options)
    if plan is not None:
        assert Path(plan.name).name == plan.name


@fuzz('domains', 180, number=wild_names.filter(lambda text: '\0' not in text) | values)
def test_domain_is_claimed_or_refused(monkeypatch, number):
    with monkeypatch.context() as patch:
        patch.setenv('ROS_DOMAIN_ID', number.replace('\0', '').encode(
            'utf-8', 'replace').decode()[:1000])
        if (claim := tried('', claim_domain)) is not None:
            claim.close()
