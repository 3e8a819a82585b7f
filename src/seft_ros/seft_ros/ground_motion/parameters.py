"""Parameters of the ground_motion node."""

from seft_msgs_py.config.parameter_table import Parameter, Table

from seft_ros.ground_motion.units import UNITS

TABLE = Table(
    "ground_motion",
    (
        Parameter("file", "string", "", "record to read; empty: make a synthetic motion"),
        Parameter(
            "column",
            "ints",
            0,
            "column of the file, counted from 0; one for all axes, or one per axis",
            minimum=0,
        ),
        Parameter(
            "unit", "string", "g", "unit of the accelerations in the file", choices=(*UNITS,)
        ),
        Parameter(
            "dt",
            "float",
            0.0,
            "sampling period of the file; 0: its own (AT2 header, time column)",
            "s",
            minimum=0.0,
        ),
        Parameter(
            "peak_force",
            "float",
            0.0,
            "scale the motion so that the largest |mass * acceleration| is this; 0: as recorded",
            "N",
            minimum=0.0,
        ),
        Parameter(
            "mass",
            "floats",
            0.0,
            "mass that peak_force is meant for: one for every axis, one per axis, or a matrix "
            "row by row",
            "kg",
            default_from="reference_force:model.mass",
        ),
        Parameter(
            "time_scale",
            "float",
            1.0,
            "factor on the motion's duration: 0.5 is twice as fast",
            positive=True,
        ),
        Parameter(
            "influence",
            "floats",
            1.0,
            "influence vector: factor on the ground acceleration, for all axes or per axis",
        ),
        Parameter("tail", "float", 2.0, "free vibration after the motion", "s", minimum=0.0),
        Parameter(
            "lead",
            "float",
            2.0,
            "how far ahead of the rig's time the motion is published",
            "s",
            positive=True,
            maximum=3600.0,
        ),
        Parameter("synthetic.seed", "int", 0, "seed of the synthetic motion", minimum=0),
        Parameter("synthetic.duration", "float", 20.0, "its duration", "s", positive=True),
        Parameter("synthetic.dt", "float", 0.005, "its sampling period", "s", positive=True),
        Parameter("synthetic.peak", "float", 3.0, "its peak acceleration", "m/s^2", positive=True),
        Parameter(
            "synthetic.ground_frequency",
            "float",
            2.5,
            "frequency of the ground layer (Kanai-Tajimi)",
            "Hz",
            positive=True,
        ),
        Parameter("synthetic.ground_damping", "float", 0.6, "its damping ratio", positive=True),
        Parameter(
            "synthetic.filter_frequency",
            "float",
            0.25,
            "frequency of the high-pass (Clough-Penzien)",
            "Hz",
            positive=True,
        ),
        Parameter("synthetic.filter_damping", "float", 0.6, "its damping ratio", positive=True),
        Parameter("synthetic.rise", "float", 2.0, "end of the envelope's rise", "s", minimum=0.0),
        Parameter(
            "synthetic.plateau_end",
            "float",
            8.0,
            "end of the envelope's plateau",
            "s",
            minimum=0.0,
        ),
        Parameter(
            "synthetic.decay", "float", 0.35, "rate of the envelope's decay", "1/s", minimum=0.0
        ),
    ),
)
"""Parameter table of the ground_motion node."""
