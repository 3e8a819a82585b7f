"""Names that parameters had before; removed with version 1.0."""

import re

_RENAMED = r"""
ground_motion: mass -> /**: specimen.mass
reference_force: identified\.force_lag_error -> /**: calibration.force_lag_error
reference_force: (model|identified)\.(\w+) -> /**: specimen.\2
reference_force: compensation\.delay ->
    /**: actuator.delay, which is without the loop's 1.5 sampling periods
\w+: (compensation\.)?sensor_lag -> /**: calibration.*_lag, whose largest it was
reference_force: compensation\.actuator_kind -> /**: actuator.kind
reference_force: tracking\.(\w+) -> /**: actuator.response.\1
\w+: (compensation\.)?noise\.velocity_source -> /**: sensors.velocity
\w+: (compensation\.)?noise\.position -> /**: sensors.displacement_noise
\w+: (compensation\.)?noise\.(\w+) -> /**: sensors.\2_noise
force_controller: detectors\.specimen_(\w+) -> /**: specimen.\1
force_controller: detectors\.(mass_ratio|test) -> reference_force: mass_ratio
force_controller: detectors\.actuator_kind -> /**: actuator.kind
force_controller: detectors\.position_range -> /**: sensors.displacement_range
force_controller: detectors\.(\w+)_range -> /**: sensors.\1_range
force_controller: horizon -> reference_force: compensation.horizon
force_controller: voltage_limit -> /**: limits.command
force_controller: watchdog\.state_timeout -> rig: watchdog.command_timeout
force_controller: watchdog\.ramp_down_time -> reference_force: ramp_down_time
force_controller: watchdog\.close_time -> rig: safe.close_time
force_controller: plant\.(\w+) -> /**: actuator.* and specimen.*, of which it follows
rig: sensors\.position_(noise|range) -> /**: sensors.displacement_\1
rig: sensors\.position_(\w+) -> rig: simulated.sensors.displacement_\1
rig: actuator\.oil_column_frequency -> /**: actuator.oil_stiffness, which is M (2 pi f)^2 - K
rig: specimen\.(kind|settings|yield_displacement|hardening_ratio) -> rig: simulated.specimen.\1
rig: specimen\.((bouc_wen|pinching|flag|friction|gap|duffing)\.\w+) -> rig: simulated.specimen.\1
rig: actuator\.(stroke|rated_voltage|friction|friction_velocity|viscous_friction) ->
    rig: simulated.actuator.\1
rig: actuator\.(piston_area|supply_pressure|rated_flow|rated_pressure_drop) ->
    /**: actuator.*, which follow from the data sheet (docs/rig.md)
rig: actuator\.(bulk_modulus|oil_volume|leakage_coefficient) ->
    /**: actuator.*, which follow from the data sheet (docs/rig.md)
rig: sensors\.(\w+_(scale|lag|bias|filter)|tilt) -> rig: simulated.sensors.\1
rig: calibration\.position_zero -> /**: calibration.displacement_bias
rig: calibration\.(\w+)_zero -> /**: calibration.\1_bias
rig: calibration\.position_(\w+) -> /**: calibration.displacement_\1
supervisor: rehearsal\.zeroing -> /**: calibration.zeroing
"""
_PATTERNS = [line.split(" -> ") for line in _RENAMED.replace("->\n   ", "->").strip().splitlines()]


def renamed(node: str, name: str) -> str:
    """Give the present name of a parameter, with its place in a file; empty if it had no other."""
    for old, new in _PATTERNS:
        if found := re.fullmatch(old, f"{node}: {name}"):
            return found.expand(new)
    return ""
