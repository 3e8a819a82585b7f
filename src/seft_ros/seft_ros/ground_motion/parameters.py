"""Parameter table of the ground_motion node."""

from seft_msgs_py.config.parameter_table import Table, parameter_rows

_ROWS = parameter_rows(
    """
    file                       | string |       |       |             |
        record to read; empty: make a synthetic motion
    column                     | ints   | 0     |       | 0 ..        |
        column of the file, counted from 0; one for all axes, or one per axis
    unit                       | string | g     |       | g, m/s2, cm/s2 |
        unit of the accelerations in the file
    dt                         | float  | 0.0   | s     | 0 ..        |
        sampling period of the file; 0: its own (AT2 header, time column)
    peak_force                 | float  | 0.0   | N     | 0 ..        |
        scale the motion so that the largest |mass * acceleration| is this; 0: as recorded
    mass                       | floats | reference_force:model.mass or 0.0 | kg    |             |
        mass that peak_force is meant for: one for every axis, one per axis, or a matrix row
        by row
    time_scale                 | float  | 1.0   |       | > 0         |
        factor on the motion's duration: 0.5 is twice as fast
    influence                  | floats | 1.0   |       |             |
        influence vector: factor on the ground acceleration, for all axes or per axis
    tail                       | float  | 2.0   | s     | 0 ..        |
        free vibration after the motion
    lead                       | float  | 2.0   | s     | > 0 .. 3600 |
        how far ahead of the rig's time the motion is published
    synthetic.seed             | int    | 0     |       | 0 ..        | seed of the synthetic motion
    synthetic.duration         | float  | 20.0  | s     | > 0         | its duration
    synthetic.dt               | float  | 0.005 | s     | > 0         | its sampling period
    synthetic.peak             | float  | 3.0   | m/s^2 | > 0         | its peak acceleration
    synthetic.ground_frequency | float  | 2.5   | Hz    | > 0         |
        frequency of the ground layer (Kanai-Tajimi)
    synthetic.ground_damping   | float  | 0.6   |       | > 0         | its damping ratio
    synthetic.filter_frequency | float  | 0.25  | Hz    | > 0         |
        frequency of the high-pass (Clough-Penzien)
    synthetic.filter_damping   | float  | 0.6   |       | > 0         | its damping ratio
    synthetic.rise             | float  | 2.0   | s     | 0 ..        | end of the envelope's rise
    synthetic.plateau_end      | float  | 8.0   | s     | 0 ..        |
        end of the envelope's plateau
    synthetic.decay            | float  | 0.35  | 1/s   | 0 ..        | rate of the envelope's decay
    """
)
TABLE = Table("ground_motion", _ROWS)
