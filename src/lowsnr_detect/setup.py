# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
import re
from xml.etree import ElementTree

from setuptools import find_packages
from setuptools import setup

here = Path(__file__).parent
manifest = ElementTree.parse(here / 'package.xml').getroot()
package_name = manifest.findtext('name')
# A detector is one file: its node's entry point follows from how it registers itself there.
detectors = sorted(
    name for file in (here / package_name / 'detectors').glob('*.py')
    for name in re.findall(r"^@?register\('(\w+)'", file.read_text('utf-8'), re.MULTILINE))

setup(
    name=package_name,
    version=manifest.findtext('version'),
    description=manifest.findtext('description'),
    license=manifest.findtext('license'),
    maintainer=manifest.findtext('maintainer'),
    maintainer_email=manifest.find('maintainer').get('email'),
    packages=find_packages(exclude=['test']),
    package_data={
        package_name: ['py.typed', 'calibration/curves/*.json', 'adaptive/tails/*.json']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    entry_points={
        'console_scripts': [
            f'{name}_node = lowsnr_detect.node.detector_node:{name}' for name in detectors],
    },
)
