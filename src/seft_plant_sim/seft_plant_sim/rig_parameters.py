"""Parameter table of the rig: what the simulated one truly is, and how a rig runs and rests."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FACTS, POSITION_SERVO, SETTINGS, facts
from seft_msgs_py.config.parameter_table import Parameter, Section, Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import host

from seft_plant_sim.hardware.udp import UDP_ROWS

_OWN = ("linear", "bilinear", "bouc_wen", "pinching", "flag", "friction", "gap", "duffing")
RESTORING_FORCES = Registered("seft.restoring_force", _OWN)
"""Laws of other packages: kind -> class or function for a `springs.HystereticSpring`.

It receives elastic stiffness in N/m, yield displacement in m, and hardening ratio, and may take
settings.
"""

LIMIT_ROWS = (*CHANNELS, *(f"{name}_rate" for name in CHANNELS))
LIMIT_UNITS = tuple(FACTS[f"limits.{name}"].unit for name in LIMIT_ROWS)

SIMULATED, UDP = "simulated", "udp"
HARDWARE = Registered("seft.hardware", (SIMULATED, UDP))
"""Hardware of other packages: name -> class of the parameters of the rig and its axes."""
_PACE = parameter_rows(
    """
    hardware | string | simulated | | |
        what the rig node hosts (docs/hardware.md): simulated, udp, FILE.py:CLASS, MODULE:CLASS, or
        a name that a package has registered
    pace | string | realtime |  | realtime, lockstep |
        realtime: absolute deadlines, a missing command is that of the fallback stop, or the last;
        lockstep: each step waits for its command
    lockstep_timeout | float | 5.0 | s | > 0  | longest wait for a command in lockstep
    seed             | int   | 0   |   | 0 .. | seed of the sensor noise
    """
)

_FAULTS = Parameter(
    "faults",
    "texts",
    "",
    "what fails in the simulated rig, one line a fault, [AXIS/]WHAT KIND [VALUE] at TIME [for "
    "STEPS], as force scale 0.7 at 5.25 for 100; docs/rig.md has the kinds",
)

_SPECIMEN = (
    RESTORING_FORCES.row(
        "simulated.specimen.kind",
        "linear",
        "restoring force: linear, bilinear with kinematic hardening, Bouc-Wen, Bouc-Wen with "
        "pinching, flag-shaped (self-centring), Coulomb friction parallel to the spring, a second "
        "spring behind a gap, or Duffing's cubic spring",
    ),
    RESTORING_FORCES.settings_row("simulated.specimen.settings", "a restoring force"),
    *parameter_rows(
        """
        yield_displacement      | floats | 0.0  | m     | 0 ..       |
            deformation at which a spring yields, for all or per spring
        hardening_ratio         | floats | 0.05 |       | 0 .. 0.999 |
            stiffness after yielding over the elastic one, likewise
        bouc_wen.exponent       | float  | 1.0  |       | 1 ..       | sharpness of yielding, n
        bouc_wen.beta           | float  | 0.5  |       |            | shape of unloading, beta
        bouc_wen.gamma          | float  | 0.5  |       |            | shape of unloading, gamma
        bouc_wen.amplitude_loss | float  | 0.0  |       | 0 ..       |
            degradation of amplitude per work of yield force times yield displacement (Baber & Wen
            1981, delta_A)
        bouc_wen.strength_loss  | float  | 0.0  |       | 0 ..       |
            degradation of strength per work of yield force times yield displacement (Baber & Wen
            1981, delta_nu)
        bouc_wen.stiffness_loss | float  | 0.0  |       | 0 ..       |
            degradation of stiffness per work of yield force times yield displacement (Baber & Wen
            1981, delta_eta)
        pinching.slip           | float  | 1.0  |       | 0 ..       |
            half of the fully developed slip at each passage through zero force, over the yield
            displacement; the other parameters are those of bouc_wen
        pinching.growth         | float  | 0.1  |       | > 0        |
            growth of the slip per work of yield force times yield displacement
        pinching.width          | float  | 0.15 |       | > 0        |
            force range in which it slips, over the yield force
        flag.dissipation        | floats | 0.5  |       | 0 .. 1     |
            height of the flag over the yield force, for all or per spring; 0: no dissipation
        friction.force          | floats | 0.0  | N     | 0 ..       |
            friction parallel to each spring, for all or per spring
        friction.presliding     | float  | 2e-5 | m     | > 0        |
            elastic displacement before it slides
        gap.width               | floats | 0.0  | m     | 0 ..       |
            deformation in both directions at which the second spring engages, for all or per spring
        gap.stiffness           | floats | 0.0  | N/m   | 0 ..       |
            stiffness of the second spring, likewise
        duffing.cubic           | floats | 0.0  | N/m^3 |            |
            coefficient of the deformation's cube, likewise; below 0 the spring softens up to its
            largest force
        """,
        "simulated.specimen",
    ),
)

_ACTUATOR = parameter_rows(
    """
    rated_voltage     | floats | 10.0  | V     | > 0  | drive at which the valve is fully open
    viscous_friction  | floats | 0.0   | N s/m | 0 .. | viscous friction of the piston
    stroke            | floats | 0.076 | m     | > 0  |
        displacement in both directions at which the piston meets its stops
    servo.gain              | floats | 1.0    |         | > 0  |
        of the vendor's controller of a position_servo: displacement per command at rest
    servo.proportional      | floats | 0.0    | V/m     | 0 .. |
        its proportional gain; without gains the motion is imposed, as actuator.response tells
    servo.integral          | floats | 0.0    | V/(m s) | 0 .. | its integral gain
    servo.derivative        | floats | 0.0    | V s/m   | 0 .. | its derivative gain
    servo.derivative_filter | floats | 100.0  | Hz      | > 0  | cut-off of its derivative
    servo.delta_p           | floats | 0.0    | V/N     | 0 .. | its feedback of the oil's force
    """,
    "simulated.actuator",
)

_OF_THE_PAPER = {
    "flow_gain": 0.0403,
    "oil_stiffness": 1.664e7,
    "leakage": 50.0,
    "force_capacity": 24500.0,
    "valve_frequency": 70.0,
    "valve_damping": 0.6,
    "dead_time": 0.001,
}
"""Where nothing is known of the actuator; all but leakage and dead time are above 0."""
_NO_TRUTH = (
    *("specimen.mass_error", "calibration.force_lag_error", "calibration.force_scale_error"),
    "calibration.zeroing",
)


def _true(fact: Parameter) -> Parameter:
    """Give the row of what a simulated rig truly has in place of a fact."""
    name = fact.name.removeprefix("actuator.")
    return replace(
        fact,
        name=f"simulated.{fact.name.replace('calibration.', 'sensors.')}",
        default=_OF_THE_PAPER.get(name, fact.default),
        description=f"what /**: {fact.name} truly is; default the same",
        positive=fact.positive or (name in _OF_THE_PAPER and name not in ("leakage", "dead_time")),
    )


_TRUE = [
    _true(fact)
    for name, fact in FACTS.items()
    if name.startswith(("specimen.", "actuator.", "calibration."))
    or name.endswith(("_noise", "adc_bits"))
    if name not in _NO_TRUTH
    and not name.endswith("_per_volt")
    and not name.startswith(("actuator.kind", "actuator.response"))
]

SAFETY = parameter_rows(
    """
    safe.valve_command          | floats | 0.0  | V |         |
        valve command after the end of a test; an idealised actuator removes its force instead
    safe.close_time             | float  | 0.02 | s | 0 .. 1  |
        time in which the valve goes from the last command to safe.valve_command. Longer than a
        period of the oil column, because a valve that closes at once on a mass M with velocity v
        makes a force peak of v sqrt(k_oil M); shorter than a sixth of the specimen's period,
        because the specimen still moves
    safe.settle_time            | float  | 0.2  | s | 0 .. 60 |
        time after that in which the rig must come to rest; the simulated one goes on for so long
    watchdog.command_timeout    | float  | 0.02 | s | > 0     |
        in realtime: longest time of the rig without a new command, and of the force controller
        without a new rig/state, before it trips
    watchdog.supervisor_timeout | float  | 1.0  | s | > 0     |
        longest silence of the supervisor before the rig trips
    detectors.warn_only         | string |      |   |         |
        detectors (docs/safety.md) that warn but do not end a test: their names, separated by
        commas, or all
    """
)
MASS_RATIO_ROWS = parameter_rows(
    """
    mass_ratio | float | 0.0 | | 0 .. |
        computed mass over specimen mass, alpha, with seft; with computed.mass a factor on all that
        is computed, 1 as given
    """
)
"""Setting of the reference force that rig and force controller use, too."""
SETTINGS_OF_THE_RIG = [row for row in SAFETY if row.name in SETTINGS]
"""Those that the force controller uses, too."""

RIG_TABLE = Table(
    "rig",
    [
        *facts("loop_delay", "specimen.", "actuator.", "sensors.", "calibration.", "limits."),
        *MASS_RATIO_ROWS,
        *_PACE,
        *UDP_ROWS,
        _FAULTS,
        *_TRUE,
        *_SPECIMEN,
        *_ACTUATOR,
        *SAFETY,
        *host.REALTIME_PARAMETERS,
    ],
)


def truth(section: Section) -> Section:
    """Take what a simulated rig truly is from its section: ``simulated.*``, by the full names."""
    return {name: value for name, value in section.items() if name.startswith("simulated.")}


def is_imposed(section: Mapping[str, Any]) -> bool:
    """Whether a simulated servo has no gains, so that it moves as the identified response tells."""
    gains = [section[f"simulated.actuator.servo.{each}"] for each in ("proportional", "integral")]
    return section["actuator.kind"] == POSITION_SERVO and not any(map(np.any, gains))


def filter_of(frequency: Any, damping: Any) -> tuple[Floats, Floats]:
    """Give p (s) and q (s^2) of filters 1 / (1 + p s + q s^2); 0 where the frequency (Hz) is 0."""
    w = 2 * np.pi * np.asarray(frequency, dtype=np.float64)
    period = np.divide(1.0, w, out=np.zeros_like(w), where=w > 0.0)
    return 2.0 * np.asarray(damping) * period, period**2


def common_filter(section: Mapping[str, Any]) -> tuple[float, float]:
    """Filter of the aligned channels, see `filter_of`, of a section: the slowest of all."""
    names = [f"calibration.{channel}_filter" for channel in CHANNELS]
    each = [filter_of(np.ravel(section[n]), np.ravel(section[f"{n}_damping"])) for n in names]
    every = [one for p, q in each for one in zip(*np.broadcast_arrays(p, q), strict=True)]
    p, q = max(every, key=lambda one: one[1])
    return float(p), float(q)


def common_lag(section: Mapping[str, Any]) -> float:
    """Delay of the aligned channels, of a section with ``calibration.*``, s.

    That is the largest lag, and the delay of the slowest filter below its frequency.
    """
    lag = max(float(np.max(section[f"calibration.{channel}_lag"])) for channel in CHANNELS)
    return lag + common_filter(section)[0]


def as_simulated(experiment: Experiment) -> Experiment:
    """Replace the hardware of an experiment by a simulated rig, and nothing else."""
    if experiment.sections.get("rig", {}).get("hardware", SIMULATED) == SIMULATED:
        return experiment
    return experiment.changed({"rig": {"hardware": SIMULATED}})
