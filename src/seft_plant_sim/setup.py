"""Installation of seft_plant_sim, by colcon or by pip."""

from setuptools import find_packages, setup

NAME = "seft_plant_sim"

setup(
    name=NAME,
    version="0.1.0",
    description="Simulated rig of a substructure effective force test, and its exact reference",
    maintainer="Seed e22a9f6a maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-e22a9f6a.example",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["numba>=0.59", "numpy>=1.26", "scipy>=1.11", "seft_msgs_py"],
    extras_require={"opensees": ["openseespy>=3.8"], "test": ["hypothesis>=6.98", "pytest>=7.4"]},
    entry_points={
        "console_scripts": ["rig = seft_plant_sim.rig_node:main"],
        "seft.computed_model": ["opensees = seft_plant_sim.computed.opensees:OpenSees"],
    },
    zip_safe=False,
)
