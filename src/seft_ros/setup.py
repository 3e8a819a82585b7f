"""Installation of seft_ros, by colcon or by pip."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "seft_ros"
NODES = ("ground_motion", "reference_force", "force_controller", "loop", "supervisor", "recorder")


def experiments() -> list[tuple[str, list[str]]]:
    """List the project's config folder, which the link beside this file points at."""
    files = sorted(path for path in Path("config").rglob("*") if path.is_file())
    return [(f"share/{NAME}/{path.parent}", [str(path)]) for path in files]


setup(
    name=NAME,
    version="0.1.0",
    description="Substructure effective force testing (SEFT) on ROS 2: nodes, analysis, command",
    maintainer="Seed e22a9f6a maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-e22a9f6a.example",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=find_packages(exclude=["test"]),
    package_data={
        NAME: ["py.typed", "drawing/templates/*", "cli/templates/**/*", "monitor/assets/*"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/experiment.launch.py"]),
        (f"share/{NAME}/layouts", ["layouts/foxglove.json", "layouts/plotjuggler.xml"]),
        *experiments(),
    ],
    install_requires=[
        "bokeh>=3.10",
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "mcap>=1.6",
        "numba>=0.59",
        "numpy>=1.26",
        "rich>=13.7",
        "rosbags>=0.11",
        "ruamel.yaml>=0.17.21",
        "scipy>=1.11",
        "seft_msgs_py",
        "seft_plant_sim",
        "setproctitle>=1.3",
        "tornado>=6.4",
        "typer>=0.9",
        "zstandard>=0.25",
    ],
    extras_require={
        "dask": ["distributed>=2026.8"],
        "motions": ["obspy>=1.5"],
        "opensees": ["seft_plant_sim[opensees]"],
        "test": ["hypothesis>=6.98", "pytest>=7.4", "pyyaml>=6.0"],
    },
    entry_points={
        "console_scripts": [
            "seft = seft_ros.cli.main:main",
            *(f"{node} = seft_ros.nodes.{node}_node:main" for node in NODES),
        ]
    },
    zip_safe=False,
)
