"""Documents that are made of the code say what the code says."""

import re

from graph_tools import ROOT
from seft_msgs_py.topics import LOOP_TOPICS, TOPICS
from seft_ros.commands.parameters import parameters_text
from seft_ros.experiment.tables import TABLES


def test_the_parameter_tables_are_those_of_the_code():
    text = (ROOT / "docs" / "parameters.md").read_text()
    assert text.rstrip("\n") == parameters_text([table.node for table in TABLES])


def test_the_readme_names_every_topic_node_and_command():
    text = (ROOT / "README.md").read_text()
    for topic in TOPICS:
        assert f"`{topic.name}`" in text
    for topic in LOOP_TOPICS:
        assert all(unit in text for unit in topic.units)
    for table in TABLES:
        assert f"`{table.node}`" in text


def test_links_between_documents_lead_somewhere():
    for document in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name}: {target}"
