"""Numbers of a preflight, as `seft preflight --json` prints them."""

from dataclasses import asdict
from typing import Any

import numpy as np

from seft_ros.preflight.closed_loop import growth_rate
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.stability_margins import Critical, Range
from seft_ros.preflight.stability_verdict import Preflight


def summarise(plan: Plan, found: Preflight) -> dict[str, Any]:
    """Verdict, margins and predicted errors; frequencies in Hz, delays in s.

    ``critical_delay_s`` is the dead time of the actuator's path at which the planned test turns
    unstable, all of it: of an actuator of kind `delay` the delay itself, of a valve that of the
    valve. ``critical_added_delay_s`` is what it is more than planned. None: no end was found as
    far as was looked (``searched``), or, of a whole range, the method does not use the quantity
    or the plan is unstable. ``local_stiffness`` is the specimen's over the told one, while the
    method believes the told one, ``local_stiffness_followed`` the same once it has followed it.
    ``sure_delay_s`` and ``sure_gain`` hold whatever the controller takes the valves for.
    """
    margins = found.margins
    critical, dead_time = margins.mass_ratio, margins.dead_time
    first = found.modes[0] if found.modes else None
    return {
        "verdict": found.verdict,
        "reasons": found.reasons,
        "basis": found.basis,
        "promise": found.promise,
        "plant": plan.rig.plant.source,
        "compensation": plan.section["compensation.method"],
        "mass_ratio": plan.mass_ratio,
        "critical_mass_ratio": _value(critical),
        "crossing_hz": critical.hz if critical else None,
        "dead_time_s": plan.dead_time,
        "critical_delay_s": _value(dead_time),
        "critical_added_delay_s": dead_time.value - plan.dead_time if dead_time else None,
        "delay_crossing_hz": dead_time.hz if dead_time else None,
        "gain": _range(margins.gain),
        "sure_delay_s": _value(margins.sure_dead_time),
        "sure_gain": _range(margins.sure_gain),
        "local_stiffness": _range(margins.stiffness),
        "local_stiffness_followed": _range(margins.followed),
        "told_delay_error_s": _range(margins.told_delay),
        "false_damping_ratio": first.false_damping if first else None,
        "frequency_error": first.frequency_error if first else None,
        "modes": [
            asdict(mode)
            | {"false_damping": mode.false_damping, "frequency_error": mode.frequency_error}
            for mode in found.modes
        ],
        "spectral_radius": abs(found.dominant),
        "growth_rate": growth_rate(found.dominant, plan.dt),
        "dominant_hz": float(np.angle(found.dominant)) / (2 * np.pi * plan.dt),
        "states": found.states,
    }


def _value(critical: Critical | None) -> float | None:
    return critical.value if critical else None


def _range(found: Range | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "planned": found.planned,
        "lowest": _value(found.lowest),
        "highest": _value(found.highest),
        "searched": list(found.searched),
    }
