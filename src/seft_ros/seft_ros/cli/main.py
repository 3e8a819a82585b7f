"""The `seft` command."""

import gc
import signal
import sys
from contextlib import redirect_stdout
from importlib.metadata import version as installed_version

import typer
from seft_msgs_py.errors import SeftError
from seft_msgs_py.node.process import as_before, on_ending
from seft_msgs_py.printing import unbroken

from seft_ros.cli.bag_commands import compare, recover, replay, report
from seft_ros.cli.design_commands import preflight, study
from seft_ros.cli.identify_command import identify
from seft_ros.cli.perform import reset, run, simulate, start, status, stop
from seft_ros.cli.rig_commands import check, link, new
from seft_ros.cli.shared import STANDS, complain, option
from seft_ros.cli.show_commands import monitor, motion, parameters

APP = typer.Typer(
    name="seft",
    help="Substructure effective force testing (SEFT) on ROS 2.\n\n"
    "seft run config/demo.yaml runs a test as separate nodes over DDS and records it; "
    "seft simulate does the same in one process, without ROS. "
    "seft COMMAND --help shows examples.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
COMMANDS = (
    *(run, simulate, start, stop, reset, status, monitor),
    *(report, compare, replay, recover),
    *(identify, preflight, study),
    *(check, new, link, motion, parameters),
)
for command in COMMANDS:
    APP.command()(command)


@APP.callback(invoke_without_command=True)
def seft(
    context: typer.Context, version: bool = option(False, "Print the version and end.", "--version")
) -> None:
    """Print the help to stderr if no command is given."""
    if version:
        print(f"seft {installed_version('seft_ros')}")
        raise typer.Exit(0)
    if context.invoked_subcommand is None:
        with redirect_stdout(sys.stderr):  # typer before 0.10 prints the help itself
            print(context.get_help())
        raise typer.Exit(2)


def main() -> int:
    """Run the command line; return 0 done, 1 tripped or unstable, 2 wrong input.

    SIGTERM and a closed terminal act as Ctrl-C: the command first brings what it moves to rest.
    """
    return unbroken("seft", _main)


_INTERRUPTED = 130
"""What newer versions of typer return in place of a KeyboardInterrupt."""


def _main() -> int:
    gc.set_threshold(100_000)  # most objects of a command live to its end
    before = on_ending(signal.default_int_handler)
    STANDS.clear()
    try:
        status = int(APP(standalone_mode=False) or 0)
        if status == _INTERRUPTED:
            raise KeyboardInterrupt
        return status
    except SeftError as error:
        complain(str(error))
        return error.exit_status
    except typer.Exit as end:
        return end.exit_code
    except (typer.Abort, KeyboardInterrupt):
        complain(f"interrupted; {', '.join(STANDS) or 'nothing was written'}")
        return 1
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        # wrong use; whose class this is, typer's or click's, depends on typer's version
        complain(f"{error.format_message()} (see seft --help)")
        return 2
    finally:
        as_before(before)


if __name__ == "__main__":
    sys.exit(main())
