from setuptools import find_packages
from setuptools import setup

package_name = 'lowsnr_sensor'

setup(
    name=package_name,
    version='0.1.0',
    description='Section II: scenarios, simulated sensor, conditioning of real frames.',
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
            'conditioner_node = lowsnr_sensor.conditioner_node:main',
            'sensor_node = lowsnr_sensor.sensor_node:main',
        ],
    },
)
