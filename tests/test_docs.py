"""Documents that are made of the code say what the code says."""

import json
import re
from runpy import run_path
from xml.etree import ElementTree

import pytest
from experiments_at_hand import load
from graph_tools import ROOT
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import place_of
from seft_msgs_py.wire.topics import LOOP_TOPICS, TOPICS
from seft_ros.cli.main import APP
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_margins import critical_mass_ratio
from seft_ros.reference_force.reference_force_parameters import OWN_METHODS
from seft_ros.test_run.parameter_tables import TABLES

COMPENSATION = ROOT / "docs" / "compensation.md"
FIRST_CELLS = re.compile(r"^\| (.+?) \|", re.MULTILINE)
OF_ROS = {"Could not find metadata in bag directory", "Trying to set a read-only parameter"}


def test_the_page_of_the_file_names_parameters_that_exist():
    text = (ROOT / "docs" / "experiment_file.md").read_text()
    place, rows = "", re.findall(r"^\| (?:`([^`]*)` )?\| `([\w.]+)`", text, re.MULTILINE)
    assert len(rows) == 25
    for named, name in rows:
        place = named or place
        assert any(name in t.rows and place_of(name, t.node) == place for t in TABLES), name


def test_the_files_of_that_page_are_read(tmp_path):
    text = (ROOT / "docs" / "experiment_file.md").read_text()
    for index, block in enumerate(re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)):
        file = tmp_path / f"{index}.yaml"
        file.write_text(block)
        Experiment.load(TABLES, [file])


def test_the_pages_of_nodes_and_commands_name_every_topic_node_and_command():
    text = (ROOT / "docs" / "nodes.md").read_text()
    for topic in TOPICS:
        assert f"`{topic.name}`" in text
    for topic in LOOP_TOPICS:
        assert all(unit in text for unit in topic.units)
    for table in TABLES:
        assert f"`{table.node}`" in text
    text = (ROOT / "docs" / "commands.md").read_text()
    for command in APP.registered_commands:
        assert f"`seft {command.callback.__name__}" in text


def test_every_compensation_method_is_in_both_tables_of_methods():
    for name in OWN_METHODS:
        assert len(re.findall(rf"^\| `{name}`", COMPENSATION.read_text(), re.MULTILINE)) >= 2


@pytest.mark.parametrize(
    ("column", "overrides"), [(1, []), (2, ["actuator.kind:=delay", "actuator.delay:=0.01"])]
)
@pytest.mark.parametrize("method", ["none", "restoring"])  # they need nothing identified
def test_where_a_method_ends_is_what_preflight_says(method, column, overrides):
    section = COMPENSATION.read_text().split("### Where each ends")[1]
    row = next(line for line in section.splitlines() if line.startswith(f"| `{method}` |"))
    cell = row.split("|")[1 + column].strip()
    method_word = f"reference_force:compensation.method:={method}"
    critical = critical_mass_ratio(PlannedTest(load(*overrides, method_word)))
    if critical is None:
        assert cell == "> 50"
    else:
        assert float(cell) == pytest.approx(critical.value, rel=0.005)


def test_the_script_of_the_stops_stops_a_test():
    script = run_path(str(ROOT / "docs" / "stops.py"))
    ((closed, planned, resting),) = script["stops"](load(*script["LINEAR"]), {2300})
    assert min(closed, planned) > 0.5 * resting > 0.0


def test_layouts_for_outside_tools_plot_fields_of_our_topics():
    layouts = ROOT / "src" / "seft_ros" / "layouts"
    foxglove = json.loads((layouts / "foxglove.json").read_text())["configById"]
    plots = [panel for name, panel in foxglove.items() if name.startswith("Plot!")]
    shown = [p["value"].replace(".points[0].", " ") for plot in plots for p in plot["paths"]]
    plotjuggler = ElementTree.parse(layouts / "plotjuggler.xml")
    curves = [c.get("name").replace("/points[0]/", " ") for c in plotjuggler.iter("curve")]
    assert shown == curves
    fields = {f"/{t.name} {field}[0]" for t in LOOP_TOPICS for field in t.quantities}
    assert set(shown) <= fields
    assert len(shown) == 6
    called = {panel["serviceName"] for name, panel in foxglove.items() if "CallService" in name}
    assert called == {"/start", "/stop", "/estop", "/reset"}


def test_the_page_on_troubleshooting_quotes_messages_of_the_code():
    files = [path for path in (ROOT / "src").rglob("*.py") if "test" not in path.parts]
    code = "\n".join(path.read_text() for path in files)
    code = re.sub(r'"\s*\n\s*f?"', "", code)  # a string that continues on the next line
    table = (ROOT / "docs" / "troubleshooting.md").read_text().split("\n## ")[0]
    quotes = [quote for cell in FIRST_CELLS.findall(table) for quote in re.findall("`(.+?)`", cell)]
    parts = {part.strip() for quote in quotes for part in quote.split("...")} - OF_ROS
    assert len(parts) > 20
    assert {part for part in parts if part not in code} == set()
