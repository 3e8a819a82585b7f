"""A computed model: what it must be, the message when it is not, and the whole structure."""

import numpy as np
import pytest
from models_at_hand import MODELS
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.computed.computed_model import ComputedModel
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_plant_sim.whole_structure import reference_response
from structures_at_hand import NOTHING_COMPUTED

M, C, K = 50.0, 600.0, 2.0e5


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "models.py"
    path.write_text(MODELS)
    return path


def section(file, name, settings="", **more):
    return {
        **NOTHING_COMPUTED,
        "method": "seft",
        "mass_ratio": 1.0,
        "specimen.mass": M,
        "computed.model": f"{file}:{name}",
        "computed.settings": settings,
        **{name.replace("__", "."): value for name, value in more.items()},
    }


def experiment(file, name, settings="", **more):
    axes, specimen = ["x"], {"mass": M, "damping": C, "stiffness": K}
    common = {"rate": 500.0, "axes": axes}
    force = section(file, name, settings, **more)
    force |= {f"specimen.{name}": value for name, value in specimen.items()}
    return Experiment({"reference_force": common | force})


def model_of(file, name, settings="", axes=("x",), **more):
    return ComputedSubstructure.from_parameters(section(file, name, settings, **more), axes).model


MOTION = 3.0 * np.sin(18.0 * 0.002 * np.arange(400))


def error(found, exact):
    return np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2))


def test_a_spring_that_is_a_model_acts_as_computed_stiffness_does(file):
    given = experiment(file, "Spring")["reference_force"]
    linear = Experiment(
        {"reference_force": given | {"computed.model": "", "computed.stiffness": 1e5}}
    )
    asked = MOTION[:, np.newaxis]
    exact = reference_response(linear, asked)
    found = reference_response(experiment(file, "Spring"), asked)
    assert error(found.displacement, exact.displacement) < 1e-9
    assert error(found.force, exact.force) < 1e-9


def test_the_tangents_are_found_by_small_motions_or_reported(file):
    assert np.allclose(model_of(file, "Spring", "c=50").tangents, [[[1e5]], [[50.0]]])
    assert np.allclose(model_of(file, "Stated").tangents, [[[7.0]], [[3.0]]])


@pytest.mark.parametrize(
    ("name", "settings", "is_static"),
    [
        ("Spring", "k3=1e9", True),
        ("Bilinear", "", True),
        ("Spring", "c=1.0", True),  # a linear damper is distinguished
        ("Dashpot", "", False),
        ("Maxwell", "", False),
    ],
)
def test_a_force_that_depends_on_displacement_alone_is_known_so(file, name, settings, is_static):
    assert model_of(file, name, settings).probed.is_static is is_static


BELOW = """'axes=["internal 1"]'"""  # the first internal degree of freedom


def test_a_model_acts_on_the_internal_degree_of_freedom_that_it_names(file):
    more = {"computed__internal": 1, "computed__mass": [0.0, M, M, 3 * M]}  # a base that moves
    whole = ComputedSubstructure.from_parameters(section(file, "Spring", BELOW, **more), ("x",))
    assert np.allclose(whole.stiffness, [[0.0, 0.0], [0.0, 1e5]])
    own = whole.without_inertial_coupling()
    # the base goes by -M / 3M of the axis's displacement, where the centre of mass rests
    assert np.allclose(own.stiffness, 1e5 * np.array([[1 / 9, -1 / 3], [-1 / 3, 1.0]]))
    model = ComputedModel(own.model)
    model.start(0.002)
    assert np.allclose(
        model.step(0.0, np.array([0.03, 0.02]), np.zeros(2), np.zeros(2)).force, [-1000 / 3, 1000]
    )


@pytest.mark.parametrize(
    ("name", "settings", "why"),
    [
        ("Spring", "axes=2", "has 2 axes, but the test has 1: x"),
        ("Spring", """'axes=["roof"]'""", "Spring are .'roof'., but must .* different ones of x"),
        ("Stepless", "", "has no step.t, displacement, velocity, ground_acceleration."),
        ("Unmade", "", "models.py:Unmade line [0-9]+, made: no such thing"),
        ("Spring", "k=null", "models.py:Spring line 15, step: "),
        ("Nothing", "", "models.py has no Nothing"),
        ("Spring", "mass=1.0", "its settings do not fit .*'mass'"),
    ],
)
def test_what_is_wrong_with_a_model_is_reported_in_one_line(file, name, settings, why):
    with pytest.raises(InputError, match=why):
        _ = model_of(file, name, settings).tangents


def test_a_file_that_does_not_run_is_reported_with_its_line(file):
    file.write_text("import os\n\nx = 1 / 0\n")
    with pytest.raises(InputError, match=r"models.py line 3: division by zero"):
        _ = model_of(file, "Spring").tangents
    file.write_text("import os\ndef\n")
    with pytest.raises(InputError, match=r"models.py line 2: "):
        _ = model_of(file, "Spring").tangents
