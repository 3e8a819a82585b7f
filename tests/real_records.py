"""Real ground motions beside the project, where they are."""

import pytest
from graph_tools import ROOT

_FILES = {
    "Kobe JMA": "kobe_jma_1995.txt",
    "El Centro": "elcentro_1940.txt",
    "Nishi-Akashi": "kobe_nishi_akashi_090.AT2",
}


def words_of(motion, *synthetic):
    """Overrides of a motion: a real record, or these; skips where the record is not there."""
    if motion not in _FILES:
        return synthetic
    file = ROOT.parent / "shared" / "data" / _FILES[motion]
    if not file.is_file():
        pytest.skip("no real record here")
    return f"ground_motion:file:={file}", "ground_motion:column:=0"
