import os
import sys

import pytest
from experiments_at_hand import JHU

SHORT = ("-p", "ground_motion:synthetic.duration:=4", "-p", "ground_motion:tail:=0.5")


def test_the_page_the_table_and_the_files_of_the_worst_tests(seft, tmp_path):
    words = ("--method", "none", "--method", "restoring", "--mass-ratio", "0.5")
    words = (*words, "--mass-ratio", "1.5", "--tests", "12", "--workers", "1", "--out", "page")
    status, out, _ = seft("study", JHU, *SHORT, *words)
    assert status == 0
    for part in ("12 tests, spread 10 %", "restoring", "tripped", "at mass ratio 1.5: 95 % of the"):
        assert part in out
    page = (tmp_path / "page.html").read_text()
    files = list((tmp_path / "page").iterdir())
    parts = ("What the error depends on", "The worst tests", "Study of jhu.yaml", "specimen.mass")
    for part in (*parts, *(f"page/{file.name}" for file in files)):
        assert part in page
    assert len(files) == 4 * 5
    assert list(tmp_path.glob("*.jsonl")) == []


@pytest.mark.parametrize(
    ("scheduler", "message"),
    [("tcp://127.0.0.1:9", "no Dask scheduler answers there"), ("cluster", "--scheduler cluster")],
)
def test_a_scheduler_that_is_none_is_reported(seft, scheduler, message):
    pytest.importorskip("distributed")
    status, out, err = seft("study", JHU, "--tests", "2", "--scheduler", scheduler)
    assert (status, out) == (2, "")
    assert message in err.splitlines()[-1]


def test_without_dask_a_scheduler_is_refused_with_the_way_to_install_it(seft, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    status, _, err = seft("study", JHU, "--tests", "2", "--scheduler", "tcp://127.0.0.1:8786")
    assert status == 2
    assert "pip install 'seft_ros[dask]'" in err
    assert os.linesep.join(err.splitlines()[-1:]).startswith("seft: --scheduler")
