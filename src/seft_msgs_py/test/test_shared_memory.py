"""A full /dev/shm is told in one line, where rclpy would be killed."""

import errno
import os

import pytest
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.middleware import check_shared_memory


@pytest.fixture
def is_full(monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", refuse)


def test_a_full_folder_is_told(tmp_path, is_full):
    with pytest.raises(InputError, match="is full, and no ROS process can start"):
        check_shared_memory(tmp_path)
    (tmp_path / "lttng-ust-wait-6").touch()  # it has no page yet
    with pytest.raises(InputError):
        check_shared_memory(tmp_path)


def test_what_the_tracer_has_already_is_enough(tmp_path, is_full):
    (tmp_path / "lttng-ust-wait-6").write_bytes(bytes(4096))
    check_shared_memory(tmp_path)


def test_a_folder_with_space_is_left_as_it_was(tmp_path):
    check_shared_memory(tmp_path)
    assert list(tmp_path.iterdir()) == []
    check_shared_memory(tmp_path / "nowhere")
