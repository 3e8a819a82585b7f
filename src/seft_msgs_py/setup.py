"""Installation of seft_msgs_py, by colcon or by pip."""

from setuptools import find_packages, setup

NAME = "seft_msgs_py"

setup(
    name=NAME,
    version="0.1.0",
    description="The wire of a substructure effective force test: topics, samples <-> bytes",
    maintainer="Seed e22a9f6a maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-e22a9f6a.example",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "node/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["greenlet>=3.0.3", "numpy>=1.26", "rosbags>=0.11", "ruamel.yaml>=0.17.21"],
    extras_require={"test": ["hypothesis>=6.98", "pytest>=7.4"]},
    zip_safe=False,
)
