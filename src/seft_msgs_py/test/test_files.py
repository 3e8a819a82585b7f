"""What is no regular file is reported at once."""

import os

import pytest
from seft_msgs_py import files
from seft_msgs_py.config.experiment import read_parameter_file
from seft_msgs_py.errors import InputError
from seft_msgs_py.files import check_regular


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_a_device_and_a_folder_are_not_read_and_a_pipe_is_not_waited_for(pipe, monkeypatch):
    monkeypatch.setattr(files, "PIPE_WITHIN", 0.05)
    nobody = "nobody has written to this pipe within 0.05 s"
    no_file, folder = ("/dev/zero", "is no regular file"), (pipe.parent, "Is a directory")
    for path, message in no_file, folder, (pipe, nobody):
        with pytest.raises(InputError, match=message):
            read_parameter_file(path)
    with pytest.raises(OSError, match="is no regular file"):
        files.open_regular(pipe)


def test_a_pipe_whose_writer_stands_still_is_not_waited_for(pipe, monkeypatch):
    monkeypatch.setattr(files, "PIPE_WITHIN", 0.05)
    writer = os.open(pipe, os.O_RDWR)
    os.write(writer, b"/**:")
    with pytest.raises(TimeoutError):
        files.read_text_of(pipe, 100)
    os.close(writer)


def test_a_pipe_and_a_folder_are_not_written(pipe):
    check_regular(pipe.with_name("new"))
    with pytest.raises(InputError, match="is no regular file"):
        check_regular(pipe)
    with pytest.raises(InputError, match="is a folder"):
        check_regular(pipe.parent)
