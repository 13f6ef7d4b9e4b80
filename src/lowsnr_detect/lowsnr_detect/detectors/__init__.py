# SPDX-License-Identifier: Apache-2.0
"""The detectors, one file each; every module of this folder registers its own."""

from importlib import import_module
import pkgutil

for _module in pkgutil.iter_modules(__path__):
    import_module(f'{__name__}.{_module.name}')
