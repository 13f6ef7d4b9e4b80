from setuptools import find_packages
from setuptools import setup

package_name = 'lowsnr_eval'

setup(
    name=package_name,
    version='0.1.0',
    description='Section VI: scoring, Monte Carlo studies and reports.',
    license='Apache-2.0',
    maintainer='lowsnr maintainers',
    maintainer_email='maintainers@lowsnr.example',
    packages=find_packages(exclude=['test']),
    package_data={package_name: ['py.typed', 'report/assets/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'evaluator_node = lowsnr_eval.evaluator_node:main',
            'viewer_node = lowsnr_eval.viewer_node:main',
        ],
    },
)
