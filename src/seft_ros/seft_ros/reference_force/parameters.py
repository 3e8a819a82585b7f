"""Parameter table of the reference force."""

from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.node import realtime

from seft_ros.reference_force.compensation.names import REGISTERED

TABLE = Table(
    "reference_force",
    [
        Parameter(
            "method",
            "string",
            "seft",
            "seft: computed mass by acceleration feedback (Eq. 2.5); eft: without (Eq. 2.3)",
            choices=("eft", "seft"),
        ),
        Parameter(
            "mass_ratio",
            "float",
            0.0,
            "computed mass over specimen mass, alpha; with computed.mass a factor on all that is "
            "computed, 1 as given",
            minimum=0.0,
        ),
        Parameter(
            "computed.mass",
            "floats",
            0.0,
            "mass of the computed substructure over the axes, then its internal degrees of "
            "freedom: one number, a diagonal, or a matrix; 0: the mass of the specimen's model",
            "kg",
        ),
        Parameter("computed.damping", "floats", 0.0, "its damping, likewise", "N s/m"),
        Parameter("computed.stiffness", "floats", 0.0, "its stiffness, likewise", "N/m"),
        Parameter(
            "computed.internal",
            "int",
            0,
            "degrees of freedom of the computed substructure beside the axes",
            minimum=0,
            maximum=200,
        ),
        Parameter(
            "computed.influence",
            "floats",
            0.0,
            "ground acceleration of each of these per that of each axis, one after the other; 0: "
            "that of the first axis",
        ),
        Parameter(
            "loop_delay",
            "int",
            0,
            "steps from a state to the first use of the force that is computed from it, where a "
            "link lies between this node and the force controller (docs/hosts.md); 0: none does, "
            "and the force controller waits for it; -1: seft run measures it before the test",
            minimum=-1,
            maximum=100,
        ),
        Parameter(
            "model.mass",
            "floats",
            None,
            "mass of the specimen as known to the experimenter",
            "kg",
            default_from="rig:specimen.mass",
        ),
        Parameter(
            "model.damping",
            "floats",
            0.0,
            "damping of the specimen, likewise",
            "N s/m",
            default_from="rig:specimen.damping",
        ),
        Parameter(
            "model.stiffness",
            "floats",
            None,
            "stiffness of the specimen, likewise",
            "N/m",
            default_from="rig:specimen.stiffness",
        ),
        Parameter(
            "model.springs",
            "floats",
            0.0,
            "springs of the specimen that may yield, likewise: deformation of each per "
            "displacement of each axis; 0: one between each axis and the ground",
            default_from="rig:specimen.springs",
        ),
        Parameter(
            "compensation.method",
            "string",
            "none",
            "how the measured acceleration is freed of the actuator's delay",
            choices=REGISTERED.names,
        ),
        REGISTERED.settings_row("compensation.settings", "a method"),
        Parameter(
            "compensation.delay",
            "float",
            0.0,
            "delay that the method compensates: from reference force to measured force, latency of "
            "the loop included, as seft identify finds it (an idealised actuator's delay and 1.5 "
            "steps); `none` and `restoring` do not use it",
            "s",
            minimum=0.0,
            maximum=1.0,
        ),
        Parameter(
            "compensation.order",
            "int",
            1,
            "order of the polynomial of `polynomial`",
            minimum=1,
            maximum=3,
        ),
        Parameter(
            "compensation.estimate_delay",
            "bool",
            False,
            "estimate the delay of each axis while the test runs, from compensation.delay on; for "
            "the methods that compensate a delay, `ats` adapts by itself",
        ),
        Parameter(
            "compensation.delay_range",
            "floats",
            [0.002, 0.04],
            "shortest and longest delay that is estimated",
            "s",
            minimum=0.0,
            maximum=0.1,
        ),
        Parameter(
            "compensation.delay_rate",
            "float",
            0.01,
            "largest change of an estimated delay, s per s",
            minimum=0.0,
        ),
        Parameter(
            "compensation.excitation",
            "float",
            20.0,
            "RMS of the forces over about a second from which on they are used to adapt; above "
            "what the sensors' noise makes",
            "N",
            positive=True,
        ),
        Parameter(
            "compensation.band",
            "floats",
            [1.0, 12.0],
            "lowest and highest frequency at which forces are compared to adapt: where they have "
            "their energy",
            "Hz",
            positive=True,
        ),
        Parameter(
            "compensation.actuator_kind",
            "string",
            "servo_hydraulic",
            "`target_motion`: kind of the rig's actuators; ideal and delay are driven by "
            "reference_force, which is then sent ahead by their response (tracking.*)",
            choices=("ideal", "delay", "servo_hydraulic", "servo_hydraulic_linear"),
            default_from="rig:actuator.kind",
        ),
        Parameter(
            "compensation.horizon",
            "float",
            0.05,
            "`target_motion`: time ahead for which the coming motion is told; four times the delay "
            "of the valves, or three times that of the force loop",
            "s",
            positive=True,
            maximum=1.0,
        ),
        *(
            Parameter(
                f"compensation.noise.{name}",
                "floats",
                0.0,
                f"RMS noise of the measured {quantity}, by which it is weighed against the others",
                unit,
                minimum=0.0,
                default_from=f"rig:sensors.{name}_noise",
            )
            for name, quantity, unit in (
                ("position", "displacement", "m"),
                ("velocity", "velocity", "m/s"),
                ("acceleration", "acceleration", "m/s^2"),
                ("force", "force", "N"),
            )
        ),
        Parameter(
            "compensation.noise.velocity_source",
            "string",
            "measured",
            "whether the velocity is measured, or derived from the displacement and so late",
            choices=("measured", "derived"),
            default_from="rig:sensors.velocity",
        ),
        Parameter(
            "tracking.numerator",
            "floats",
            [0.0],
            "numerator of the identified response from reference force to measured force of the "
            "same step, in s, highest power first, for `target_motion` on a rig that is driven by "
            "forces; 0: a pure delay, of compensation.delay",
        ),
        Parameter("tracking.denominator", "floats", [1.0], "its denominator, likewise"),
        Parameter(
            "tracking.dead_time",
            "float",
            0.0,
            "its dead time, the loop's latency included",
            "s",
            minimum=0.0,
            maximum=1.0,
        ),
        Parameter(
            "limits.force",
            "float",
            22200.0,
            "largest reference force on any axis; beyond it the test is ramped down",
            "N",
            positive=True,
            default_from="supervisor:limits.force",
        ),
        Parameter(
            "limits.force_rate",
            "float",
            3.0e6,
            "fastest change of the reference force on any axis from step to step, likewise; far "
            "above what a test near its limits asks for, so that it only catches what is no test",
            "N/s",
            positive=True,
        ),
        Parameter(
            "instability.ratio",
            "float",
            5.0,
            "vibration beyond this many times what the structure has under the measured restoring "
            "force brings the test down softly, before it grows to a limit; 0: never",
            minimum=0.0,
        ),
        Parameter(
            "instability.floor",
            "float",
            0.3,
            "vibration (RMS) that counts as the structure's in any case: several times the noise "
            "of the accelerometers",
            "m/s^2",
            positive=True,
        ),
        Parameter(
            "instability.lowest",
            "float",
            0.0,
            "frequency from which on vibration is watched; 0: twice the specimen's lowest natural "
            "frequency, which the model gives",
            "Hz",
            minimum=0.0,
        ),
        Parameter(
            "watchdog.rig_timeout",
            "float",
            0.01,
            "of several rigs in realtime: longest time that the state of one may fail to come "
            "when another's is there, before the test trips",
            "s",
            positive=True,
        ),
        Parameter(
            "ramp_down_time",
            "float",
            0.5,
            "experiment time in which the reference force goes to zero, as half a cosine, where "
            "a test is brought down softly",
            "s",
            positive=True,
            maximum=60.0,
        ),
        *realtime.PARAMETERS,
    ],
)
