from pathlib import Path
import re

from setuptools import find_packages
from setuptools import setup

package_name = 'lowsnr_detect'
# A detector is one file: its node's entry point follows from how it registers itself there.
files = (Path(__file__).parent / package_name / 'detectors').glob('*.py')
detectors = sorted(
    name for file in files
    for name in re.findall(r"^@?register\('(\w+)'", file.read_text('utf-8'), re.MULTILINE))

setup(
    name=package_name,
    version='0.1.0',
    description='Sections III, IV-A and V: detectors, calibration, detector node.',
    license='Apache-2.0',
    maintainer='lowsnr maintainers',
    maintainer_email='maintainers@lowsnr.example',
    packages=find_packages(exclude=['test']),
    package_data={package_name: ['py.typed']},
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
