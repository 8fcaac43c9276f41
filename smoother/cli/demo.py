"""`unocclude demo`: the main job on a small recording: smooth, validate, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Json, Processes
from .output import (
    cell,
    centimetres,
    check_outputs,
    percent,
    print_notes,
    print_table,
    say,
    say_command,
    write_json,
)
from .progress import progress_bar
from .standing import say_untrusted_parts, say_verdict

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..evaluation.validate import Validation
    from ..result import Recovery

#: Used where `data/` holds no recording.
SEED = 1


def demo(
    folder: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="FOLDER", help="Where to write; files of an earlier demo are replaced."
        ),
    ] = Path("out/demo"),
    processes: Processes = None,
    json_file: Json = None,
) -> None:
    """Recover a small recording, hold it against its truth, and write a report."""
    from calib.motion.motion_calibration import with_given

    from .. import smooth
    from ..evaluation.validate import validate
    from ..io import read_recording, write_recovery
    from ..report import write_report
    from .config_file import read_config, with_processes
    from .smooth import smooth_figures

    folder.mkdir(parents=True, exist_ok=True)
    check_outputs(True, [json_file])
    source, calibration = _recording(folder)
    recording = read_recording(source)
    say(f"recording: {source}")
    with progress_bar("recovering") as progress:
        recovery = smooth(recording, calibration, with_processes(read_config(None), processes), progress)
    recovery = with_given(recovery, calibration)
    result, report = folder / "demo_recovered.mcap", folder / "demo_report.html"
    left_out = write_recovery([recovery], result, source=source, force=True)
    truth = recording.truth
    validation = None if truth is None else validate(recovery, truth)
    write_report(recovery, report, recording=recording, validation=validation, truth=truth, force=True)
    figures = {
        "recovery": smooth_figures(recording, recovery),
        "validation": validation and validation.to_dict(),
        "report": report.name,
    }
    write_json(json_file, figures, True)
    say_verdict(recovery)
    print_gaps(recovery, validation)
    say_untrusted_parts(recovery)
    print_notes(left_out)
    say("Joints, joint angles and the calibration are in the report.")
    if validation is not None:
        say_command("validate", result, "--truth", source)
    say(f"result: {result}")
    say(f"report: {report.resolve()}")


def print_gaps(recovery: Recovery, validation: Validation | None) -> None:
    """Print one table: every gap, its stated sigma, and the error against the truth where there is one."""
    from ..evaluation.summary import gap_summaries

    errors = {} if validation is None else {gap.start_s: figures for gap, figures in validation.gaps}
    rows = []
    for summary in gap_summaries(recovery):
        figures = errors.get(summary.gap.start_s)
        rows.append(
            (
                f"{summary.gap.start_s:.2f}",
                f"{summary.gap.length_s:.2f}",
                centimetres(summary.sigma_max_m),
                *(
                    ("-", "-", "-")
                    if figures is None
                    else (
                        centimetres(figures.position_rms_m),
                        centimetres(figures.position_max_m),
                        cell(figures.orientation_rms_deg),
                    )
                ),
            )
        )
    columns = (
        *("gap starts, s", "length, s", "stated sigma, cm"),
        *("error rms, cm", "error max, cm", "error rms, deg"),
    )
    print_table(f"{recovery.name}: the forearm where the camera did not see it", columns, rows)
    if validation is not None and validation.occluded.position_rms_m is not None:
        inside = percent(validation.occluded.coverage_95)
        say(
            f"In the gaps the answer is {centimetres(validation.occluded.position_rms_m)} cm (rms) from the"
            f" truth, {centimetres(validation.occluded.position_max_m)} cm at most;"
            f" {inside} of the truth lies inside the stated 95 % region."
        )


def _recording(folder: Path) -> tuple[Path, ArmCalibration | None]:
    """The recording beside the source tree and its calibration, or one simulated on the spot."""
    data = Path(__file__).parents[2] / "data"
    if (data / "demo.mcap").is_file():
        calibration_file = data / "demo_calibration.toml"
        if not calibration_file.is_file():
            return data / "demo.mcap", None
        from .load import load_arm

        return data / "demo.mcap", load_arm(data / "demo.mcap", calibration_file)[1]
    from ..io import write_recording
    from ..simulation import ArmSimulation, simulate_arm

    simulated = simulate_arm(ArmSimulation.preset("realistic"), SEED)
    path = folder / "demo.mcap"
    write_recording(simulated.recording, path, force=True)
    return path, simulated.calibration
