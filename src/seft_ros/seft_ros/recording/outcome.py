"""Moved to seft_msgs_py.outcome."""

from seft_msgs_py.outcome import *  # noqa: F403
