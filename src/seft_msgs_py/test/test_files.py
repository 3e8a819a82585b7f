"""What is no regular file is reported at once."""

import os

import pytest
from seft_msgs_py.config.experiment import read_parameter_file
from seft_msgs_py.errors import InputError
from seft_msgs_py.files import check_regular


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_a_pipe_a_device_and_a_folder_are_not_read(pipe):
    no_file = "is no regular file"
    for path, message in (pipe, no_file), ("/dev/zero", no_file), (pipe.parent, "Is a directory"):
        with pytest.raises(InputError, match=message):
            read_parameter_file(path)


def test_a_pipe_and_a_folder_are_not_written(pipe):
    check_regular(pipe.with_name("new"))
    with pytest.raises(InputError, match="is no regular file"):
        check_regular(pipe)
    with pytest.raises(InputError, match="is a folder"):
        check_regular(pipe.parent)
