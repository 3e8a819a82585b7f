"""``seft recover``: a bag whose recorder was cut off."""

from pathlib import Path
from typing import Annotated

import typer


def recover(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a recorded test.")],
) -> int:
    """Make a bag readable whose recorder was killed: every complete message is kept.

    The cut-off file stays beside it, named .cut. An intact bag is left as it is.

    Example:

        seft recover bags/half
    """
    from seft_ros.recording.recover import recover as recover_bag

    print(recover_bag(bag))
    return 0
