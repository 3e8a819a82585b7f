"""What tests of commands and of records share."""

import json
from functools import partial

import pytest
from commands_at_hand import run_seft
from seft_msgs_py.errors import InputError


@pytest.fixture
def seft(monkeypatch, tmp_path):
    """Run the command line in an empty folder; (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return partial(run_seft, tmp_path)


@pytest.fixture
def seft_json(seft):
    """Run `seft ... --json`; give the object it prints, and nothing else."""

    def run(*words, status=0):
        ended, out, err = seft(*words, "--json")
        assert ended == status, err
        return json.loads(out)

    return run


@pytest.fixture
def refused(seft):
    """Run what must be refused; give the one line."""

    def run(*words):
        status, out, err = seft(*words)
        assert (status, out) == (2, "")
        assert err.count("\n") == 1
        assert err.startswith("seft: ")
        assert "Traceback" not in err
        return err

    return run


@pytest.fixture
def read(tmp_path):
    """Read a text or bytes as a ground motion; gives the record."""
    from seft_ros.ground_motion.record_file import read_record  # which few tests need

    def read(content, columns=(-1,), unit="", dt=0.0, name="record.txt", **words):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_record(path, list(columns), unit, dt, **words)

    return read


@pytest.fixture
def refuses(read, tmp_path):
    """Read what must be refused in words that match, and with the file's name; gives the words."""

    def refuses(message, content, *options, name="record.txt", **words):
        with pytest.raises(InputError, match=message) as caught:
            read(content, *options, name=name, **words)
        assert str(tmp_path / name) in str(caught.value)
        return str(caught.value)

    return refuses
