"""What a package imports is what its setup.py and its package.xml name, and nothing else."""

import ast
import re
import sys
from functools import cache
from importlib.metadata import requires
from pathlib import Path
from xml.etree import ElementTree

import pytest
from graph_tools import ROOT
from packaging.requirements import Requirement
from seft_ros.cli.rig_commands import TEMPLATES

OURS = ("seft_msgs_py", "seft_plant_sim", "seft_ros")
NAMES = {  # module: name for pip, rosdep key
    "bokeh": ("bokeh", "python3-bokeh-pip"),
    "greenlet": ("greenlet", None),
    "hypothesis": ("hypothesis", "python3-hypothesis"),
    "jinja2": ("jinja2", "python3-jinja2"),
    "llvmlite": ("numba", "python3-numba"),  # which brings it, in the version that it needs
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "mcap": ("mcap", None),
    "numba": ("numba", "python3-numba"),
    "numpy": ("numpy", "python3-numpy"),
    "pytest": ("pytest", "python3-pytest"),
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "ruamel": ("ruamel.yaml", "python3-ruamel.yaml"),
    "scipy": ("scipy", "python3-scipy"),
    "setproctitle": ("setproctitle", "python3-setproctitle"),
    "tornado": ("tornado", "python3-tornado"),
    "typer": ("typer", "python3-typer"),
    "yaml": ("pyyaml", "python3-yaml"),
    "zstandard": ("zstandard", None),
}
OPTIONAL = {"distributed": "dask", "obspy": "motions", "openseespy": "opensees"}
"""Modules, which are their names for pip: the extra that brings each. ROS 2 does not have them."""
ROS = {  # what ROS 2 brings: no name for pip
    *("diagnostic_msgs", "launch", "launch_ros", "rcl_interfaces", "rclpy", "rosgraph_msgs"),
    *("std_msgs", "std_srvs", "trajectory_msgs"),
}


@cache
def imports(folder: Path) -> set[str]:
    """Modules that the files of a folder import, without Python's and the tests' own."""
    found, own = set(), {file.stem for file in ROOT.glob("src/*/test/*.py")}
    for file in {*folder.rglob("*.py")} - {*TEMPLATES.rglob("*.py")}:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
    return found - own - set(sys.stdlib_module_names) - set(OPTIONAL)


def required(package: str) -> tuple[set[str], set[str]]:
    """Names for pip: to run, and more for tests."""
    wanted = [Requirement(text) for text in requires(package)]
    return (
        {one.name for one in wanted if not one.marker},
        {one.name for one in wanted if one.marker and "test" in str(one.marker)},
    )


def depends(package: str, kind: str) -> set[str]:
    """Dependencies that a package.xml names."""
    root = ElementTree.parse(ROOT / "src" / package / "package.xml").getroot()
    return {element.text for element in root.iter(kind)}


def pinned(file: str) -> dict[str, str]:
    """Versions by name."""
    lines = (ROOT / file).read_text().splitlines()
    return dict(re.findall(r"^([\w.-]+)(?:\[.*\])?==([\w.]+)", "\n".join(lines), re.MULTILINE))


@pytest.mark.parametrize("package", OURS)
def test_setup_py_names_what_is_imported(package):
    folder = ROOT / "src" / package
    run, test = required(package)
    used = imports(folder / package) - ROS - {package}
    assert run == {NAMES.get(module, (module,))[0] for module in used}
    more = imports(folder / "test") - ROS - {package}
    assert {NAMES.get(module, (module,))[0] for module in more} <= run | test


@pytest.mark.parametrize("package", OURS)
def test_package_xml_names_what_is_imported(package):
    folder = ROOT / "src" / package
    used = (imports(folder / package) | imports(folder / "launch")) - {package}
    keys = {NAMES.get(module, (None, module))[1] for module in used} - {None}
    named = depends(package, "exec_depend")
    assert keys <= named
    assert {key for key in named - keys if key.startswith("python3-")} == set()
    more = imports(folder / "test") - {package}
    keys = {NAMES.get(module, (None, module))[1] for module in more} - {None}
    assert keys <= named | depends(package, "test_depend")


def test_what_is_optional_has_an_extra_that_brings_it():
    wanted = [Requirement(text) for package in OURS for text in requires(package)]
    for name, extra in OPTIONAL.items():
        (one,) = (each for each in wanted if each.name == name)
        assert one.marker.evaluate({"extra": extra}) and not one.marker.evaluate({"extra": ""})


def test_one_line_of_pip_has_what_no_rosdep_key_brings():
    run = set.union(*(required(package)[0] for package in OURS))
    line = "pip install " + " ".join(sorted(n for n, key in NAMES.values() if not key and n in run))
    assert f"    {line}  " in (ROOT / "docs" / "nodes.md").read_text()
    assert f"{line} -->" in (ROOT / "src" / "seft_ros" / "package.xml").read_text()


@pytest.mark.parametrize("package", OURS)
def test_lower_bounds_are_what_is_tested(package):
    newest = pinned("requirements.txt")
    oldest = newest | pinned("tools/ubuntu-24.04.txt")
    for text in requires(package):
        one = Requirement(text)
        if one.name in OURS:
            continue
        (bound,) = one.specifier
        assert bound.operator == ">="
        assert one.specifier.contains(newest[one.name])
        if one.name == "matplotlib":  # of Ubuntu's 3.6 there is no wheel
            assert bound.version == "3.6"
            continue
        assert (oldest[one.name] + ".").startswith(bound.version + ".")
