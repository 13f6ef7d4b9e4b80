# SPDX-License-Identifier: Apache-2.0
"""
Configuration of Sphinx for the manual: ``python scripts/manual.py`` builds it.

`extensions/` beside this file writes the page of every node and checks that the API is complete.
The tutorials, concepts and figures are scripts, which the build runs.
"""

import logging
import os
from pathlib import Path
import sys

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PACKAGES = sorted(path for path in (ROOT / 'src').glob('lowsnr*'))
sys.path[:0] = [str(DOCS / 'extensions'), str(DOCS), str(ROOT / 'test'), *map(str, PACKAGES)]

import lowsnr  # noqa: E402
from support.graph_runs import own_domain  # noqa: E402

# The graphs of the tutorials are on a domain that no other build or test has.
os.environ['ROS_DOMAIN_ID'] = str(own_domain())
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['PYTHONPATH'] = os.pathsep.join(map(str, PACKAGES))

logging.getLogger('lowsnr').setLevel(logging.WARNING)  # calibrations say what they do

project = author = 'lowsnr'
copyright = 'the lowsnr authors, Apache-2.0'  # noqa: A001
release = version = lowsnr.__version__
extensions = [
    'myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.apidoc', 'sphinx.ext.napoleon',
    'sphinx.ext.viewcode', 'node_pages', 'sphinx_gallery.gen_gallery', 'mathml', 'offline',
    'public_names', 'repository_links', 'stale_pages',
]
exclude_patterns = [
    'concepts', 'tutorials', 'gallery', 'extensions', 'generated/api/*/modules.rst',
    '**sg_execution_times.rst']
default_role = 'code'
highlight_language = 'none'  # a block names its language, and most are output
myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4

# The API: one page a folder of modules.
apidoc_modules = [
    {'path': f'../src/{path.name}/{path.name}', 'destination': f'generated/api/{path.name}',
     'module_first': True, 'include_private': False,
     'automodule_options': {'members', 'undoc-members', 'show-inheritance'}}
    for path in PACKAGES]
autodoc_member_order = 'bysource'
autodoc_typehints = 'signature'
autodoc_typehints_format = 'short'
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_param = False
napoleon_use_rtype = False

sphinx_gallery_conf = {
    'examples_dirs': ['concepts', 'tutorials', 'gallery'],
    'gallery_dirs': ['generated/concepts', 'generated/tutorials', 'generated/gallery'],
    'filename_pattern': '/',
    'run_stale_examples': True,  # what they show depends on all sources
    'abort_on_example_error': True,
    'download_all_examples': False,
    'min_reported_time': 1e9,
    'show_memory': False,
    'write_computation_times': False,
    'show_signature': False,
    'within_subsection_order': 'FileNameSortKey',
    'plot_gallery': 'True',
}

html_theme = 'furo'
html_title = f'lowsnr {release}'
html_static_path = ['static']
html_css_files = ['facts.css']
html_copy_source = False
html_show_sphinx = False
