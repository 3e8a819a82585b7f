"""A controller as options give it: by gain, zeros and poles, or by coefficients."""

from collections.abc import Sequence

import numpy as np
from seft_msgs_py.errors import InputError

from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.roots import Root


def given_controller(
    gain: float | None,
    zeros: Sequence[str],
    poles: Sequence[str],
    numerator: str | None,
    denominator: str | None,
) -> Controller | None:
    """Read the controller that options give; None if they give none.

    Parameters
    ----------
    gain : float or None
        Of the factored form.
    zeros, poles : sequence of str
        ``HZ`` or ``HZ,DAMPING`` each, of the factored form.
    numerator, denominator : str or None
        Coefficients in s, highest power first, with blanks or commas between them.

    Raises
    ------
    InputError
        If both forms are mixed, one is incomplete, or a text can't be read.
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
