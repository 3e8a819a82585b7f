"""Compile the loop over the steps of a test: python tools/compile_loop.py FILE."""

import sys

from seft_msgs_py.config.experiment import Experiment
from seft_ros.test_run.offline import BlockCache
from seft_ros.test_run.parameter_tables import TABLES

BlockCache().run(Experiment.load(TABLES, sys.argv[1:]))
