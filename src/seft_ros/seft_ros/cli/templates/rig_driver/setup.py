"""Installation of rig_driver, by colcon or by pip."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "rig_driver"

setup(
    name=NAME,
    version="0.1.0",
    description="Driver of a laboratory's rig: the node rig of a substructure force test",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{part}", [str(file) for file in Path(part).glob("*.*")])
            for part in ("config", "launch", "urdf")
        ),
    ],
    install_requires=["numpy", "seft_msgs_py", "seft_plant_sim"],
    entry_points={"console_scripts": ["rig = rig_driver.driver_node:main"]},
    zip_safe=False,
)
