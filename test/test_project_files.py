# SPDX-License-Identifier: Apache-2.0
"""Containers, workflows, templates and citation: valid, and about what this repository has."""

import json
from pathlib import Path
import re
import subprocess
import sys

import _environment
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
FORGE = ROOT / '.github'
DOCKERFILES = ['Dockerfile', '.devcontainer/Dockerfile']
SCHEMAS = {
    'vendor.github-workflows': FORGE / 'workflows' / 'test.yml',
    'vendor.github-issue-forms': FORGE / 'ISSUE_TEMPLATE' / 'bug.yml',
    'vendor.github-issue-config': FORGE / 'ISSUE_TEMPLATE' / 'config.yml',
    'vendor.citation-file-format': ROOT / 'CITATION.cff'}


def jobs():
    """Return the jobs of the workflow."""
    return yaml.safe_load(SCHEMAS['vendor.github-workflows'].read_text('utf-8'))['jobs']


def check(schema, path, require_program):
    """Return the exit code of the validation of a file against a schema."""
    program = require_program(str(Path(sys.executable).with_name('check-jsonschema')))
    return subprocess.run(
        [program, '--builtin-schema', schema, path], capture_output=True, timeout=60.0,
        check=False).returncode


@pytest.mark.parametrize('schema', SCHEMAS)
def test_file_fits_its_schema(schema, require_program, tmp_path):
    assert check(schema, SCHEMAS[schema], require_program) == 0
    broken = tmp_path / SCHEMAS[schema].name
    broken.write_text(SCHEMAS[schema].read_text('utf-8') + '\nno_such_key: [1]\n')
    assert check(schema, broken, require_program) == 1


def test_workflow_runs_on_every_python_with_wheels_and_on_an_installed_ros():
    found = jobs()
    assert found['wheels']['strategy']['matrix']['python'] == sorted(_environment.WITH_WHEELS)
    assert found['jazzy']['container'].startswith('ros:jazzy')
    for job in ('wheels', 'jazzy'):
        assert any('.ci/run' in step.get('run', '') for step in found[job]['steps'])


def test_workflow_names_files_that_are_there():
    named = {word for job in jobs().values() for step in job['steps']
             for word in re.findall(r'(?<!\S)[.\w]+/[\w./-]+|Dockerfile', step.get('run', ''))
             if not word.startswith('/')}
    assert named >= {'.ci/run', *DOCKERFILES}
    assert not [word for word in named if not (ROOT / word).exists()]


@pytest.mark.parametrize('name', DOCKERFILES)
def test_container_is_made_of_the_jazzy_image(name):
    text = (ROOT / name).read_text('utf-8')
    assert re.findall('^FROM (.+)$', text, re.MULTILINE) == ['ros:jazzy-ros-base']
    assert re.findall(r'^USER \d+$', text, re.MULTILINE)
    joined = re.sub(r'^#.*\n', '', text, flags=re.MULTILINE).replace('\\\n', '')
    known = ('FROM ', 'SHELL ', 'WORKDIR ', 'COPY ', 'RUN ', 'USER ', 'ENTRYPOINT ', 'CMD ')
    assert all(line.startswith(known) for line in joined.splitlines() if line.strip())
    for words in re.findall(r'^(?:ENTRYPOINT|CMD|SHELL) (.+)$', joined, re.MULTILINE):
        assert all(isinstance(word, str) for word in json.loads(words))


def test_development_container_uses_its_file_and_the_tests():
    text = (ROOT / '.devcontainer' / 'devcontainer.json').read_text('utf-8')
    settings = json.loads(text)
    assert (ROOT / '.devcontainer' / settings['build']['dockerfile']).is_file()
    assert (ROOT / re.search(r'scripts/\w+\.py', settings['postCreateCommand'])[0]).is_file()


def test_citation_names_the_software_and_the_paper():
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text('utf-8'))
    assert (citation['title'], citation['license']) == ('lowsnr', 'Apache-2.0')
    (paper,) = citation['references']
    assert paper['authors'][0]['family-names'] == 'Rezaie'
    assert paper['title'] in (ROOT / 'README.md').read_text('utf-8')
