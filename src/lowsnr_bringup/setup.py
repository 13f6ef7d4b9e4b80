# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages
from setuptools import setup

here = Path(__file__).parent
manifest = ElementTree.parse(here / 'package.xml').getroot()
package_name = manifest.findtext('name')
commands = ('bringup', 'calibrate', 'convert', 'evaluate', 'learn_noise', 'reproduce')


def shared(pattern: str) -> tuple[str, list[str]]:
    """Return folder and files of what is installed into the share of the package."""
    files = sorted(path.relative_to(here) for path in here.glob(pattern) if path.is_file())
    return f'share/{package_name}/{Path(pattern).parent}', list(map(str, files))


setup(
    name=package_name,
    version=manifest.findtext('version'),
    description=manifest.findtext('description'),
    license=manifest.findtext('license'),
    maintainer=manifest.findtext('maintainer'),
    maintainer_email=manifest.find('maintainer').get('email'),
    packages=find_packages(exclude=['test']),
    package_data={package_name: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        *map(shared, ('config/*', 'config/scenarios/*', 'scripts/[!t]*.py', 'scripts/*.json',
                      'requirements/*')),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    entry_points={
        'console_scripts': [
            *(f'{name} = {package_name}.cli.commands:{name}' for name in commands),
            'player_node = lowsnr_bringup.player_node:main',
            'recorder_node = lowsnr_bringup.recorder_node:main',
        ],
    },
)
