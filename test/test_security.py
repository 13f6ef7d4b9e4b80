# SPDX-License-Identifier: Apache-2.0
"""What no source may do: run text as code, unpickle, load YAML that makes objects, use a shell."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('benchmarks', 'scripts', 'src', 'test')
CODE = {'eval', 'exec', 'compile', '__import__'}
UNSAFE = {
    'os.system', 'os.popen', 'subprocess.getoutput', 'subprocess.getstatusoutput',
    'pickle.load', 'pickle.loads', 'pickle.Unpickler', 'marshal.load', 'marshal.loads',
    'shelve.open', 'tempfile.mktemp', 'yaml.load', 'yaml.load_all', 'yaml.full_load',
    'yaml.unsafe_load'}
# What may be called by no name but its own, so that the names above are all there are.
WHOLE = {'marshal', 'os', 'pickle', 'shelve', 'subprocess', 'tempfile', 'yaml'}


def unsafe(source):
    """Yield what a source does that none may."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module in WHOLE:
            for alias in node.names:
                if f'{node.module}.{alias.name}' in UNSAFE or alias.name == '*':
                    yield f'line {node.lineno}: from {node.module} import {alias.name}'
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in WHOLE and alias.asname:
                    yield f'line {node.lineno}: import {alias.name} as {alias.asname}'
        elif isinstance(node, ast.Attribute) and ast.unparse(node) in UNSAFE:
            yield f'line {node.lineno}: {ast.unparse(node)}'
        elif isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in CODE:
                yield f'line {node.lineno}: {node.func.id}()'
            for keyword in node.keywords:
                no = isinstance(keyword.value, ast.Constant) and keyword.value.value is False
                if keyword.arg in ('shell', 'allow_pickle') and not no:
                    yield f'line {node.lineno}: {keyword.arg}={ast.unparse(keyword.value)}'


def test_no_source_is_unsafe():
    paths = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob('*.py'))
    assert len(paths) > 100
    found = [f'{path.relative_to(ROOT)}: {what}'
             for path in paths for what in unsafe(path.read_text(encoding='utf-8'))]
    assert not found, '\n'.join(found)


@pytest.mark.parametrize('source', [
    'eval(text)', 'exec(text)', '__import__(name)', 'import os\nos.system(text)',
    'import subprocess\nsubprocess.run(text, shell=True)', 'run(text, shell=flag)',
    'import yaml\nyaml.load(text)', 'from yaml import unsafe_load', 'import yaml as y',
    'import pickle\npickle.loads(data)', 'from pickle import *',
    'np.load(path, allow_pickle=True)', 'import tempfile\ntempfile.mktemp()'])
def test_what_is_unsafe_is_seen(source):
    assert list(unsafe(source))


@pytest.mark.parametrize('source', [
    'import yaml\nyaml.safe_load(text)', 'np.load(path, allow_pickle=False)',
    'import subprocess\nsubprocess.run([program], shell=False)',
    'import pickle\nkey = pickle.dumps(x)', 'executor.exec(x)', 're.compile(x)'])
def test_what_is_safe_is_not(source):
    assert not list(unsafe(source))
