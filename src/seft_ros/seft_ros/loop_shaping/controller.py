"""The controller of the force loop: by gain, zeros and poles or by coefficients."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import write_parameter_file
from seft_msgs_py.errors import InputError
from seft_plant_sim.lti import TransferFunction, ratio

from seft_ros.force_controller.block import bilinear
from seft_ros.force_controller.kinds import is_one_controller, one_controller
from seft_ros.force_controller.names import TRANSFER_FUNCTION
from seft_ros.loop_shaping.roots import Root, polynomial_of, roots_of

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


class Controller(TransferFunction):
    """C_f from force error (N) to valve drive (V)."""

    @classmethod
    def from_coefficients(
        cls, numerator: npt.ArrayLike, denominator: npt.ArrayLike
    ) -> "Controller":
        """Make it of two polynomials, neither of which may be zero; a number has degree 0."""
        num, den = (
            tuple(np.atleast_1d(np.asarray(values, dtype=np.float64)).tolist())
            for values in (numerator, denominator)
        )
        for name, values in (("numerator", num), ("denominator", den)):
            if not any(values):
                raise InputError(f"force_controller: {name} is zero")
        return cls(num, den)

    @classmethod
    def from_parameters(cls, section: dict[str, Any]) -> "Controller":
        """Make it of a force controller's section of an experiment.

        An InputError says if another package's controller is in use, axes have different ones or
        are mixed, or a polynomial is zero.
        """
        if not is_one_controller(section):
            raise InputError(
                "force_controller: method, per_axis or gain make it something else than one "
                f"{TRANSFER_FUNCTION} for all axes, which alone can be judged here; give one as "
                "options"
            )
        gain = float(np.ravel(section.get("gain", 1.0))[0])
        return cls.from_coefficients(section["numerator"], section["denominator"]).scaled(gain)

    @classmethod
    def from_roots(cls, gain: float, zeros: Iterable[Root], poles: Iterable[Root]) -> "Controller":
        """Make it of its factors: gain * product(s - zeros) / product(s - poles)."""
        return cls.from_coefficients(gain * polynomial_of(zeros), polynomial_of(poles))

    @property
    def gain(self) -> float:
        """Gain of the factored form: the quotient of the leading coefficients."""
        leading = [next(filter(None, part)) for part in (self.numerator, self.denominator)]
        return leading[0] / leading[1]

    @property
    def zeros(self) -> list[Root]:
        """Zeros, lowest first."""
        return roots_of(np.roots(self.numerator))

    @property
    def poles(self) -> list[Root]:
        """Poles, lowest first."""
        return roots_of(np.roots(self.denominator))

    def scaled(self, factor: float) -> "Controller":
        """Multiply the gain."""
        return Controller(tuple(factor * value for value in self.numerator), self.denominator)

    def sampled_response(self, frequencies_hz: Floats, dt: float) -> Complexes:
        """Frequency response as `force_controller` runs it, by the bilinear transform."""
        b, a = bilinear(self.numerator, self.denominator, dt)
        return ratio(b, a, np.exp(2j * np.pi * frequencies_hz * dt))


def given_controller(
    gain: float | None,
    zeros: Sequence[str],
    poles: Sequence[str],
    numerator: str | None,
    denominator: str | None,
) -> Controller | None:
    """Read the controller that options give; None if they give none.

    Either gain, zeros and poles, ``HZ`` or ``HZ,DAMPING`` each, or the coefficients in s, highest
    power first, with blanks or commas between them. An InputError says if both forms are mixed,
    one is incomplete, or a text can't be read.
    """
    factored = gain is not None or zeros or poles
    if numerator is None and denominator is None:
        if not factored:
            return None
        if gain is None:
            raise InputError("--zero and --pole need --gain beside them")
        return Controller.from_roots(
            gain,
            [Root.parse(text, "--zero") for text in zeros],
            [Root.parse(text, "--pole") for text in poles],
        )
    if factored:
        raise InputError(
            "give the controller by --gain, --zero and --pole or by --numerator and "
            "--denominator, not by both"
        )
    if numerator is None or denominator is None:
        raise InputError("--numerator and --denominator go together; one of them is missing")
    return Controller.from_coefficients(
        _coefficients(numerator, "--numerator"), _coefficients(denominator, "--denominator")
    )


def _coefficients(text: str, option: str) -> list[float]:
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if not values or not np.isfinite(values).all():
        raise InputError(f'{option} "{text}": expected numbers, such as "1 17.14 4002"')
    return values


def check_new(path: Path) -> None:
    """Refuse a file that exists already, or in a folder that does not, by an InputError."""
    if path.exists():
        raise InputError(f"{path}: exists already; name another file with --out")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")


def write_controller(controller: Controller, path: Path) -> None:
    """Write a new parameter file, see `check_new`, to be read after the experiment's own."""
    check_new(path)
    section = one_controller(controller.numerator, controller.denominator)
    told = "Controller of the force loop, by seft design: force error (N) to valve (V)"
    write_parameter_file(path, {"force_controller": section}, [told])
