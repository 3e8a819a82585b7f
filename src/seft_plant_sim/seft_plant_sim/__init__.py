"""The simulated rig: actuator, specimen, sensors, and the exact reference solution."""

import seft_msgs_py as seft_msgs_py  # before numpy: it sets the number of threads
