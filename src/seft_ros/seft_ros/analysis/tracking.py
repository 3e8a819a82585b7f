"""How well the actuators' force followed the reference force in a test."""

from typing import Any

import numpy as np
from seft_msgs_py.topics import REFERENCE_FORCE, RIG_STATE
from seft_plant_sim.whole_structure import ReferenceResponse

from seft_ros.analysis.benchmark_criteria import benchmark_criteria
from seft_ros.analysis.common_steps import common_steps
from seft_ros.analysis.energy_error import energy_error, relative_energy_error
from seft_ros.analysis.frequency_evaluation import frequency_evaluation_index
from seft_ros.analysis.reference import at_steps
from seft_ros.analysis.tracked import FORCE, tracked_of
from seft_ros.analysis.tracking_indicator import relative_tracking_indicator
from seft_ros.recording.record import Record

_DISPLACEMENT = RIG_STATE.quantities.index("positions")


def tracking_of(record: Record, reference: ReferenceResponse | None) -> dict[str, dict[str, Any]]:
    """Tracking of each axis; formulas and signs are in docs/metrics.md.

    Reference force and measured force are those of the same step: the rig measures at step k
    what commands before it did, so even an ideal actuator is one period late. Samples between the
    first and the last step that both topics have count; of the lost ones errors are left out, and
    what needs every sample (spectra, areas, integrals, J1) interpolates them.

    Parameters
    ----------
    record : Record
        The test.
    reference : ReferenceResponse or None
        Exact response, for J4 and J7 (of the second axis J5 and J8...); None: they are NaN.

    Returns
    -------
    dict
        Axis -> ``fei_amplitude``, ``fei_delay_s``, ``fei_frequency_hz``,
        ``tracking_indicator_end`` (over the square of the reference force's peak),
        ``energy_error`` (over the largest input energy), ``energy_error_j`` (J), and ``J``: J1
        (ms), J2, J3 and the axis's displacement criteria (%).
    """
    commands, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    dt = record.experiment.timebase.dt
    steps, at_commands, at_states = common_steps(commands.steps, states.steps)
    signals = tracked_of(record)
    command, force, velocity = signals.command, signals.force, signals.velocity
    displacement = states.values[:, _DISPLACEMENT]
    criteria = benchmark_criteria(
        commands.values[at_commands, 0],
        states.values[at_states, FORCE],
        np.full_like(displacement, np.nan)
        if reference is None
        else at_steps(reference.displacement, states.steps),
        displacement,
        dt,
        steps,
    )
    fei = frequency_evaluation_index(command, force, dt)
    indicator = relative_tracking_indicator(command, force)
    with np.errstate(invalid="ignore", over="ignore"):
        work = energy_error(force - command, velocity, dt)
        end_j = work[-1] if len(work) > 1 else np.full(work.shape[1:], np.nan)
        del work
    relative = relative_energy_error(command, force, velocity, dt)
    return {
        axis: {
            "fei_amplitude": float(fei.amplitude[column]),
            "fei_delay_s": float(fei.delay_s[column]),
            "fei_frequency_hz": float(fei.frequency_hz[column]),
            "tracking_indicator_end": float(indicator[column]),
            "energy_error": float(relative[column]),
            "energy_error_j": float(end_j[column]),
            "J": criteria.of_axis(column),
        }
        for column, axis in enumerate(record.experiment.axes)
    }
