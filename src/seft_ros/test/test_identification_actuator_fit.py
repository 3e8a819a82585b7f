"""The seven numbers of an actuator from a test of it, whatever specimen it pushes."""

import math
import re
from functools import cache

import numpy as np
import pytest
from experiments_at_hand import load
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.rig import Rig
from seft_ros.ground_motion.synthetic_motion import excitation
from seft_ros.identification.actuator_fit import OilBalance, fit_actuator

TAIL = 1.0
BAND = (0.3, 200.0)


@cache
def driven(*overrides, volts=0.2, seconds=20.0, of="jhu"):
    """Drive a rig by noise; commands, displacements, accelerations, forces, each (N, n), and dt."""
    experiment = load(*overrides, config=of)
    axes, dt = experiment.axes, experiment.timebase.dt
    rig = Rig(experiment["rig"], axes, experiment.timebase)
    band = BAND[0], min(BAND[1], 0.45 / dt)
    unit = excitation(round(seconds / dt), len(axes), dt, band, 1)
    commands = np.concatenate([volts * unit, np.zeros((round(TAIL / dt), len(axes)))])
    rig.reset()
    states = [rig.measured]
    for command in commands[:-1]:
        rig.step(command)
        states.append(rig.measured)  # valves that are not as known make the judge replace values
    states = np.array(states)
    return commands, states[:, 0], states[:, 2], states[:, 3], dt, band


def fitted(*overrides, axis=0, **options):
    *signals, dt, band = driven(*overrides, **options)
    return fit_actuator(OilBalance([signal[:, axis] for signal in signals], dt, band))


KNOWN = {
    "flow_gain": 0.0403,
    "oil_stiffness": 1.664e7,
    "valve_frequency": 70.0,
    "valve_damping": 0.6,
    "dead_time": 1e-3,
    "friction": 10.0,
}
RELATIVE = {"flow_gain": 0.01, "oil_stiffness": 0.1, "valve_frequency": 0.1, "valve_damping": 0.15}
ABSOLUTE = {"dead_time": 0.2e-3, "friction": 6.0}


def assert_found(fit, **other):
    """Within what velocity_feedforward asks for, and more."""
    assert fit.verdict == "good"
    assert fit.fault() == ""
    assert fit.unsure == ()
    for name, known in {**KNOWN, **other}.items():
        allowed = {"abs": ABSOLUTE[name]} if name in ABSOLUTE else {"rel": RELATIVE[name]}
        assert getattr(fit, name) == pytest.approx(known, **allowed), name
    assert 20.0 < fit.leakage < 100.0


SPECIMEN = "rig:simulated.specimen."
ACTUATOR = "rig:simulated.actuator."
RIGS = {
    "the paper's": ((), {}),
    "yields much": ((SPECIMEN + "kind:=bilinear", SPECIMEN + "yield_displacement:=0.0001"), {}),
    "slips": ((SPECIMEN + "kind:=friction", SPECIMEN + "friction.force:=200.0"), {}),
    "no friction": ((ACTUATOR + "friction:=0.0",), {"friction": 0.0}),
    "sharp friction": (
        (ACTUATOR + "friction:=30.0", ACTUATOR + "friction_velocity:=0.001"),
        {"friction": 30.0},
    ),
    "slow valve": ((ACTUATOR + "valve_frequency:=30.0",), {"valve_frequency": 30.0}),
    "soft oil": ((ACTUATOR + "oil_stiffness:=1.6615e6",), {"oil_stiffness": 1.6615e6}),
    "half the flow": ((ACTUATOR + "flow_gain:=0.02015",), {"flow_gain": 0.02015}),
    "late": ((ACTUATOR + "dead_time:=0.01",), {"dead_time": 0.01}),
    "2 kHz": (("rate:=2000.0",), {}),
    "velocity derived": (("/**:sensors.velocity:=derived",), {}),
}
DRIVES = {
    "slow valve": {"volts": 0.5},
    "soft oil": {"volts": 0.8, "seconds": 40.0},
    "half the flow": {"volts": 0.4},
}


@pytest.mark.parametrize("name", RIGS)
def test_the_actuator_is_found_with_any_specimen_and_all_noise(name):
    overrides, other = RIGS[name]
    assert_found(fitted(*overrides, **DRIVES.get(name, {})), **other)


def test_at_a_low_rate_images_of_held_commands_mislead_nothing():
    fit = fitted("rate:=250.0")
    assert fit.valve_frequency == pytest.approx(KNOWN["valve_frequency"], rel=0.02)
    assert fit.dead_time == pytest.approx(KNOWN["dead_time"], abs=1.5e-4)
    faster_than_seen = fitted("rate:=250.0", f"{ACTUATOR}valve_frequency:=200.0")
    assert faster_than_seen.flow_gain == pytest.approx(KNOWN["flow_gain"], rel=0.01)
    assert "valve_frequency" in faster_than_seen.unsure


def test_of_several_axes_each_has_its_own():
    gains = f"{ACTUATOR}flow_gain:=[0.0403, 0.03, 0.05]"
    valves = f"{ACTUATOR}valve_frequency:=[70.0, 50.0, 90.0]"
    fit = fitted(gains, valves, of="three_storey_frame", axis=2)
    assert_found(fit, flow_gain=0.05, oil_stiffness=1.685e7, valve_frequency=90.0)


@pytest.mark.parametrize("cutoff", [40.0, 60.0, 120.0])
def test_a_filter_of_all_sensors_is_dead_time_and_no_lack_of_pressure(cutoff):
    fit = fitted(*(f"rig:simulated.sensors.{channel}_filter:={cutoff}" for channel in CHANNELS))
    late = math.sqrt(2.0) / (2 * math.pi * cutoff)
    assert fit.force_capacity == 0.0
    assert fit.flow_gain == pytest.approx(KNOWN["flow_gain"], rel=0.01)
    assert fit.oil_stiffness == pytest.approx(KNOWN["oil_stiffness"], rel=0.1)
    valve = fit.valve_damping / (math.pi * fit.valve_frequency)
    own = KNOWN["valve_damping"] / (math.pi * KNOWN["valve_frequency"])
    assert fit.dead_time + valve == pytest.approx(1e-3 + late + own, abs=2e-4)


def test_a_force_capacity_is_reported_where_the_load_shows_it():
    assert fitted().force_capacity == 0.0
    small = fitted(ACTUATOR + "force_capacity:=4000.0")
    assert small.force_capacity == pytest.approx(4000.0, rel=0.2)
    assert_found(small)


@pytest.mark.parametrize(
    ("signs", "message"),
    [
        ((-1, 1, 1, 1), "sign of displacement against command"),
        ((1, 1, 1, -1), "sign of force against motion"),
        ((1, 0, 0, 0), "explain .* of the flow's variance"),
    ],
)
def test_data_that_tell_nothing_are_refused_with_the_reason(signs, message):
    *signals, dt, band = driven()
    noise = np.random.default_rng(1).standard_normal((len(signals[0]), 4)) * [0, 5e-6, 0.05, 3.0]
    clean = np.stack([signal[:, 0] for signal in signals])
    signed = np.array(signs)[:, np.newaxis] * clean + noise.T
    fit = fit_actuator(OilBalance(signed, dt, band))
    assert fit.verdict == "not usable"
    assert re.search(message, fit.fault())
