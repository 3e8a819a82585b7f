"""Parameter files of a study's worst tests, to run them again."""

import re
from pathlib import Path
from typing import Any

from seft_msgs_py.config.experiment import write_parameter_file
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.ground_motion_block import FILES
from seft_ros.ground_motion.record_file import files_of
from seft_ros.study.study_plan import StudyPlan, StudyTest


def worst_folder(page: Path) -> Path:
    """Name the folder for the worst tests beside a page, before the work is done.

    An InputError says that a file has this name.
    """
    folder = page.with_suffix("")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is no folder; name another page, or remove it")
    return folder


def write_worst_tests(plan: StudyPlan, summary: dict[str, Any], folder: Path) -> None:
    """Write the worst tests of each method and mass ratio as complete experiments.

    ``seft simulate FILE`` repeats one. The summary gets their paths, as ``file`` of each; files of
    an earlier study in this folder are replaced.

    Raises
    ------
    InputError
        If a file can't be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: can't be made: {error.strerror or error}") from None
    for result in summary["results"]:
        for worst in result["worst"]:
            test = StudyTest(result["mass_ratio"], result["method"], worst["test"])
            method = re.sub(r"[^\w.-]", "_", test.method)
            path = folder / f"{method}_{test.mass_ratio:g}_{test.number}.yaml"
            sections = dict(plan.experiment_of(test).sections)
            motion = sections["ground_motion"]
            sections["ground_motion"] = motion | {
                name: [str(Path(file).resolve()) for file in files]
                for name in FILES
                if (files := files_of(motion[name]))
            }
            about = f"{test} of seft study, seed {plan.drawn.seed}, spread {plan.drawn.spread:g}"
            write_parameter_file(path, sections, [about], replace=True)
            worst["file"] = str(path)
