"""Substructure effective force testing (SEFT): the experiment, its nodes and its analysis."""

import seft_msgs_py as seft_msgs_py  # before numpy: it sets the number of threads
