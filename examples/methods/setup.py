"""Installation of seft_methods, by pip or by colcon."""

from setuptools import setup

setup(
    name="seft_methods",
    version="0.1.0",
    description="Compensation methods of the literature for seft",
    author="Seed e22a9f6a maintainers",
    author_email="maintainers@users.noreply.h-seed-e22a9f6a.example",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=["seft_methods"],
    package_data={"seft_methods": ["py.typed"]},
    install_requires=["numpy>=1.26", "seft_msgs_py", "seft_plant_sim", "seft_ros"],
    extras_require={"test": ["hypothesis>=6.98", "pytest>=7.4", "scipy>=1.11"]},
    entry_points={
        "seft.compensation": [
            "polynomial = seft_methods.methods:polynomial",
            "linear_acceleration = seft_methods.methods:linear_acceleration",
            "smith = seft_methods.methods:smith",
            "inverse = seft_methods.methods:inverse",
            "ats = seft_methods.time_series:Ats",
        ]
    },
    zip_safe=False,
)
