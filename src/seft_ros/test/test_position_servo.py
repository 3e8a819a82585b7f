"""Displacement servos: their command, what is followed, how they stop, and how they are found."""

import numpy as np
import pytest
from bare_rig import transfer
from experiments_at_hand import load, simulated
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes
from seft_plant_sim.hardware.hosted import HostedHardware
from seft_plant_sim.judge.known_rig import known_responses
from seft_plant_sim.judge.servo_model import second_difference, servo_models
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.simulated.rig import continuous_model
from seft_plant_sim.whole_structure import reference_response
from seft_ros.design.plant import Plant, rig_model
from seft_ros.force_controller.position_servo import InvertedServo, PositionServo
from seft_ros.force_controller.velocity_feedforward import DELAY_ERROR, GAIN_ERROR
from seft_ros.identification import rig_tests
from seft_ros.identification.identified import facts_of, identify_from_recordings
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

SHORT = "ground_motion:synthetic.duration:=12.0", "ground_motion:tail:=1.0"
NO_SENSORS = "sensors.velocity:=derived", "sensors.acceleration:=derived"
SERVO = "rig:simulated.actuator.servo."
IMPOSED = (f"{SERVO}proportional:=0.0",)  # it moves as identified
RESPONSES = (
    TransferFunction((130.0,), (1.0, 130.0), 0.004),
    TransferFunction((4e4, 4e6), (1.0, 300.0, 8e4, 4e6), 0.0013),
    TransferFunction((-600.0, 2.5e5), (1.0, 20.0, 2.5e5), 0.008),  # oil that rings, and a lag
)


def told(*words):
    return load(*SHORT, *words, config="position_servo")


def true_error(experiment):
    """RMS of the true displacement's error over that of the exact response, %."""
    blocks = build_blocks(experiment)
    seen, read = [], blocks.rig.read

    def reading():
        sample = read()
        seen.append(blocks.rig.hardware.sample[0])
        return sample

    blocks.rig.read = reading
    recording = simulate_test(experiment, blocks)
    assert recording.trip is None
    if not seen:  # in the compiled loop the judged sample must do
        seen = recording.states.values[:, 0]
    reference = reference_response(experiment, blocks.ground_motion.samples).displacement
    off = np.array(seen) - reference[: len(seen)]
    return 100 * np.sqrt(np.mean(off**2) / np.mean(reference**2))


@pytest.mark.parametrize(
    ("words", "most"),
    [
        ((), 0.8),
        (NO_SENSORS, 0.8),
        ((f"{SERVO}gain:=1.1", "rig:simulated.actuator.dead_time:=0.004"), 1.2),
        ((*NO_SENSORS, f"{SERVO}gain:=0.9", "rig:simulated.actuator.dead_time:=0.0"), 1.2),
        (("specimen.stiffness:=1.3e5", "rig:simulated.specimen.stiffness:=2.11e5"), 1.2),
        ((*IMPOSED, *NO_SENSORS), 0.8),
        ((*IMPOSED, "rig:simulated.specimen.kind:=bilinear"), 2.5),
        (("rig:simulated.specimen.kind:=bilinear",), 2.5),
        (("rate:=2000.0", "rig:simulated.specimen.kind:=flag"), 2.5),
    ],
)
def test_the_specimen_follows_the_whole_structure(words, most):
    yields = ("rig:simulated.specimen.yield_displacement:=0.002",) if "kind" in str(words) else ()
    assert true_error(told(*words, *yields)) < most


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("dt", [0.002, 1 / 1024, 0.00025])
def test_the_command_moves_the_response_along_the_target(response, dt):
    (model,) = servo_models([response], dt)
    servo = InvertedServo(model, response, dt)
    ahead, time = servo.ahead(servo.taps), dt * np.arange(round(2.0 / dt))
    wanted = np.sin(2 * np.pi * 4.0 * time) * np.minimum(time, 1.0)
    z, u, change, moved = np.zeros(len(model.push)), 0.0, 0.0, np.zeros_like(wanted)
    for k in range(len(time) - servo.taps):
        bend = ahead @ wanted[k + 1 : k + 1 + servo.taps] - servo.feedback @ [*z, u, change]
        change += bend
        u += change
        z = model.free @ z + model.push * u
        moved[k + 1] = model.output @ z
    kept = slice(None, len(time) - servo.taps)
    assert np.abs(moved - wanted)[kept].max() < 0.003


def test_gain_and_delay_that_are_wrong_are_found():
    experiment = told(f"{SERVO}gain:=1.1", "rig:simulated.actuator.dead_time:=0.004")
    blocks = build_blocks(experiment)
    simulate_test(experiment, blocks)
    errors = blocks.force_controller.controller.state.errors[0]
    assert errors[GAIN_ERROR] == pytest.approx(0.1, abs=0.01)
    assert errors[DELAY_ERROR] == pytest.approx(0.002, abs=3e-4)


def test_servos_of_several_axes_have_their_own_responses():
    of = RESPONSES[1:]
    numerators = [0.0, *of[0].numerator, 0.0, *of[1].numerator]
    denominators = [*of[0].denominator, 0.0, *of[1].denominator]
    section = {
        "actuator.response.numerator": numerators,
        "actuator.response.denominator": denominators,
        "actuator.response.dead_time": [each.dead_time for each in of],
    }
    assert tuple(known_responses(section, ("a", "b"), (0, 1))) == of
    models = servo_models(of, 0.001)
    alone = servo_models(of[1:], 0.001)
    assert [model.free.shape for model in models] == [(3, 3)] * 2
    assert models[1].rest[-1] == pytest.approx(alone[0].rest[-1])


@pytest.mark.parametrize(
    ("numerator", "denominator"), [([0.0], [1.0]), ([1.0], [1.0, -1.0]), ([1.0, 1.0], [1.0, 1.0])]
)
def test_what_is_no_response_of_a_servo_is_refused(numerator, denominator):
    words = (
        f"actuator.response.numerator:={numerator}",
        f"actuator.response.denominator:={denominator}",
    )
    with pytest.raises(InputError, match=r"/\*\*: actuator.response"):
        build_blocks(told(*words))


@pytest.mark.parametrize("words", [("rig:hardware:=udp",), IMPOSED])
def test_a_plan_knows_the_servo_as_it_was_identified(words):
    experiment, f = told(*words), np.geomspace(0.1, 200.0, 20)
    plant = Plant.of_model(*rig_model(experiment), motion=True)
    (servo,) = known_responses(experiment["rig"], experiment.axes, [0])
    np.testing.assert_allclose(plant.response(f), servo.response(f), rtol=1e-9)


def test_a_supply_fails_only_where_there_is_a_valve():
    with pytest.raises(InputError, match=r"simulated.actuator.servo.proportional"):
        build_blocks(told(*IMPOSED, 'rig:faults:=["supply scale 0.5 at 1.0"]'))


def test_a_servo_is_not_driven_as_a_valve():
    with pytest.raises(InputError, match="make that position_servo"):
        build_blocks(told("force_controller:method:=velocity_feedforward"))
    with pytest.raises(InputError, match="make that velocity_feedforward"):
        words = "force_controller:method:=position_servo", "actuator.response.numerator:=[1.0]"
        words += "actuator.response.denominator:=[0.01, 1.0]", "reference_force:mass_ratio:=1.0"
        build_blocks(load(*words, "reference_force:compensation.method:=target_motion"))


def test_after_a_trip_it_stands_where_its_last_command_was():
    experiment = told("limits.force:=700.0")
    blocks = build_blocks(experiment)
    recording = simulate_test(experiment, blocks)
    assert recording.trip is not None
    plan = blocks.force_controller.stop(blocks.force_controller.step_index)
    stands = blocks.rig.hardware.sample[0, 0]
    static = 0.995  # of the response
    assert abs(plan[-1, 0]) > 4e-4  # not where it began
    assert stands == pytest.approx(static * plan[-1, 0], abs=2e-4)
    jumps = np.abs(np.diff(plan[:, 0], prepend=plan[0, 0]))
    assert jumps.max() < 1e-3


def test_after_wrong_samples_it_slows_down_as_was_planned_before_them():
    sound, experiment = simulated(told()), told('rig:faults:=["force scale -1.0 at 4.3"]')
    blocks = build_blocks(experiment)
    recording = simulate_test(experiment, blocks)
    assert recording.trip.reason.endswith("_wrong")  # force or acceleration: nothing tells which
    assert abs(recording.states.values[-1, 1, 0]) > 0.05
    assert recording.simulated.force_peak == sound.simulated.force_peak
    assert abs(blocks.rig.hardware.sample[1, 0]) < 1e-3


@pytest.mark.parametrize(
    ("words", "value"), [(NO_SENSORS, "set -0.018"), (NO_SENSORS[1:], "add 0.07")]
)
def test_without_an_accelerometer_a_wrong_displacement_does_nothing(words, value):
    told_so = told(*words, f'rig:faults:=["displacement {value} at 4.0 for 1"]')
    sound, recording = simulated(told(*words)), simulated(told_so)
    assert recording.trip is None
    off = recording.states.values[:, 0] - sound.states.values[:, 0]
    assert np.abs(off).max() < 0.01 * np.abs(sound.states.values[:, 0]).max()


def test_a_stop_behind_a_servo_does_not_end_the_test():
    gap = "rig:simulated.specimen.gap."
    words = "rig:simulated.specimen.kind:=gap", f"{gap}width:=0.002", f"{gap}stiffness:=2e6"
    assert simulated(told(*words)).trip is None


def test_a_command_that_jumps_ends_the_test_before_it_is_sent():
    experiment = told()
    interlock = build_blocks(experiment).force_controller
    controller, steps = interlock.controller, iter([0.0, 0.001, 0.0015, 0.03])
    controller.step = lambda points, state: np.array([next(steps)])
    points, sample = np.zeros((*controller.shape, 1)), np.zeros((6, 1))
    commands = [interlock.step(k, points, sample)[0] for k in range(4)]
    assert commands == [0.0, 0.001, 0.0015, 0.0015]
    assert "jumps by more than /**: limits.displacement_rate allows" in interlock.reason
    assert interlock.stop(3)[-1, 0] == 0.0015


def test_commands_beyond_the_largest_displacement_are_cut_off():
    experiment = told("limits.displacement:=0.004")
    controller = build_blocks(experiment).force_controller.controller
    assert isinstance(controller, PositionServo)
    recording = simulated(experiment)
    assert np.abs(recording.series["valve_command"].values).max() == pytest.approx(0.004)


def test_a_second_difference_gives_the_derivatives_of_a_parabola():
    weights, dt = second_difference(5, 0.01), 0.01
    t = -dt * np.arange(11)
    at = t[5]
    x, v, a = weights @ (1.0 + 2.0 * t + 3.0 * t**2)
    assert (v, a) == pytest.approx((2.0 + 6.0 * at, 6.0))
    assert weights @ (1.0 + 2.0 * t) == pytest.approx([1.0 + 2.0 * at, 2.0, 0.0])
    assert x == pytest.approx(1.0 + 2.0 * at + 3.0 * at**2, abs=0.02)


@pytest.mark.parametrize(
    "words",
    [
        (),
        (f"{SERVO}proportional:=2300.0", f"{SERVO}integral:=2e4", "rate:=500.0"),
        (f"{SERVO}delta_p:=2e-4", "rig:simulated.actuator.dead_time:=0.008", *NO_SENSORS),
    ],
)
def test_identify_finds_the_response(words, tmp_path):
    unknown = "actuator.response.numerator:=[0.0]", "actuator.response.denominator:=[1.0]"
    experiment = told(*words, *unknown, "actuator.response.dead_time:=0.0")
    motions = rig_tests.Motions(experiment, (0.3, 100.0), 1)
    path = motions.write(tmp_path / "motion.csv", 30.0)
    recording = simulated(rig_tests.open_loop(experiment, path, 5e-4))
    found = identify_from_recordings(recording, None, (0.3, 100.0))
    dt = experiment.timebase.dt
    facts = facts_of(found, False, dt, 0.0, False)
    f = np.geomspace(0.5, 20.0, 30)
    (response,) = known_responses(facts, ("x",), (0,))
    model = continuous_model(experiment["rig"], experiment.axes)  # of small signals
    true = np.array([transfer(model, hz)[0, 0] for hz in f]) * np.exp(-2j * np.pi * f * model.delay)
    assert np.abs(response.response(f) - true).max() < 0.01
    assert found.specimen.mass == pytest.approx(52.7, rel=0.05)
    assert found.specimen.stiffness == pytest.approx(2.11e5, rel=0.05)


def test_the_first_command_of_each_test_is_where_a_hosted_servo_stands():
    sent = []

    class Servo:
        def read(self):
            return np.zeros((4, 1))

        def write(self, drive):
            sent.append(float(drive[0]))

        def safe(self):
            sent.append("holds")

        close = safe

    test = told()
    given = test["rig"], test.axes, RigAxes.whole(test.axes)
    hosted = HostedHardware(*given, 1.0, lambda: 0.0, Servo())
    for commands in ([0.002, 0.005], [-0.001, 0.001]):
        hosted.reset()
        for command in commands:
            hosted.write(np.array([command]))
    assert sent == pytest.approx([0.0, 0.003, 0.003, 0.005])
    hosted.safe()
    assert sent[-1] == "holds"
